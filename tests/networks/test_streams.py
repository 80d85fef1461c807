"""Streams without attention: the baselines' layers, counted by hand, and how they compose."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from navrl.config import compose
from navrl.factory import make_agent
from navrl.networks import (
    AttentionStream,
    ConvAttentionStream,
    ConvStream,
    StreamEncoder,
    VectorStream,
    make_actor,
    make_critic,
)

LIANG = {
    "channels": [32, 16],
    "kernel_sizes": [5, 3],
    "strides": [2, 2],
    "paddings": [1, 1],
    "hidden": [256, 128, 64],
}
PEREZ = {
    "channels": [32, 64, 64],
    "kernel_sizes": [8, 4, 3],
    "strides": [4, 2, 1],
    "paddings": [0, 0, 0],
    "hidden": [256],
}


def linear(*sizes: int) -> int:
    """Weights and biases of a perceptron."""
    return sum(a * b + b for a, b in zip(sizes, sizes[1:], strict=False))


def conv(in_channels: int, out_channels: int, kernel_size: int) -> int:
    return in_channels * out_channels * kernel_size + out_channels


def shapes(rays: int, waypoints: int = 5) -> dict[str, list[int]]:
    scans = ("ranges_pooled_scaled", "ranges_previous_scaled", "ranges_earlier_scaled")
    others = {"waypoints_scaled": [waypoints, 2], "goal": [2], "spatial": [rays, 2]}
    return {**{key: [rays] for key in scans}, **others}


LIANG_LAYERS = conv(3, 32, 5) + conv(32, 16, 3)
LIANG_HEAD = 64 + 30, 256, 128, 64
PEREZ_LAYERS = conv(1, 32, 8) + conv(32, 64, 4) + conv(64, 64, 3)
PEREZ_STREAMS = PEREZ_LAYERS + linear(768, 256) + linear(2, 256) + linear(12, 256)
OUR_STREAMS = PEREZ_LAYERS + linear(1216, 256) + linear(10, 256)
# experiment: observed, numbers after the convolutions, parameters of actor and critic
COUNTS = {
    "liang": (
        shapes(180),
        720,
        LIANG_LAYERS + linear(720, 256, 128, 64) + linear(10, 64, 40, 30) + linear(*LIANG_HEAD, 2),
        LIANG_LAYERS
        + linear(720, 256, 128, 64)
        + linear(10, 64, 40, 30)
        + linear(94 + 2, 256, 128, 64, 1),
    ),
    "liang_original": (
        shapes(512),
        2048,
        LIANG_LAYERS + linear(2048, 256, 128, 64) + linear(2, 64, 40, 30) + linear(*LIANG_HEAD, 2),
        LIANG_LAYERS
        + linear(2048, 256, 128, 64)
        + linear(2, 64, 40, 30)
        + linear(94 + 2, 256, 128, 64, 1),
    ),
    "perez_darpino": (
        shapes(128, waypoints=6),
        768,
        PEREZ_STREAMS + linear(3 * 256, 256, 2),
        PEREZ_STREAMS + linear(3 * 256, 256) + linear(2, 256) + linear(512, 256, 1),
    ),
    "perez_darpino_our_state": (
        shapes(180),
        1216,
        OUR_STREAMS + linear(2 * 256, 256, 2),
        OUR_STREAMS + linear(2 * 256, 256) + linear(2, 256) + linear(512, 256, 1),
    ),
}


def count(module: torch.nn.Module) -> int:
    return sum(weight.numel() for weight in module.parameters())


@pytest.mark.parametrize("name", COUNTS)
def test_baseline_sizes_match_a_manual_count(name):
    observed, flat, in_actor, in_critic = COUNTS[name]
    actor, critic = make_agent(compose("train", [f"experiment={name}"]), observed)
    scan = next(s for s in actor.module.encoder.streams.values() if isinstance(s, ConvStream))
    assert scan.mlp[0].in_features == flat
    assert (count(actor), count(critic)) == (in_actor, in_critic)


def test_parameter_counts_are_exact():
    """As the network's files tell them."""
    assert COUNTS["liang"][2] == 297_928
    assert COUNTS["perez_darpino"][2] == 419_234


