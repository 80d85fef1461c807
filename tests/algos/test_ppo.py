"""PPO's probabilities are those of the collected actions; rollouts are handed out in order."""

import pytest
import torch
from learners import ENCODER, SHAPES, batch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from navrl.algos import PPO, NonFiniteUpdateError, SquashedExploration
from navrl.algos.ppo import StateValue
from navrl.algos.protocols import Algorithm, check_protocol
from navrl.networks import make_actor, make_critic
from navrl.training import Rollouts


def agent(**options):
    torch.manual_seed(0)
    return PPO(make_actor(ENCODER, SHAPES), make_critic(ENCODER, SHAPES), **options)


def rollout(num_worlds=4, num_steps=3):
    data = torch.stack([batch(num_worlds) for _ in range(num_steps)], dim=1)
    return data.set("action", 0.9 * data["action"])


def weights(ppo):
    return {name: value.clone() for name, value in ppo.loss.state_dict().items()}


def test_has_the_members_of_an_algorithm():
    check_protocol("algorithm", agent(), Algorithm)


def test_exploration_has_the_distribution_of_the_policy():
    ppo, sigma = agent(deviation=0.4), 0.4
    td = TensorDict({key: torch.randn(1, *shape) for key, shape in SHAPES.items()}, [1])
    many = td.expand(20_000).clone()
    mean = ppo.actor(many)["action"].clone()
    explore = SquashedExploration(sigma_initial=sigma, sigma_final=sigma)
    torch.manual_seed(0)
    with set_exploration_type(ExplorationType.RANDOM):
        action = explore(many, 0)["action"]
    before = torch.atanh(action) - torch.atanh(mean)
    assert before.mean(0).tolist() == pytest.approx([0.0, 0.0], abs=0.01)
    assert before.std(0).tolist() == pytest.approx([sigma] * 2, abs=0.01)
    expected = torch.distributions.Normal(0.0, sigma).log_prob(before).sum(-1)
    expected = expected - (1 - action.pow(2)).log().sum(-1)
    found = ppo.policy.get_dist(many).log_prob(action)
    torch.testing.assert_close(found, expected, atol=2e-3, rtol=1e-3)


def test_exploration_stays_inside_the_limits():
    td = TensorDict({"action": torch.tensor([[1.0, -1.0]])}, [1])
    with set_exploration_type(ExplorationType.RANDOM):
        action = SquashedExploration(sigma_initial=0.5)(td, 0)["action"]
    assert (action.abs() < 1.0).all() and action.isfinite().all()


def test_first_gradient_step_has_a_ratio_of_one():
    ppo = agent(epochs=1, minibatch_size=100)
    scalars = ppo.update(rollout())
    assert scalars["kl_approx"].abs() < 1e-5 and scalars["clip_fraction"] == 0.0


def test_value_does_not_depend_on_the_action():
    value = StateValue(make_critic(ENCODER, SHAPES), 2)
    data = batch()
    first = value(data.clone())["state_value"]
    assert torch.equal(first, value(data.set("action", -data["action"]))["state_value"])
    assert "action" not in value.in_keys


def test_advantage_is_cut_at_ends_and_bootstraps_at_timeouts():
    ppo, data = agent(gamma=0.9, gae_lambda=0.8), rollout(2, 2)
    data["next", "done"][:, 0] = True
    data["next", "terminated"][0, 0] = True  # world 0 collides, world 1 is out of time
    with torch.no_grad():
        value = ppo.loss.critic_network(data.clone())["state_value"]
        after = ppo.loss.critic_network(data["next"].clone())["state_value"]
        found = ppo.advantage(data.clone())["advantage"]
    reward = data["next", "reward"]
    torch.testing.assert_close(found[0, 0], reward[0, 0] - value[0, 0])
    torch.testing.assert_close(found[1, 0], reward[1, 0] + 0.9 * after[1, 0] - value[1, 0])


def test_update_moves_towards_better_actions():
    ppo = agent(learning_rate=1e-2, epochs=5, minibatch_size=100)
    data = rollout(32, 2)
    data["next", "done"][:] = data["next", "terminated"][:] = True
    data["next", "reward"] = data["action"][..., :1].clone()  # a higher speed is better
    before = ppo.actor(data.clone())["action"][..., 0].mean()
    for _ in range(5):
        ppo.update(data)
    assert ppo.actor(data.clone())["action"][..., 0].mean() > before + 0.02


def test_restored_state_continues_bit_for_bit():
    ppo, other = agent(), agent(learning_rate=1e-3)
    ppo.update(rollout())
    other.load_state_dict(ppo.state_dict())
    data = rollout()
    for one in (ppo, other):
        torch.manual_seed(5)
        one.anneal(0.5)
        one._learning_rate = 3e-4
        one.anneal(0.5)
        one.update(data.clone())
    for name, value in weights(ppo).items():
        assert torch.equal(value, weights(other)[name]), name


def test_learning_rate_decreases_to_zero():
    ppo = agent(learning_rate=1e-3)
    rates = []
    for share in (0.0, 0.5, 1.0):
        ppo.anneal(share)
        rates.append(ppo.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-3, 5e-4, 0.0])


def test_non_finite_rollout_is_reported():
    ppo, data = agent(), rollout()
    data["next", "reward"][0] = torch.nan
    before = weights(ppo)
    with pytest.raises(NonFiniteUpdateError):
        ppo.update(data)
    assert all(torch.equal(before[name], value) for name, value in weights(ppo).items())


@pytest.mark.parametrize(
    "options, message",
    [
        ({"gamma": 1.5}, "gamma=1.5, gae_lambda=0.95: must be in"),
        ({"deviation": 0.0}, "deviation=0.0: must be"),
        ({"epochs": 0}, "epochs=0: must be"),
    ],
)
def test_arguments_out_of_range_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        agent(**options)


# --- rollouts ------------------------------------------------------------------------------------


def steps(count, start=0):
    return [batch(2).set("action", torch.full((2, 2), float(start + k))) for k in range(count)]


def test_rollout_is_in_order_and_then_restarts():
    rollouts = Rollouts(list(SHAPES), num_steps=3)
    for number, step in enumerate(steps(3)):
        assert len(rollouts) == 0, number
        rollouts.extend(step)
    assert len(rollouts) == 6
    found = rollouts.sample(2)
    assert found.batch_size == torch.Size([2, 2, 3])
    assert found["action"][1, 0, :, 0].tolist() == [0.0, 1.0, 2.0]
    rollouts.extend(steps(1, start=3)[0])
    assert len(rollouts) == 0


def test_restored_rollout_continues(tmp_path):
    rollouts, other = (Rollouts(list(SHAPES), num_steps=3) for _ in range(2))
    first, second, third = steps(3)
    rollouts.extend(first)
    rollouts.extend(second)
    other.load(tmp_path, rollouts.save(tmp_path))
    for one in (rollouts, other):
        one.extend(third)
    assert (rollouts.sample() == other.sample()).all()
    other.extend(first)
    other.discard_pending()
    assert len(other) == 0


def test_several_streams_are_rejected():
    with pytest.raises(ValueError, match="needs one stream of experience; set collector=direct"):
        Rollouts(list(SHAPES)).extend(batch(), stream=1)
