"""The environment that a user makes from Python names wrong overrides in one line."""

import gymnasium
import pytest

import navrl

WRONG = [
    ("scenario=coridor", r"Could not find 'scenario/coridor' .*; did you mean corridor"),
    ("lidar.nois=7", r"lidar.nois.*did you mean lidar.noise"),
    ("pool_size=0", r"pool_size=0: must be an integer, at least 1"),
]


@pytest.mark.parametrize("override, message", WRONG)
def test_wrong_override_is_named_in_one_line(override, message):
    with pytest.raises(ValueError, match=message) as raised:
        navrl.make([override], num_worlds=1)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("override, message", WRONG)
def test_gymnasium_names_a_wrong_override(override, message):
    with pytest.raises(ValueError, match=message) as raised:
        gymnasium.make("navrl/Navigation-v0", overrides=[override])
    assert "\n" not in str(raised.value)