def test_subgoal_network_has_only_the_spatial_stream():
    subgoal, _ = make_agent(compose("train", ["experiment=subgoal"]), shapes(180))
    spatial, _ = make_agent(compose("train", ["experiment=no_temporal"]), shapes(180))
    assert count(subgoal) == count(spatial) == 147_948 - 62_773 - 30 * 128
    assert subgoal.in_keys == ["spatial", "waypoints_scaled"]


@pytest.mark.parametrize("name", COUNTS)
def test_layers_equal_the_baselines(name):
    actor, critic = make_agent(compose("train", [f"experiment={name}"]), COUNTS[name][0])
    convolutions = [
        (m.out_channels, m.kernel_size[0], m.stride[0], m.padding[0])
        for m in actor.module.modules()
        if isinstance(m, torch.nn.Conv1d)
    ]
    if name.startswith("liang"):
        assert convolutions == [(32, 5, 2, 1), (16, 3, 2, 1)]
        assert not list(critic.module.observation.parameters())
    else:
        assert convolutions == [(32, 8, 4, 0), (64, 4, 2, 0), (64, 3, 1, 0)]
        assert critic.module.action[0].in_features == 2
        assert critic.module.output[0].in_features == 2 * 256


def test_convolutions_equal_torch_on_stacked_scans():
    torch.manual_seed(0)
    stream = ConvStream(["ranges_previous_scaled", "ranges_pooled_scaled"], shapes(180), **LIANG)
    scans = torch.randn(2, 7, 3, 180)
    (feature,) = stream(*scans)
    assert feature.shape == (7, 3, 64)
    value = torch.stack([scans[0, 4, 1], scans[1, 4, 1]]).unsqueeze(0)
    for index, layer in enumerate(m for m in stream.convolutions if hasattr(m, "weight")):
        kind = {"stride": 2, "padding": 1}
        value = torch.conv1d(value, layer.weight, layer.bias, **kind).relu()
        assert value.shape[-1] == (89, 45)[index]
    torch.testing.assert_close(feature[4, 1], stream.mlp(value.flatten()), atol=1e-5, rtol=1e-5)


def test_order_of_scans_matters():
    stream = ConvStream(["ranges_previous_scaled", "ranges_pooled_scaled"], shapes(180), **LIANG)
    one, other = torch.rand(180), torch.rand(180)
    assert not torch.allclose(stream(one, other)[0], stream(other, one)[0])


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_streams_with_and_without_attention_compose(batch):
    streams = {
        "spatial": partial(AttentionStream, in_key="spatial"),
        "scan": partial(ConvStream, in_keys=["ranges_pooled_scaled"], **PEREZ),
        "goal": partial(VectorStream, in_key="goal", hidden=[8]),
        "waypoints": partial(VectorStream, in_key="waypoints_scaled", hidden=[8]),
    }
    make = {"encoder": partial(StreamEncoder, streams=streams), "shapes": shapes(180)}
    actor = make_actor(**make, with_attention=True)
    critic = make_critic(**make, observation_hidden=[16], action_hidden=[4])
    td = TensorDict({key: torch.randn(*batch, *s) for key, s in shapes(180).items()}, batch)
    td = critic(actor(td))
    assert actor.module.encoder.attention_keys == ["spatial_attention"]
    assert actor.module.encoder.out_features == 30 + 256 + 8 + 8
    assert td["spatial_attention"].shape == (*batch, 30)
    assert td["action"].shape == (*batch, 2)
    assert td["state_action_value"].shape == (*batch, 1)


def test_streams_without_attention_have_no_attention_key():
    streams = {"scan": partial(ConvStream, in_keys=["ranges_pooled_scaled"], **PEREZ)}
    make = partial(make_actor, partial(StreamEncoder, streams=streams), shapes(180))
    assert make(with_attention=True).out_keys == ["action"]
    td = TensorDict({"ranges_pooled_scaled": torch.rand(4, 180)}, [4])
    assert make(with_attention=True)(td)["action"].shape == (4, 2)


