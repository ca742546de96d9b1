# make compare: the main job.  make test: ruff and fast tests, which check every promise once.  Each
# sets up .venv by itself; compare needs no extra, the others add all of them, as make install does.
# make test-all: make test and types, then make test-slow, test-kernels and test-adapters.
# make test-nightly: all other tests, which repeat these with further values.
# make docs: the documentation as a site, in out/site.
PYTHON ?= python3
BIN := .venv/bin
SITE := import sysconfig; print(sysconfig.get_path('purelib'))
export OMP_WAIT_POLICY := PASSIVE
# tests start hundreds of processes, which would all compile the same files to bytecode
export PYTHONDONTWRITEBYTECODE :=

# what other people's learners need besides; each is tested in an environment of its own
LEARNERS := $(patsubst tests/adapters/%/requirements.txt,%,$(wildcard tests/adapters/*/requirements.txt))
TIMELESS := $(filter-out %-ros,$(LEARNERS:%=test-adapter-%))

# two workers, or WORKERS=4, each of which takes a whole file; tests/conftest.py says in which order
WORKERS ?= 2
SHARED := -n $(WORKERS) --dist loadfile --no-loadscope-reorder

CHECKED := NUMBA_BOUNDSCHECK=1 NUMBA_OPT=1 $(BIN)/python -m pytest -q

PYTHONS := $(foreach minor,12 13 14,$(if $(shell python3.$(minor) -c 0 2>&1 || echo no),,python3.$(minor)))

.PHONY: compare install learners test test-all test-slow test-long test-kernels test-nightly test-floors test-pythons test-adapters lint lint-ci style types docs clean $(LEARNERS:%=test-adapter-%)
.SECONDARY: $(PYTHONS:%=.venv-%/installed) $(LEARNERS:%=.venv-adapters/%/installed)
.DEFAULT_GOAL := compare

compare: .venv/run
	$(BIN)/rendezvous compare --out out/compare

install: .venv/installed

learners: $(LEARNERS:%=.venv-adapters/%/installed)

test: style
	$(BIN)/python -m pytest -q $(SHARED)

# With --jobs=2 types are checked and learners' environments installed while the fast tests run.
# Slow tests, index checks and adapters all wait at times, so adapters are tested beside the others.
test-all: test types learners
	$(MAKE) test-adapter-ros  # depends on the clock, so alone
	$(MAKE) --jobs=2 --output-sync=target test-long $(TIMELESS)

test-long:
	$(MAKE) test-slow
	$(MAKE) test-kernels

# most kernels come from the disk, where make test left them
test-slow: .venv/installed
	$(BIN)/python -m pytest -q -m 'slow and not nightly' $(SHARED)

# before a release, and by a scheduled job of the workflow; pytest ends with 5 if it selects nothing
test-nightly: .venv/installed learners
	$(BIN)/python -m pytest -q -m nightly $(SHARED)
	$(CHECKED) -m 'kernels and nightly' $(SHARED)
	for learner in $(LEARNERS); do .venv-adapters/$$learner/bin/python -m pytest -q -m nightly \
		tests/adapters/$$learner || test $$? = 5 || exit 1; done

# the tests that run every kernel, with every index checked; kernels that never ran are named and fail
test-kernels: .venv/installed
	$(CHECKED) -m 'kernels and not nightly' --every-kernel $(SHARED)

# the oldest Gymnasium and PettingZoo that are supported, in an environment of their own
test-floors: .venv-floors/installed
	.venv-floors/bin/python -m pytest -q $(SHARED) tests/envs tests/adapters tests/scenario

# the newer Pythons, those of them that this machine has
test-pythons: $(PYTHONS:%=.venv-%/installed)
	for python in $(PYTHONS); do .venv-$$python/bin/python -m pytest -q $(SHARED) \
		tests/envs tests/engine tests/policies tests/scenario || exit 1; done

# TorchRL with BenchMARL, and all others that have a folder in tests/adapters; slow tests too
test-adapters: learners
	$(MAKE) test-adapter-ros  # depends on the clock, so alone
	$(MAKE) --jobs=3 --output-sync=target $(TIMELESS)

$(LEARNERS:%=test-adapter-%): test-adapter-%: .venv-adapters/%/installed
	.venv-adapters/$*/bin/python -m pytest -q -m 'not nightly' tests/adapters/$*

lint: style types

# workflow, Dockerfile and shell script, with tools that only this needs
lint-ci: .venv-lint/installed
	.venv-lint/bin/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	.venv-lint/bin/zizmor --offline --no-progress .github/workflows
	.venv-lint/bin/hadolint Dockerfile
	.venv-lint/bin/shellcheck .ci/run

style: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/installed
	$(BIN)/mypy

docs: .venv/installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/python docs/building/build.py
	@echo "out/site/index.html; with search: $(BIN)/python -m http.server -d out/site"

.venv/run: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable .
	touch $@

# bytecode by all cores, where pip would use one, and none of tests; packages may hold files for
# other Pythons
.venv/installed: .venv/run
	$(BIN)/pip install --quiet --no-compile --constraint constraints.txt torch==2.13.0
	$(BIN)/pip install --quiet --no-compile --constraint constraints.txt --editable '.[train,render,analysis,export,jax,maps,logs,docs,dev]'
	$(BIN)/python -m compileall -qq -j 0 -x /tests/ "$$($(BIN)/python -c "$(SITE)")" || true
	touch $@

.venv-lint/installed: constraints-lint.txt
	test -x .venv-lint/bin/python || $(PYTHON) -m venv .venv-lint
	.venv-lint/bin/pip install --quiet --requirement $<
	touch $@

.venv-floors/installed: pyproject.toml constraints.txt constraints-floors.txt
	test -x .venv-floors/bin/python || $(PYTHON) -m venv .venv-floors
	.venv-floors/bin/pip install --quiet --constraint constraints.txt torch==2.13.0
	grep -v --regexp='^gymnasium==' --regexp='^pettingzoo==' constraints.txt > .venv-floors/constraints.txt
	.venv-floors/bin/pip install --quiet --constraint .venv-floors/constraints.txt \
		--requirement constraints-floors.txt --editable '.[train,render,analysis,dev]'
	touch $@

.venv-python3.%/installed: pyproject.toml constraints.txt
	test -x $(@D)/bin/python || python3.$* -m venv $(@D)
	$(@D)/bin/pip install --quiet --constraint constraints.txt torch==2.13.0
	$(@D)/bin/pip install --quiet --constraint constraints.txt --editable '.[train,render,analysis,export,dev]'
	touch $@

# It stands on .venv, whose pip serves, and adds only what that lacks, not torch. A learner's
# pins hold against ours; what pip cannot be told in a file, its script install does. Bytecode
# is written at the first import: of most modules there is none.
.venv-adapters/%/installed: tests/adapters/%/requirements.txt .venv/installed
	test -x .venv-adapters/$*/bin/python || $(PYTHON) -m venv --without-pip .venv-adapters/$*
	echo "import site; site.addsitedir('$$($(BIN)/python -c "$(SITE)")')" \
		> "$$(.venv-adapters/$*/bin/python -c "$(SITE)")/beneath.pth"
	sed --regexp-extended 's/[^A-Za-z0-9_.-].*/==/; s/^/^/' $< | grep -v --file - constraints.txt \
		> .venv-adapters/$*/constraints.txt
	.venv-adapters/$*/bin/python -m pip install --quiet --no-compile \
		--constraint .venv-adapters/$*/constraints.txt --requirement $<
	test ! -x tests/adapters/$*/install || tests/adapters/$*/install .venv-adapters/$*/bin
	touch $@

clean:
	rm -rf .venv .venv-adapters .venv-floors .venv-lint .venv-python3.* out build *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
