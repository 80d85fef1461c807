"""The regularizer of the actor, and critic-only updates at the start."""

import pytest
import torch
from learners import ENCODER, SHAPES, batch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from navrl.algos import DDPG, TD3, ActionSmoothness
from navrl.networks import make_actor, make_critic


def agent(algorithm, **options):
    torch.manual_seed(0)
    return algorithm(make_actor(ENCODER, SHAPES), make_critic(ENCODER, SHAPES), **options)


def test_penalty_equals_the_weighted_squared_distances():
    actor = TensorDictModule(lambda x: 2.0 * x, ["x"], ["action"])
    start, following = torch.tensor([[0.0, 0.0]]), torch.tensor([[0.5, 1.0]])
    data = TensorDict({"x": start, "next": TensorDict({"x": following}, [1])}, [1])
    temporal = ActionSmoothness(temporal=0.1)(actor, data, 2.0 * start)
    assert temporal == pytest.approx(0.1 * (1.0 + 4.0))
    many = TensorDict({"x": torch.zeros(50_000, 2)}, [50_000])
    torch.manual_seed(0)
    spatial = ActionSmoothness(spatial=0.5, noise=0.1)(actor, many, torch.zeros(50_000, 2))
    assert spatial == pytest.approx(0.5 * 2 * 0.2**2, rel=0.02)


@pytest.mark.parametrize("algorithm", [DDPG, TD3])
def test_penalty_is_part_of_the_actors_loss_only(algorithm):
    torch.manual_seed(1)
    data, losses = batch(), []
    for options in (
        {},
        {"action_smoothness": {"temporal": 0.0}},
        {"action_smoothness": {"temporal": 1.0}},
    ):
        learner = agent(algorithm, **options)
        torch.manual_seed(2)
        losses.append(learner.update(data.clone()))
    plain, zero, smooth = losses
    assert all(torch.equal(plain[name], zero[name]) for name in plain)
    actor = agent(algorithm).actor
    change = actor(data["next"].clone())["action"] - actor(data.clone())["action"]
    penalty = change.square().sum(-1).mean()
    torch.testing.assert_close(smooth["loss_actor"] - plain["loss_actor"], penalty.detach())
    assert torch.equal(plain["loss_critic"], smooth["loss_critic"])


@pytest.mark.parametrize("algorithm", [DDPG, TD3])
def test_first_updates_change_the_critic_only(algorithm):
    learner = agent(algorithm, actor_starts_updates=2)
    actor = [weight.clone() for weight in learner._actor_weights]
    critic = [weight.clone() for weight in learner._critic_weights]
    for _ in range(2):
        learner.update(batch())
    assert all(map(torch.equal, actor, learner._actor_weights))
    assert not all(map(torch.equal, critic, learner._critic_weights))
    resumed = agent(algorithm, actor_starts_updates=2)
    resumed.load_state_dict(learner.state_dict())
    resumed.update(batch())
    assert not all(map(torch.equal, actor, resumed._actor_weights))


def test_bad_weights_are_named():
    with pytest.raises(ValueError, match=r"action_smoothness.spatial=-1.0"):
        ActionSmoothness(spatial=-1.0)
    with pytest.raises(ValueError, match="actor_starts_updates=-1"):
        agent(DDPG, actor_starts_updates=-1)
