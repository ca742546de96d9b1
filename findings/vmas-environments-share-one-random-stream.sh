#!/usr/bin/env bash
# All VMAS environments of a process draw from one random stream: seeding one reseeds every other.
#
# Versions: vmas 1.5.2, torch 2.13.0, numpy 2.4.6, Python 3.11, CPU.
# Input: a training environment made with seed=0; between its resets a second environment, for
#   evaluation, is reset with seed=7, as usual for comparable evaluations.
# Guess: the training environment continues its own stream, as torch.manual_seed between resets allows.
# Seen: the stream is kept in the class. Each training reset that follows an evaluation gives the
#   same initial condition, which is the one the evaluation environment would draw next. So a training
#   run with regular evaluations meets the same initial conditions after each of them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-compile vmas==1.5.2 torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import torch
import vmas


def make(seed):
    return vmas.make_env("simple_spread", num_envs=2, device="cpu", seed=seed)


def resets(env, between=lambda: None, count=4):
    """Observations of the first agent after each of `count` resets; `between` is called before each."""
    found = []
    for _ in range(count):
        between()
        found.append(env.reset()[0].clone())
    return found


def differ(found):
    return len({tuple(observation.ravel().tolist()) for observation in found})


alone = resets(make(0))
with_torch = resets(make(0), lambda: torch.manual_seed(7))
training, evaluation = make(0), make(7)
evaluated = resets(training, lambda: evaluation.reset(seed=7))
evaluation.reset(seed=7)
following = evaluation.reset()[0]
print("initial conditions in four resets: alone", differ(alone), "· torch.manual_seed between", differ(with_torch))
print("evaluations between:", differ(evaluated), "· that of the other's stream:", torch.equal(evaluated[0], following))
assert differ(alone) == 4 and all(map(torch.equal, alone, with_torch))
assert differ(evaluated) == 1 and torch.equal(evaluated[0], following), "the environments draw independently now"
PYTHON
