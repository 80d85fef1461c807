#!/usr/bin/env bash
# TorchRL 0.14.1: GymWrapper needs an attribute that gymnasium's VectorEnv does not define.
#
# Guess, written down first: GymWrapper takes any gymnasium.vector.VectorEnv that declares its mode as
# gymnasium 1.4 documents it, by metadata["autoreset_mode"].
# Seen: it raises AttributeError for autoreset_mode, which SyncVectorEnv and AsyncVectorEnv have
# beside their metadata and the interface has not; with that attribute set it steps.
# For a user: a vector environment of one's own needs both.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.4.0
"$folder/venv/bin/python" - <<'PY' 2>/dev/null
import gymnasium
import numpy as np
from gymnasium.vector.utils import batch_space
from torchrl.envs import GymWrapper

MODE = gymnasium.vector.AutoresetMode.SAME_STEP


class Counters(gymnasium.vector.VectorEnv):
    metadata = {"autoreset_mode": MODE}

    def __init__(self):
        self.num_envs = 2
        self.single_observation_space = gymnasium.spaces.Box(0.0, 100.0, (1,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, 2)
        self.action_space = batch_space(self.single_action_space, 2)

    def reset(self, *, seed=None, options=None):
        self.count = np.zeros((2, 1), np.float32)
        return self.count.copy(), {}

    def step(self, actions):
        self.count += 1.0
        never = np.zeros(2, bool)
        return self.count.copy(), np.zeros(2), never, never.copy(), {}


assert not hasattr(gymnasium.vector.VectorEnv, "autoreset_mode")
try:
    GymWrapper(Counters()).rollout(2)
except AttributeError as error:
    print(f"by metadata: AttributeError: {error}")
    assert "autoreset_mode" in str(error)
else:
    raise SystemExit("the metadata are enough now")
whole = Counters()
whole.autoreset_mode = MODE
print("with the attribute:", tuple(GymWrapper(whole).rollout(2).shape))
PY
