"""A partial reset returns the present values of the worlds that are not reset."""

import pytest
import torch
from torchrl.envs import Transform, TransformedEnv, VecNorm
from torchrl.envs.transforms import VecNormV2

from navrl import factory
from navrl.config import compose, instantiate

NUM_WORLDS = 4


class ResetRecorder(Transform):
    """Store what the environment hands to its transforms at a reset."""

    seen = None

    def _reset(self, tensordict, tensordict_reset):
        self.seen = tensordict_reset.clone()
        return tensordict_reset


def make(simulator="batched"):
    cfg = compose(
        "train", ["scenario=corridor", "pool_size=8", "num_threads=1", f"simulator={simulator}"]
    )
    return factory.make_navigation_env(cfg, NUM_WORLDS, factory.make_pool(cfg), 0, privileged=True)


def driven(env, steps=3):
    td = env.reset()
    for _ in range(steps):
        td["action"] = torch.tensor([[0.8, 0.3]]).expand(NUM_WORLDS, 2)
        td = env.step(td)["next"]
    return td


def reset_some(env, td):
    mask = torch.tensor([[False], [True], [False], [False]])
    return env.reset(td.clone().set("_reset", mask)), ~mask.squeeze(-1)


@pytest.mark.parametrize("simulator", ["batched", "bullet"])
@pytest.mark.parametrize("through", ["one reset", "two resets", "restored state"])
def test_rows_not_reset_contain_present_values(simulator, through):
    recorder = ResetRecorder()
    env = TransformedEnv(make(simulator), recorder)
    td = driven(env)
    if through == "two resets":
        td, _ = reset_some(env, td)
    if through == "restored state":
        state = env.base_env.episode_state()
        recorder = ResetRecorder()
        env = TransformedEnv(make(simulator), recorder)
        env.base_env.load_episode_state(state)
    _, kept = reset_some(env, td)
    for key in env.base_env.observation_spec.keys(True, True):
        assert torch.equal(recorder.seen[key][kept].nan_to_num(), td[key][kept].nan_to_num()), key
    assert td["reward_terms", "progress"][kept].abs().min() > 0
    assert (recorder.seen["outcome"][1] == 0).all()
    assert all((term[1] == 0).all() for term in recorder.seen["reward_terms"].values())


def test_rows_not_reset_retain_a_finished_outcome():
    recorder = ResetRecorder()
    env = TransformedEnv(make(), recorder)
    td = driven(env, steps=60)
    assert (td["outcome"] > 0).all()
    _, kept = reset_some(env, td)
    assert torch.equal(recorder.seen["outcome"][kept], td["outcome"][kept])


def mean_of_observed(env, recorder, key):
    """Return the mean of a key over all steps and partial resets of a drive."""
    td, rows = env.rand_action(env.reset()), [recorder.seen[key]]
    for _ in range(40):
        td = env.step(td)["next"]
        rows.append(td[key])
        td, _ = reset_some(env, td)
        rows.append(td[key])
        td = env.rand_action(td)
    return torch.cat(rows).mean()


@pytest.mark.parametrize("norm", [VecNorm, VecNormV2])
def test_running_mean_has_no_zero_rows(norm):
    recorder = ResetRecorder()
    vec_norm = norm(in_keys=["ranges"], out_keys=["ranges_scaled"])
    env = TransformedEnv(make()).append_transform(recorder).append_transform(vec_norm)
    mean = mean_of_observed(env, recorder, "ranges")
    assert mean > 1.0
    loc = vec_norm.loc["ranges"]
    torch.testing.assert_close(loc.mean(), mean, rtol=0.02, atol=0.0)


def perceiving(kind, steps="paper"):
    """Return an environment with perception transforms, and what follows them."""
    recorder, transforms = (
        ResetRecorder(),
        instantiate(compose("train", [f"transforms={steps}"]).transforms),
    )
    env = (
        TransformedEnv(make(), transforms)
        if kind == "torchrl"
        else factory.make_env(make(), transforms)
    )
    return env.append_transform(recorder), recorder


@pytest.mark.parametrize("steps", ["paper", "navrl_best"])
@pytest.mark.parametrize("through", ["reset", "maybe_reset"])
def test_perception_retains_present_rows_during_a_reset(steps, through):
    env, recorder = perceiving("navrl", steps)
    td = driven(env)
    if through == "reset":
        _, kept = reset_some(env, td)
    else:
        done = torch.tensor([[False], [True], [False], [False]])
        env.maybe_reset(td.clone().update({"done": done, "terminated": done}))
        kept = ~done.squeeze(-1)
    for key in env.observation_spec.keys(True, True):
        assert torch.equal(recorder.seen[key][kept].nan_to_num(), td[key][kept].nan_to_num()), key
    assert td["points"][kept].abs().amin((-1, -2)).max() > 0


def test_torchrls_transformed_env_has_no_zero_rows():
    """It hides the present rows from transforms; those of one time follow from its inputs."""
    env, recorder = perceiving("torchrl")
    td = driven(env)
    _, kept = reset_some(env, td)
    for key in ("ranges_pooled", "points", "returns", "waypoints", "spatial", "waypoints_scaled"):
        torch.testing.assert_close(recorder.seen[key][kept], td[key][kept], rtol=0, atol=1e-5)
    assert recorder.seen["tagd"][kept].abs().sum() > 0


def test_running_mean_behind_perception_has_no_zero_rows():
    env, recorder = perceiving("navrl")
    env.append_transform(VecNorm(in_keys=["ranges_pooled"], out_keys=["scaled"]))
    mean = mean_of_observed(env, recorder, "ranges_pooled")
    loc = env.transform[-1].loc["ranges_pooled"]
    torch.testing.assert_close(loc.mean(), mean, rtol=0.02, atol=0.0)


@pytest.mark.parametrize("simulator", ["batched", "bullet"])
def test_command_and_velocity_are_those_of_the_episode(simulator):
    env = make(simulator)
    td = driven(env)
    for key in ("command", "velocity"):
        torch.testing.assert_close(td[key], torch.tensor([[0.8, 0.3]]).expand(NUM_WORLDS, 2))
    td, kept = reset_some(env, td)
    for key in ("command", "velocity", "velocity_ahead"):
        assert td[key][kept].abs().min() > 0.0
        assert not td[key][~kept].any()
