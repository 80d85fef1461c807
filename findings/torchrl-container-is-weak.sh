#!/usr/bin/env bash
# TorchRL 0.14.1: a transform does not keep the environment that it is part of.
#
# Guess, written down first: after TransformedEnv(env, Compose(step)), step.container is the Compose,
# and it stays as long as the step does.
# Seen: it is the TransformedEnv, and None as soon as the caller no longer holds that environment.
# For a user: a transform that reads its environment's limits through `container` loses them when a
# helper returns the transform and not the environment.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.4.0
"$folder/venv/bin/python" - <<'PY' 2>/dev/null
from torchrl.envs import Compose, GymEnv, StepCounter, TransformedEnv

step = StepCounter()
env = TransformedEnv(GymEnv("CartPole-v1"), Compose(step))
held = type(step.container).__name__
del env
print(f"environment held: container is a {held}; released: {step.container}")
assert held == "TransformedEnv" and step.container is None
PY
