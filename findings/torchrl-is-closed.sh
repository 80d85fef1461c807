#!/usr/bin/env bash
# TorchRL 0.14.1: an environment of one's own says is_closed=True before it was ever closed.
#
# Guess, written down first: is_closed is False until close() is called, as it is of GymWrapper.
# Seen: a subclass of EnvBase reports True from its construction on, also between its steps.
# For a user: `if not env.is_closed: free()` in one's own close() never frees anything.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.4.0
"$folder/venv/bin/python" - <<'PY' 2>/dev/null
import gymnasium
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, GymWrapper


class Still(EnvBase):
    def __init__(self):
        super().__init__(batch_size=[])
        self.observation_spec = Composite(observation=Unbounded((1,)))
        self.action_spec = Bounded(-1.0, 1.0, (1,))
        self.reward_spec = Unbounded((1,))

    def _reset(self, tensordict, **kwargs):
        return TensorDict({"observation": torch.zeros(1)})

    def _step(self, tensordict):
        done = torch.zeros(1, dtype=torch.bool)
        zeros = torch.zeros(1)
        return TensorDict({"observation": zeros, "reward": zeros, "done": done, "terminated": done})

    def _set_seed(self, seed):
        pass


own, wrapped = Still(), GymWrapper(gymnasium.make("CartPole-v1"))
own.rollout(2)
wrapped.rollout(2)
print(f"own environment: is_closed={own.is_closed}; GymWrapper: is_closed={wrapped.is_closed}")
assert own.is_closed and not wrapped.is_closed
PY
