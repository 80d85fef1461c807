"""What the trainer needs of an algorithm and of exploration is checked before a training."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from navrl.algos import DDPG, TD3, Algorithm, Exploration, GaussianExploration
from navrl.algos.protocols import check_protocol


@pytest.mark.parametrize("algorithm", [DDPG, TD3])
def test_algorithms_have_the_methods_of_the_protocol(algorithm):
    with pytest.raises(ValueError, match=r"algorithm=type: must have precision$"):
        check_protocol("algorithm", algorithm, Algorithm)  # which only an object has


def test_missing_members_are_named():
    check_protocol("exploration", GaussianExploration(), Exploration)
    with pytest.raises(ValueError, match="exploration=object: must have __call__, sigma"):
        check_protocol("exploration", object(), Exploration)


@pytest.mark.parametrize("size", [2, 3])
def test_single_deviation_applies_to_every_dimension(size):
    actions = []
    for std in (0.5, [0.5] * size):
        torch.manual_seed(0)
        td = TensorDict({"action": torch.zeros(4, size)}, [4])
        with set_exploration_type(ExplorationType.RANDOM):
            actions.append(GaussianExploration(std=std)(td, 0)["action"])
    assert torch.equal(*actions) and actions[0].shape == (4, size)


def test_wrong_number_of_deviations_is_rejected():
    td = TensorDict({"action": torch.zeros(4, 3)}, [4])
    with (
        set_exploration_type(ExplorationType.RANDOM),
        pytest.raises(ValueError, match=r"std=\[1.0, 1.0\]: must be one number, or one for each"),
    ):
        GaussianExploration(std=[1.0, 1.0])(td, 0)
