"""Vector environment over one batch of worlds: equal to gymnasium's over single environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from nightly import mostly

import navrl  # noqa: F401  registers the environment
from navrl.factory import make_gymnasium_vector_env

SMALL = ["scenario=corridor", "pool_size=8", "num_threads=1", "lidar.num_beams=720"]
SHORT = [*SMALL, "environment.time_limit_steps=4"]
AHEAD = np.array([[1.0, 0.1], [0.5, -0.2], [0.0, 0.0]], np.float32)


def make(num_envs=3, overrides=SHORT, **kwargs):
    return gymnasium.make_vec(
        "navrl/Navigation-v0",
        num_envs=num_envs,
        vectorization_mode="vector_entry_point",
        overrides=overrides,
        **kwargs,
    )


def make_sync(mode, **kwargs):
    makers = [lambda: gymnasium.make("navrl/Navigation-v0", overrides=SHORT, **kwargs)] * 3
    return SyncVectorEnv(makers, autoreset_mode=mode)


def assert_equal(first, second):
    """Compare nested observations, arrays and infos, dtypes included."""
    if isinstance(second, dict):
        assert first.keys() == second.keys()
        for key in second:
            assert_equal(first[key], second[key])
    elif isinstance(second, tuple) or (isinstance(second, np.ndarray) and second.dtype == object):
        for one, other in zip(first, second, strict=True):
            assert_equal(one, other)
    elif second is None:
        assert first is None
    else:
        assert np.asarray(first).dtype == np.asarray(second).dtype
        assert np.array_equal(first, second)


def test_it_is_the_default_of_make_vec():
    envs = gymnasium.make_vec("navrl/Navigation-v0", num_envs=2, overrides=SMALL)
    assert type(envs).__name__ == "GymnasiumVectorNavigation"
    assert envs.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert envs.spec.id == "navrl/Navigation-v0"


@pytest.mark.parametrize("observation", ["raw", "transformed"])
@pytest.mark.parametrize(
    "mode", mostly([AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], [AutoresetMode.NEXT_STEP])
)
def test_results_equal_those_of_single_environments(mode, observation):
    envs, single = (
        make(autoreset_mode=mode, observation=observation),
        make_sync(mode, observation=observation),
    )
    assert envs.single_observation_space == single.single_observation_space
    assert envs.observation_space == single.observation_space
    assert envs.action_space == single.action_space
    assert_equal(envs.reset(seed=7), single.reset(seed=7))
    ended = 0
    for _ in range(11):
        results = envs.step(AHEAD), single.step(AHEAD)
        assert_equal(*results)
        ended += (results[0][2] | results[0][3]).sum()
    assert ended >= 6
    assert_equal(envs.reset(seed=[1, None, 2]), single.reset(seed=[1, None, 2]))


def test_disabled_autoreset_equals_that_of_single_environments():
    envs, single = make(autoreset_mode="Disabled"), make_sync(AutoresetMode.DISABLED)
    assert_equal(envs.reset(seed=3), single.reset(seed=3))
    for _ in range(9):
        results = envs.step(AHEAD), single.step(AHEAD)
        assert_equal(*results)
        ended = results[0][2] | results[0][3]
        if ended.any():
            with pytest.raises(ResetNeeded, match="after the end in worlds"):
                envs.step(AHEAD)
            masks = {"reset_mask": ended}, {"reset_mask": ended}
            assert_equal(envs.reset(options=masks[0]), single.reset(options=masks[1]))
            assert "reset_mask" in masks[0]  # the caller's options are not changed


def test_worlds_without_a_seed_differ():
    starts = [make(2).reset()[0]["ranges"] for _ in range(2)]
    assert not np.array_equal(*starts)
    assert not np.array_equal(*starts[0])


def test_reset_plays_frozen_episodes():
    envs, single = make(), gymnasium.make("navrl/Navigation-v0", overrides=SHORT)
    observations, _ = envs.reset(options={"suite": "smoke", "index": [1, 0, 1]})
    for world, index in enumerate([1, 0, 1]):
        expected, _ = single.reset(options={"suite": "smoke", "index": index})
        assert np.array_equal(observations["ranges"][world], expected["ranges"])
    mask = np.array([False, True, False])
    later, infos = envs.reset(options={"suite": "smoke", "index": 1, "reset_mask": mask})
    assert np.array_equal(later["ranges"][1], observations["ranges"][0])
    assert np.array_equal(later["ranges"][2], observations["ranges"][2])
    assert infos["_outcome"].tolist() == mask.tolist()


def test_ignored_action_of_a_reset_may_be_anything():
    envs = make()
    envs.reset(seed=0)
    for _ in range(4):
        _, _, terminated, truncated, _ = envs.step(0 * AHEAD)
    assert (terminated | truncated).all()
    _, rewards, terminated, truncated, _ = envs.step(np.nan * AHEAD)
    assert not rewards.any() and not (terminated | truncated).any()


def test_caller_may_change_an_observation():
    envs = make()
    observations, _ = envs.reset(seed=0)
    before = {key: value.copy() for key, value in observations.items()}
    for value in observations.values():
        value[:] = 0.0
    after = envs.step(0 * AHEAD)[0]
    assert np.array_equal(after["path"], before["path"])
    assert np.array_equal(after["pose"], before["pose"])


def test_frames_show_each_world():
    envs = make(2, render_mode="rgb_array", autoreset_mode="SameStep")
    envs.reset(seed=1)
    frames = [envs.render()]
    for _ in range(5):
        envs.step(AHEAD[:2])
        frames.append(envs.render())
    assert all(len(pair) == 2 and pair[0].shape == (480, 480, 3) for pair in frames)
    assert (frames[0][0] != frames[0][1]).any()
    for before, after in zip(frames, frames[1:], strict=False):
        assert (before[0] != after[0]).any()
    assert make(2).render_mode is None


def test_close_frees_the_simulator():
    envs = make(2, overrides=[*SHORT, "simulator=bullet"])
    envs.reset()
    envs.close()
    envs.close()
    with pytest.raises(RuntimeError, match="closed"):
        envs.unwrapped.reset()


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda envs: envs.step(AHEAD[:2]), r"actions.shape=\(2, 2\): must be \(3, 2\)"),
        (lambda envs: envs.step(np.nan * AHEAD), "must be finite"),
        (lambda envs: envs.reset(seed=[1, 2]), "seed: must be one for each of 3 worlds, got 2"),
        (
            lambda envs: envs.reset(options={"reset_mask": [1, 0, 0]}),
            "options.reset_mask=.*boolean",
        ),
        (lambda envs: envs.reset(options={"typo": 1}), "options={'typo': 1}: must be None"),
        (
            lambda envs: envs.reset(options={"suite": "smoke", "index": [0, 1]}),
            "options.index=.*: must be an integer or 3 of them",
        ),
    ],
)
def test_wrong_values_are_named(call, message):
    envs = make()
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        call(envs)


def test_step_before_the_first_reset_raises():
    with pytest.raises(ResetNeeded, match="without a running episode"):
        make().step(AHEAD)
    with pytest.raises(ResetNeeded, match="reset all worlds first"):
        make().reset(options={"reset_mask": np.array([True, False, False])})


@pytest.mark.parametrize(
    "kwargs, message",
    [
        ({"num_envs": 0}, "num_envs=0: must be >= 1"),
        ({"autoreset_mode": "never"}, "autoreset_mode='never': must be one of .*'NextStep'"),
        ({"overrides": ["network=small"]}, 'network has no .*observation="transformed"'),
    ],
)
def test_wrong_arguments_are_named(kwargs, message):
    with pytest.raises(ValueError, match=message):
        make_gymnasium_vector_env(**{"num_envs": 2, "overrides": SMALL, **kwargs})