def test_every_input_reaches_the_critic():
    critic = make_agent(compose("train", ["experiment=perez_darpino"]), shapes(128, 6))[1]
    td = TensorDict({key: torch.rand(4, *s) for key, s in shapes(128, 6).items()}, [4])
    td["action"] = torch.zeros(4, 2)
    value = critic(td.clone())["state_action_value"]
    for key in critic.in_keys:
        changed = critic(td.clone().set(key, td[key] + 1.0))["state_action_value"]
        assert not torch.allclose(value, changed), key


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"in_keys": ["sonar"]}, "'sonar' is not observed"),
        ({"in_keys": []}, r"one or more scans"),
        ({"in_keys": ["ranges_pooled_scaled", "goal"]}, r"equal length, got .*'goal': \[2\]"),
        (
            {"in_keys": ["waypoints_scaled"]},
            "layer 0: kernel_sizes=5: must be at most its 4 inputs",
        ),
        ({"padding_mode": "reflect"}, "padding_mode='reflect'.*zeros or circular"),
        ({"strides": [2]}, r"strides=\[2\]: must have 2 values"),
        ({"strides": [2, 0]}, "layer 1: .*strides=0"),
        ({"paddings": [-1, 1]}, "layer 0: .*paddings=-1"),
        ({"kernel_sizes": [5, 99]}, "layer 1: kernel_sizes=99: must be at most its 91 inputs"),
        ({"hidden": []}, r"sizes=\[\]"),
    ],
)
def test_bad_sizes_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        ConvStream(**{"in_keys": ["ranges_pooled_scaled"], **LIANG, **change}, shapes=shapes(180))


def test_vectors_of_several_keys_are_concatenated_in_order():
    sizes = {"velocity": [2], "waypoints": [3, 2]}
    stream = VectorStream(["velocity", "waypoints"], sizes, [8])
    assert stream.in_keys == ["velocity", "waypoints"]
    velocity, waypoints = torch.randn(4, 2), torch.randn(4, 3, 2)
    expected = stream.mlp(torch.cat([velocity, waypoints.flatten(1)], dim=-1))
    assert torch.equal(stream(velocity, waypoints)[0], expected)


def test_missing_vector_is_named():
    with pytest.raises(ValueError, match="'sonar' is not observed"):
        VectorStream("sonar", shapes(180), [8])


BEST = {
    "channels": [8, 16],
    "kernel_sizes": [6, 4],
    "strides": [2, 2],
    "paddings": [2, 1],
    "padding_mode": "circular",
    "hidden": [32, 12],
    "embedding": [24],
    "score": [1],
    "feature": [10],
}


def attending(**options):
    torch.manual_seed(0)
    sizes = {
        "ranges_history_scaled": (4, 180),
        "ranges_pooled_scaled": (180,),
        "waypoints_scaled": (5, 2),
    }
    return ConvAttentionStream(["ranges_history_scaled"], sizes, **{**BEST, **options})


def test_conv_attention_keeps_ordered_features():
    stream = attending()
    feature, weights = stream(torch.rand(3, 2, 4, 180), torch.rand(3, 2, 5, 2))
    assert feature.shape == (3, 2, stream.out_features) == (3, 2, 12 + 10)
    assert weights.shape == (3, 2, 45)
    torch.testing.assert_close(weights.sum(-1), torch.ones(3, 2))
    assert stream.in_keys == ["ranges_history_scaled", "waypoints_scaled"]
    assert not any("bearings" in name for name in stream.state_dict())


def test_scans_of_one_key_or_of_several_are_channels():
    one = attending()
    torch.manual_seed(0)
    sizes = {"recent": (3, 180), "ranges_pooled_scaled": (180,), "waypoints_scaled": (5, 2)}
    several = ConvAttentionStream(["ranges_pooled_scaled", "recent"], sizes, **BEST)
    scans, waypoints = torch.rand(2, 4, 180), torch.rand(2, 5, 2)
    for ours, theirs in zip(
        one(scans, waypoints), several(scans[:, 0], scans[:, 1:], waypoints), strict=True
    ):
        torch.testing.assert_close(ours, theirs)


def test_circular_padding_is_equivariant_to_rotation():
    """A place of four beams sees the beams of its own sector in its middle."""
    stream, scan = attending(), torch.rand(1, 4, 180)
    places = stream.convolve(scan)
    torch.testing.assert_close(stream.convolve(scan.roll(4, -1)), places.roll(1, -1))
    changed = scan.clone()
    changed[..., 40:44] += 1.0
    influence = (stream.convolve(changed) - places).abs().sum(1)[0]
    assert set(influence.nonzero().flatten().tolist()) <= {9, 10, 11}
    assert influence.argmax() == 10
    zeros = attending(padding_mode="zeros")
    assert not torch.allclose(zeros.convolve(scan.roll(4, -1)), zeros.convolve(scan).roll(1, -1))
