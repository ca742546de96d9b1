# CPU image with the command line:
#   docker build -t rendezvous-env .
#   docker build -t rendezvous-env --build-arg EXTRAS=train,render .   # any extras of pyproject.toml
#   docker run --rm -v "$PWD/out:/work/out" rendezvous-env rendezvous compare --out out/compare
# .devcontainer uses the stage "development".
FROM python:3.13-slim-bookworm AS base
ENV OMP_WAIT_POLICY=PASSIVE \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu \
    PIP_NO_CACHE_DIR=1 \
    PYTHONDONTWRITEBYTECODE=1

# What `make test` needs: make, git, a browser and its fonts, and OpenGL for robots' cameras.
FROM base AS development
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        chromium fonts-dejavu-core g++ git libegl1 libgl1-mesa-dri make \
    && rm -rf /var/lib/apt/lists/*

FROM base AS runtime
ARG EXTRAS=""
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY rendezvous_env rendezvous_env
COPY baselines baselines
COPY train train
RUN pip install --constraint constraints.txt ".${EXTRAS:+[$EXTRAS]}" && rm -rf build ./*.egg-info
RUN useradd --create-home --uid 1000 user && mkdir /work /kernels && chown user /work /kernels
# Compiled kernels depend on the processor. A volume at /kernels keeps them between runs.
ENV NUMBA_CACHE_DIR=/kernels
VOLUME /kernels
USER 1000
WORKDIR /work
CMD ["rendezvous", "--help"]
