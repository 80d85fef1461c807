"""DDPG's targets, gradients and target updates are the textbook's."""

from functools import partial

import pytest
import torch
from learners import ENCODER, SHAPES, batch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.objectives import DDPGLoss

from navrl.algos import DDPG, GaussianExploration, NonFiniteUpdateError
from navrl.networks import make_actor, make_critic


def agent(**options) -> DDPG:
    torch.manual_seed(0)
    return DDPG(make_actor(ENCODER, SHAPES), make_critic(ENCODER, SHAPES), **options)


@pytest.mark.parametrize("steps", [None, 1, 3])
def test_target_bootstraps_at_timeouts_and_not_at_collisions(steps):
    ddpg, data = agent(gamma=0.9), batch()
    if steps is not None:
        data["steps_to_next_obs"] = torch.full((8, 1), float(steps))
    data["next", "done"][:4] = True  # ends of episodes,
    data["next", "terminated"][:2] = True  # the first two by collision or goal
    terms = ddpg.loss(data)
    with torch.no_grad():
        critic = ddpg.loss.value_network
        following = data["next"].select(*SHAPES)
        with ddpg.loss.target_actor_network_params.to_module(ddpg.loss.actor_network):
            ddpg.loss.actor_network(following)
        with ddpg.loss.target_value_network_params.to_module(critic):
            value = critic(following)["state_action_value"].squeeze(-1)
    alive = torch.tensor([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    expected = data["next", "reward"].squeeze(-1) + 0.9 ** (steps or 1) * alive * value
    torch.testing.assert_close(terms["target_value"], expected)


class AnyCritic(nn.Module):
    """One that does not encode first; its action comes in the middle."""

    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.Linear(180 * 2 + 2 + 5 * 2, 1)

    def forward(self, *inputs):
        return self.linear(torch.cat([value.flatten(1) for value in inputs], dim=-1))


@pytest.mark.parametrize("has_encoder", [True, False])
@pytest.mark.parametrize("loss_function", ["l2", "smooth_l1"])
def test_losses_and_gradients_equal_torchrls_loss(loss_function, has_encoder):
    ddpg, data = agent(loss_function=loss_function), batch()
    if not has_encoder:
        names = ["spatial", "action", "waypoints_scaled"]
        critic = TensorDictModule(AnyCritic(), names, ["state_action_value"])
        ddpg = DDPG(make_actor(ENCODER, SHAPES), critic, loss_function=loss_function)
    for _ in range(3):  # weights that have moved by now
        ddpg.update(batch())
    data["next", "terminated"][:3] = True
    ddpg.loss.zero_grad()
    found = []
    for forward in (ddpg.loss.forward, partial(DDPGLoss.forward, ddpg.loss)):
        terms = forward(data)
        (terms["loss_actor"] + terms["loss_value"]).backward()
        weights = [*ddpg._actor_weights, *ddpg._critic_weights]
        found.append((terms, data["td_error"].clone(), [w.grad.clone() for w in weights]))
        ddpg.loss.zero_grad()
    (ours, our_error, our_gradients), (theirs, their_error, their_gradients) = found
    for name in ("loss_actor", "loss_value", "pred_value", "target_value", "td_error"):
        torch.testing.assert_close(ours[name], theirs[name])
    torch.testing.assert_close(our_error, their_error)
    torch.testing.assert_close(our_gradients, their_gradients)
    assert any(gradient.abs().max() > 0 for gradient in our_gradients)


def test_an_update_moves_both_networks_and_the_targets_by_tau():
    ddpg = agent(tau=0.25)
    before = {k: v.clone() for k, v in ddpg.loss.state_dict().items()}
    ddpg.update(batch())
    after = ddpg.loss.state_dict()
    moved = 0
    for name, target in after.items():
        if not name.startswith("target_"):
            continue
        online = name.removeprefix("target_")
        expected = 0.25 * after[online] + 0.75 * before[name]
        torch.testing.assert_close(target, expected)
        moved += int(not torch.equal(after[online], before[online]))
    assert moved >= 8


def test_actor_update_increases_the_q_value():
    ddpg = agent(actor_learning_rate=1e-3, critic_learning_rate=1e-9)
    data = batch(64)
    losses = [float(ddpg.update(data.clone())["loss_actor"]) for _ in range(30)]
    assert losses[-1] < losses[0] - 1e-3


def test_critic_fits_its_target():
    ddpg = agent(actor_learning_rate=1e-9, critic_learning_rate=1e-3, gamma=0.0)
    data = batch(32)
    losses = [float(ddpg.update(data.clone())["loss_critic"]) for _ in range(200)]
    assert losses[-1] < 0.3 * losses[0]


def test_bfloat16_is_close_to_float32():
    data = batch(64)
    exact, fast = (agent(precision=p).update(data.clone()) for p in ("float32", "bfloat16"))
    for name in ("loss_critic", "q_mean", "gradient_norm_critic"):
        torch.testing.assert_close(fast[name], exact[name], rtol=0.1, atol=0.02)


def test_learning_rates_decrease_linearly():
    ddpg = agent(actor_learning_rate=1.0, critic_learning_rate=2.0, final_learning_rate_scale=0.1)
    for share, expected in ((0.0, 1.0), (0.5, 0.55), (1.0, 0.1), (2.0, 0.1)):
        ddpg.anneal(share)
        assert ddpg.actor_optimizer.param_groups[0]["lr"] == pytest.approx(expected)
        assert ddpg.critic_optimizer.param_groups[0]["lr"] == pytest.approx(2 * expected)


def test_non_finite_loss_stops_before_weights_change():
    ddpg, data = agent(), batch()
    before = {k: v.clone() for k, v in ddpg.loss.state_dict().items()}
    data["next", "reward"][3] = float("nan")
    with pytest.raises(NonFiniteUpdateError, match="loss_critic=nan"):
        ddpg.update(data)
    for name, value in ddpg.loss.state_dict().items():
        assert torch.equal(value, before[name]), name


def test_state_dict_continues_bit_for_bit():
    first, second = agent(), agent()
    data = [batch() for _ in range(4)]
    for one in data[:2]:
        first.update(one.clone())
    second.load_state_dict(first.state_dict())
    for one in data[2:]:
        a, b = first.update(one.clone()), second.update(one.clone())
        assert all(torch.equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize(
    ("option", "value"),
    [("gamma", 1.5), ("tau", 0.0), ("actor_learning_rate", -1.0), ("precision", "int4")],
)
def test_bad_arguments_are_named(option, value):
    with pytest.raises(ValueError, match=f"{option}="):
        agent(**{option: value})


def test_noise_has_its_scale_and_bounds_in_each_dimension():
    noise = GaussianExploration(0.5, 0.1, annealing_frames=100, std=(0.2, 1.0))
    torch.manual_seed(0)
    td = TensorDict({"action": torch.zeros(20_000, 2)}, [20_000])
    action = noise(td, frames=0)["action"]
    assert action.abs().max() <= 1
    torch.testing.assert_close(action[:, 0].std(), torch.tensor(0.1), rtol=0.05, atol=0)
    assert action[:, 1].std() > 0.4
    assert noise.sigma(50) == pytest.approx(0.3) and noise.sigma(1000) == pytest.approx(0.1)
