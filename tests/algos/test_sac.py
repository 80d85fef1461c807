"""SAC's losses are those of TorchRL, and its state continues bit for bit."""

from functools import partial

import pytest
import torch
from learners import ENCODER, SHAPES, batch
from torchrl.objectives import SACLoss

from navrl.algos import SAC, NonFiniteUpdateError
from navrl.algos.distributions import stochastic_policy
from navrl.algos.protocols import Algorithm, check_protocol
from navrl.networks import make_actor, make_critic


def agent(**options):
    torch.manual_seed(0)
    return SAC(make_actor(ENCODER, SHAPES), make_critic(ENCODER, SHAPES), **options)


def weights(sac):
    return {name: value.clone() for name, value in sac.loss.state_dict().items()}


def test_has_the_members_of_an_algorithm():
    check_protocol("algorithm", agent(), Algorithm)


@pytest.mark.parametrize("is_learned", [True, False])
def test_distribution_does_not_change_the_stored_action(is_learned):
    actor = make_actor(ENCODER, SHAPES)
    policy, data = stochastic_policy(actor, 2, 0.4, is_learned), batch()
    stored, mean = data["action"].clone(), actor(data.clone())["action"]
    distribution = policy.get_dist(data)
    assert torch.equal(data["action"], stored)
    torch.testing.assert_close(distribution.deterministic_sample, mean)
    assert data["scale"].unique().tolist() == pytest.approx([0.4])
    trained = [value for value in policy.parameters() if value.requires_grad]
    assert len(trained) == len(list(actor.parameters())) + is_learned


@pytest.mark.parametrize("steps", [None, 3])
def test_losses_and_gradients_equal_torchrls_loss(steps):
    sac, data = agent(), batch()
    for _ in range(3):  # weights that have moved by now
        sac.update(batch())
    if steps is not None:
        data["steps_to_next_obs"] = torch.full((8, 1), float(steps))
    data["next", "done"][:4] = True
    data["next", "terminated"][:3] = True
    names, found = ("loss_actor", "loss_qvalue", "loss_alpha"), []
    for forward in (sac.loss.forward, partial(SACLoss.forward, sac.loss)):
        sac.loss.zero_grad()
        torch.manual_seed(1)
        terms = forward(data)
        sum(terms[name] for name in names).backward()
        gradients = [weight.grad.clone() for weight in sac._weights]
        found.append((terms, data["td_error"].clone(), gradients))
    (ours, our_error, our_gradients), (theirs, their_error, their_gradients) = found
    for name in (*names, "alpha", "entropy"):
        torch.testing.assert_close(ours[name], theirs[name])
    torch.testing.assert_close(our_error, their_error)
    torch.testing.assert_close(our_gradients, their_gradients)


def test_precision_is_that_of_the_products():
    assert agent().precision.name == "float32"
    sac = agent(precision="bfloat16")
    assert sac.precision.name == "bfloat16"
    data = batch()

    torch.manual_seed(0)
    scalars = sac.update(data)
    assert all(value.dtype == torch.float32 for value in scalars.values())
    with pytest.raises(ValueError, match="precision='half': must be one of"):
        agent(precision="half")


def test_critics_learn_the_stored_actions():
    sac, data = agent(), batch()
    stored = data["action"].clone()
    sac.loss(data)
    assert torch.equal(data["action"], stored)


@pytest.mark.parametrize(("options", "expected"), [({}, 0.05), ({"initial_temperature": 0.3}, 0.3)])
def test_temperature_at_the_start(options, expected):
    assert agent(**options).loss.log_alpha.exp().item() == pytest.approx(expected)


def test_temperature_falls_while_the_entropy_is_above_its_target():
    sac, data = agent(), batch()
    before = sac.loss.log_alpha.item()
    scalars = sac.update(data)
    assert (scalars["entropy"] > -2.0) == (sac.loss.log_alpha.item() < before)


def test_update_trains_actor_critics_and_targets():
    sac, data = agent(), batch()
    actor = {name: value.clone() for name, value in sac.actor.state_dict().items()}
    before = weights(sac)
    sac.update(data)
    after = weights(sac)
    assert any(not torch.equal(actor[name], v) for name, v in sac.actor.state_dict().items())
    for part in ("qvalue_network_params", "target_qvalue_network_params", "log_alpha"):
        names = [name for name in before if name.startswith(part)]
        assert names and any(not torch.equal(before[name], after[name]) for name in names), part


def test_learning_rate_falls_linearly_to_its_last_scale():
    sac = agent(learning_rate=1e-3, final_learning_rate_scale=0.1)
    for share, expected in ((0.0, 1e-3), (0.5, 5.5e-4), (1.0, 1e-4), (1.2, 1e-4)):
        sac.anneal(share)
        assert sac.optimizer.param_groups[0]["lr"] == pytest.approx(expected)
    steady = agent(learning_rate=1e-3)
    steady.anneal(1.0)
    assert steady.optimizer.param_groups[0]["lr"] == 1e-3


def test_restored_state_continues_bit_for_bit():
    sac, other = agent(), agent(learning_rate=1e-3)
    sac.update(batch())
    other.load_state_dict(sac.state_dict())
    data = batch()
    for one in (sac, other):
        torch.manual_seed(5)
        one.update(data.clone())
    for name, value in sac.loss.state_dict().items():
        assert torch.equal(value, other.loss.state_dict()[name]), name


def test_several_batches_return_sums():
    torch.manual_seed(1)
    batches = torch.stack([batch(), batch()])
    one, both = agent(), agent()
    torch.manual_seed(2)
    expected = sum(one.update(data)["loss_qvalue"] for data in batches.clone().unbind(0))
    torch.manual_seed(2)
    torch.testing.assert_close(both.update_from_each(batches)["loss_qvalue"], expected)


def test_non_finite_update_changes_no_weight():
    sac, data = agent(), batch()
    data["next", "reward"][0] = torch.nan
    before = weights(sac)
    with pytest.raises(NonFiniteUpdateError):
        sac.update(data)
    assert all(torch.equal(before[name], value) for name, value in weights(sac).items())


@pytest.mark.parametrize(
    "options, message",
    [
        ({"gamma": 1.5}, r"gamma=1.5: must be in \[0, 1\]"),
        ({"tau": 0.0}, r"tau=0.0: must be in \(0, 1\]"),
        ({"final_learning_rate_scale": 0.0}, "final_learning_rate_scale=0.0: must be"),
        ({"learning_rate": 0.0}, "learning_rate=0.0: must be"),
    ],
)
def test_arguments_out_of_range_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        agent(**options)
