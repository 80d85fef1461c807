"""TD3's targets are the lower of two, and actor and targets wait."""

from functools import partial

import pytest
import torch
from learners import ENCODER, SHAPES, batch
from torchrl.objectives import TD3Loss

from navrl.algos import TD3, NonFiniteUpdateError
from navrl.networks import make_actor, make_critic


def agent(**options) -> TD3:
    torch.manual_seed(0)
    return TD3(make_actor(ENCODER, SHAPES), make_critic(ENCODER, SHAPES), **options)


def weights(td3, prefix):
    state = td3.loss.state_dict()
    return {k: v.clone() for k, v in state.items() if k.startswith(prefix) and v.ndim}


def moved(before, after):
    return any(not torch.equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("steps", [None, 3])
def test_target_is_the_minimum_of_two_q_values(steps):
    td3, data = agent(gamma=0.9, target_noise=0.0), batch()
    if steps is not None:
        data["steps_to_next_obs"] = torch.full((8, 1), float(steps))
    data["next", "done"][:4] = True  # ends of episodes,
    data["next", "terminated"][:2] = True  # the first two by collision or goal
    terms = td3._losses(data)
    values = []
    with torch.no_grad():
        following = data["next"].select(*SHAPES)
        with td3.loss.target_actor_network_params.to_module(td3.loss.actor_network):
            td3.loss.actor_network(following)
        for params in td3.loss.target_qvalue_network_params.unbind(0):
            with params.to_module(td3.loss.qvalue_network):
                td3.loss.qvalue_network(following)
            values.append(following["state_action_value"].squeeze(-1).clone())
    assert not torch.allclose(*values)  # two critics, not one twice
    alive = torch.tensor([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    lower = torch.minimum(*values)
    expected = data["next", "reward"].squeeze(-1) + 0.9 ** (steps or 1) * alive * lower
    torch.testing.assert_close(terms["target_value"], expected)


@pytest.mark.parametrize("loss_function", ["l2", "smooth_l1"])
def test_losses_and_gradients_equal_torchrls_loss(loss_function):
    td3, data = agent(loss_function=loss_function), batch()
    for _ in range(3):  # weights that have moved by now
        td3.update(batch())
    data["next", "terminated"][:3] = True
    td3.loss.zero_grad()
    found = []
    for forward in (td3.loss.forward, partial(TD3Loss.forward, td3.loss)):
        torch.manual_seed(1)
        terms = forward(data)
        (terms["loss_actor"] + terms["loss_qvalue"]).backward()
        learned = [*td3._actor_weights, *td3._critic_weights]
        found.append((terms, data["td_error"].clone(), [w.grad.clone() for w in learned]))
        td3.loss.zero_grad()
    (ours, our_error, our_gradients), (theirs, their_error, their_gradients) = found
    for name in ("loss_actor", "loss_qvalue", "pred_value", "target_value"):
        torch.testing.assert_close(ours[name], theirs[name])
    torch.testing.assert_close(our_error, their_error)
    torch.testing.assert_close(our_gradients, their_gradients)


def test_target_policy_smoothing_stays_within_bounds():
    data = batch(64)
    exact, blurred = (
        agent(target_noise=noise)._losses(data.clone())["target_value"] for noise in (0.0, 0.2)
    )
    assert not torch.allclose(exact, blurred)


def test_actor_and_targets_move_at_every_third_update():
    td3, data = agent(actor_delay=3), batch()
    for update in range(7):
        parts = ("actor_network", "qvalue_network", "target_")
        before = [weights(td3, part) for part in parts]
        scalars = td3.update(data.clone())
        after = [weights(td3, part) for part in parts]
        is_due = update % 3 == 0
        changes = [moved(*pair) for pair in zip(before, after, strict=True)]
        assert changes == [is_due, True, is_due]
        assert all(value.isfinite() for value in scalars.values())
        assert scalars["loss_actor"] != 0.0  # the last one stands in


def test_copied_learner_continues_identically():
    one, other, data = agent(), agent(critic_learning_rate=1.0), batch()
    for _ in range(3):
        one.update(data.clone())
    other.load_state_dict(one.state_dict())
    for learner in (one, other):
        for group in learner.critic_optimizer.param_groups:
            group["lr"] = 1e-4
        torch.manual_seed(1)
        for _ in range(2):
            learner.update(data.clone())
    for name, value in weights(one, "").items():
        torch.testing.assert_close(value, weights(other, "")[name], rtol=0, atol=0)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_priorities_and_failures_as_in_ddpg(precision):
    td3, data = agent(precision=precision), batch()
    td3.update(data)
    assert data["td_error"].shape == (8,)
    data["next", "reward"][0] = float("nan")
    before = weights(td3, "")
    with pytest.raises(NonFiniteUpdateError, match="loss_critic=nan"):
        td3.update(data)
    assert not moved(before, weights(td3, ""))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target_noise": -0.1}, "target_noise=-0.1"),
        ({"target_noise_clip": -1.0}, "target_noise_clip=-1.0"),
        ({"actor_delay": 0}, "actor_delay=0"),
        ({"cuda_graph": True}, "cuda_graph=True: needs the networks on a CUDA device"),
        ({"tau": 2.0}, "tau=2.0"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        agent(**options)
