"""The networks have the paper's sizes, compute its formulas and shrink by config alone."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from navrl.networks import (
    AttentionStream,
    LocationAttention,
    StreamEncoder,
    make_actor,
    make_critic,
)
from navrl.networks.saturation import penalize_saturation

SHAPES = {
    "spatial": (180, 2),
    "temporal": (30, 4),
    "waypoints_scaled": (5, 2),
    "spatial_previous": (180, 2),
}
STREAMS = {
    "spatial": partial(AttentionStream, in_key="spatial"),
    "temporal": partial(AttentionStream, in_key="temporal"),
}
ENCODER = partial(StreamEncoder, streams=STREAMS)


def observation(*batch: int) -> TensorDict:
    return TensorDict({key: torch.randn(*batch, *shape) for key, shape in SHAPES.items()}, batch)


def test_actor_has_the_papers_parameter_count():
    actor = make_actor(ENCODER, SHAPES)
    assert sum(p.numel() for p in actor.parameters()) == 147_948


def test_layer_sizes_equal_the_papers():
    stream = make_actor(ENCODER, SHAPES).module.encoder.streams["spatial"].attention
    sizes = {
        name: [m.out_features for m in net if isinstance(m, torch.nn.Linear)]
        for name, net in stream.named_children()
    }
    assert sizes == {
        "embedding": [256, 128, 64],
        "score": [60, 50, 1],
        "feature": [80, 50, 30],
    }
    assert stream.embedding[0].in_features == 6 * 2 + 5 * 2
    assert isinstance(stream.embedding[-1], torch.nn.ReLU)
    assert isinstance(stream.feature[-1], torch.nn.Linear)


def test_attention_is_the_softmax_weighted_sum():
    torch.manual_seed(0)
    block = LocationAttention(4, 3)
    items, context = torch.randn(7, 5, 4), torch.randn(7, 3)
    result, weights = block(items, context)
    expected = torch.zeros(7, 30)
    for b in range(7):
        joined = [torch.cat([items[b, i], context[b]]) for i in range(5)]
        embedded = [block.embedding(u.clone()) for u in joined]
        scores = torch.stack([block.score(e.clone()) for e in embedded]).squeeze(-1)
        share = scores.exp() / scores.exp().sum()
        torch.testing.assert_close(weights[b], share)
        for i in range(5):
            expected[b] += share[i] * block.feature(embedded[i].clone())
    torch.testing.assert_close(result, expected, atol=1e-5, rtol=1e-5)


def test_attention_does_not_depend_on_the_order_of_items():
    block = LocationAttention(4, 3)
    items, context = torch.randn(2, 5, 4), torch.randn(2, 3)
    order = torch.tensor([3, 1, 4, 0, 2])
    torch.testing.assert_close(block(items[:, order], context)[0], block(items, context)[0])


def test_sectors_are_neighboring_points():
    stream = AttentionStream("spatial", SHAPES, num_items=30)
    seen = []
    stream.attention.forward = lambda items, context: seen.append(items) or (items, items)
    points = torch.arange(360.0).reshape(180, 2)
    stream(points, torch.zeros(5, 2))
    torch.testing.assert_close(seen[0][4], points[24:30].flatten())


def test_streams_share_no_weights():
    actor = make_actor(ENCODER, SHAPES)
    streams = actor.module.encoder.streams
    spatial = {id(p) for p in streams["spatial"].parameters()}
    assert spatial.isdisjoint(id(p) for p in streams["temporal"].parameters())


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_actor_and_critic_take_any_batch(batch):
    actor, critic = make_actor(ENCODER, SHAPES), make_critic(ENCODER, SHAPES)
    td = critic(actor(observation(*batch)))
    assert td["action"].shape == (*batch, 2) and td["action"].abs().max() <= 1
    assert td["state_action_value"].shape == (*batch, 1)


def test_q_value_depends_on_the_action():
    critic, td = make_critic(ENCODER, SHAPES), observation(4)
    td["action"] = torch.zeros(4, 2)
    first = critic(td.clone())["state_action_value"]
    td["action"] = torch.ones(4, 2)
    assert not torch.allclose(first, critic(td)["state_action_value"])


def test_returning_attention_does_not_change_actions():
    torch.manual_seed(1)
    silent = make_actor(ENCODER, SHAPES)
    torch.manual_seed(1)
    telling = make_actor(ENCODER, SHAPES, with_attention=True)
    td = observation(4)
    told = telling(td.clone())
    torch.testing.assert_close(silent(td.clone())["action"], told["action"])
    for name in ("spatial_attention", "temporal_attention"):
        torch.testing.assert_close(told[name].sum(-1), torch.ones(4))
    assert "spatial_attention" not in silent(td.clone())


@pytest.mark.parametrize("removed", ["spatial", "temporal"])
def test_none_removes_a_stream(removed):
    encoder = partial(StreamEncoder, streams={**STREAMS, removed: None})
    actor = make_actor(encoder, SHAPES)
    assert removed not in actor.in_keys
    assert actor(observation(2))["action"].shape == (2, 2)


def test_bad_sizes_are_named():
    with pytest.raises(ValueError, match="num_items=7"):
        AttentionStream("spatial", SHAPES, num_items=7)
    with pytest.raises(ValueError, match="'sonar' is not observed"):
        AttentionStream("sonar", SHAPES)
    with pytest.raises(ValueError, match="at least one stream"):
        StreamEncoder({"spatial": None}, SHAPES)
    with pytest.raises(ValueError, match="last layer must have size 1"):
        LocationAttention(4, 3, score=(8, 2))


@pytest.mark.parametrize("weight", [0.0, 0.3])
def test_saturation_penalty_changes_gradients_only(weight):
    value = torch.randn(5, 2, requires_grad=True)
    assert torch.equal(penalize_saturation(value, weight), value)
    (gradient,) = torch.autograd.grad((penalize_saturation(value, weight) ** 3).mean(), value)
    loss = (value**3).mean() + weight * value.square().sum(-1).mean()
    torch.testing.assert_close(gradient, torch.autograd.grad(loss, value)[0])


def test_saturation_penalty_reduces_saturation():
    value = torch.full((4, 2), 30.0, requires_grad=True)
    (gradient,) = torch.autograd.grad(torch.tanh(penalize_saturation(value, 0.01)).mean(), value)
    assert (gradient > 0).all()
