#!/usr/bin/env bash
# TorchRL 0.14.1: the info of a gymnasium vector environment cannot be read as that of a single one.
#
# Guess, written down first: GymWrapper(environment).auto_register_info_dict() works alike for a
# single environment and for a vector environment with SAME_STEP autoreset.
# Seen: for the vector environment it raises RuntimeError, "already has an info-dict reader": the
# wrapper has registered one of its own, for the last observation, and takes no second one so.
# For a user: read such a vector environment's info with set_info_dict_reader and explicit specs.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.4.0
"$folder/venv/bin/python" - <<'PY' 2>/dev/null
import gymnasium
from torchrl.envs import GymWrapper

gymnasium.register("Informed-v0", lambda: Informed(gymnasium.make("CartPole-v1")))


class Informed(gymnasium.Wrapper):
    def reset(self, *, seed=None, options=None):
        observation, _ = self.env.reset(seed=seed, options=options)
        return observation, {"cart": observation[:1]}

    def step(self, action):
        *result, _ = self.env.step(action)
        return *result, {"cart": result[0][:1]}


single = GymWrapper(gymnasium.make("Informed-v0")).auto_register_info_dict()
print("single environment: reads", "cart" in single.rollout(2).keys())
assert "cart" in single.rollout(2).keys()
mode = gymnasium.vector.AutoresetMode.SAME_STEP
vector = gymnasium.make_vec(
    "Informed-v0", 2, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}
)
try:
    GymWrapper(vector).auto_register_info_dict()
except RuntimeError as error:
    print(f"vector environment: RuntimeError: {error}")
    assert "already has an info-dict reader" in str(error)
else:
    raise SystemExit("the vector environment's info is read now")
PY
