"""Models with gymnasium's spaces and ``predict`` play as controllers."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from tensordict import TensorDict

from navrl.policies import PredictingPolicy, StableBaselines3Policy
from navrl.policies.controller import missing_packages


class Model:
    observation_space = spaces.Dict({"pose": spaces.Box(-np.inf, np.inf, (3,), np.float32)})
    action_space = spaces.Box(np.array([0.0, -2.0]), np.array([1.0, 2.0]), dtype=np.float32)

    def predict(self, observation, *, deterministic):
        assert deterministic and observation["pose"].dtype == np.float32
        return np.stack([observation["pose"][:, 0], observation["pose"][:, 1]], axis=1), None


def test_commands_become_normalized_actions():
    pose = torch.tensor([[0.5, 1.0, 0.0], [2.0, -2.0, 0.0]], dtype=torch.float64)
    policy = PredictingPolicy(Model())
    acted = policy(TensorDict({"pose": pose}, [2]))
    assert acted["action"].tolist() == [[0.0, 0.5], [1.0, -1.0]]  # clipped to the limits
    assert policy.in_keys == ["pose"] and not policy.privileged


def test_missing_observation_is_named():
    with pytest.raises(ValueError, match="pose: is read by the model, but must be one of ranges"):
        PredictingPolicy(Model())(TensorDict({"ranges": torch.zeros(1, 4)}, [1]))


def test_observation_of_another_shape_is_rejected():
    with pytest.raises(ValueError, match=r"pose: must have the shape \[3\] .*, got \[4\]"):
        PredictingPolicy(Model())(TensorDict({"pose": torch.zeros(1, 4)}, [1]))


@pytest.mark.parametrize(
    "name, space, message",
    [
        ("observation_space", Model.action_space, "observation_space=Box: must be a Dict"),
        ("action_space", spaces.Discrete(3), r"action_space=Discrete\(3\): must be a Box"),
    ],
)
def test_spaces_of_another_kind_are_rejected(name, space, message):
    model = Model()
    setattr(model, name, space)
    with pytest.raises(ValueError, match=message):
        PredictingPolicy(model)


def test_missing_stable_baselines3_names_the_extra():
    if not missing_packages(StableBaselines3Policy):
        pytest.skip("stable-baselines3 is installed")
    with pytest.raises(ImportError, match=r"\[clients\]"):
        StableBaselines3Policy("ppo.zip", trusted=True)
