"""Layers taken together give what they give one by one, gradients included."""

import pytest
import torch
from torch import nn

from navrl.networks.fused_layers import can_fuse, fused_layers
from navrl.networks.mlp import Perceptron, mlp

SIZES = (16, 8, 4)
fused = pytest.mark.skipif(
    not can_fuse(torch.ones(1, dtype=torch.bfloat16)), reason="oneDNN has no bfloat16 here"
)


def network(activate_last=True):
    torch.manual_seed(0)
    return mlp(22, SIZES, activate_last=activate_last)


def points(dtype=torch.float32, requires_grad=True):
    generator = torch.Generator().manual_seed(1)
    return torch.randn((4, 30, 22), generator=generator).to(dtype).requires_grad_(requires_grad)


def gradients(layers, value):
    output = layers(value)
    weights = torch.linspace(-1, 1, output.numel()).view(output.shape)
    (output.float() * weights).sum().backward()
    return output.detach(), [value.grad, *(parameter.grad for parameter in layers.parameters())]


@pytest.mark.parametrize("activate_last", [False, True])
@pytest.mark.parametrize(("precision", "tolerance"), [(None, 1e-5), (torch.bfloat16, 2e-2)])
def test_values_and_gradients_equal_the_single_layers(precision, tolerance, activate_last):
    results = []
    for layers in (network(activate_last), nn.Sequential(*network(activate_last))):
        with torch.autocast("cpu", precision, enabled=precision is not None):
            results.append(gradients(layers, points()))
    (together, ours), (plain, theirs) = results
    assert together.dtype == plain.dtype == (precision or torch.float32)
    torch.testing.assert_close(together, plain, atol=tolerance, rtol=tolerance)
    for one, other in zip(ours, theirs, strict=True):
        assert one.dtype == other.dtype == torch.float32
        torch.testing.assert_close(one, other, atol=20 * tolerance, rtol=tolerance)


@fused
@pytest.mark.parametrize("learning", [["value"], ["0"], ["2"], ["4"], ["value", "2"], ["0", "4"]])
def test_gradients_are_computed_only_where_required(learning):
    layers, value = network(), points(requires_grad="value" in learning)
    for name, parameter in layers.named_parameters():
        parameter.requires_grad_(name.split(".")[0] in learning)
    with torch.autocast("cpu", torch.bfloat16):
        _, found = gradients(layers, value)
    tensors = [value, *layers.parameters()]
    assert [grad is not None for grad in found] == [tensor.requires_grad for tensor in tensors]


@fused
def test_bias_only_gradient_is_computed():
    layers = [(torch.ones(2, 3), torch.zeros(2, requires_grad=True), True)]
    fused_layers(torch.ones(5, 3), layers).sum().backward()
    assert layers[0][1].grad.tolist() == [5.0, 5.0]


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_unsupported_inputs_use_single_layers(dtype):
    layers = network().to(dtype)
    value = points(dtype, requires_grad=False)
    expected = nn.Sequential(*layers)(value)
    torch.testing.assert_close(torch.vmap(layers)(value), expected)
    torch.testing.assert_close(layers(value), expected)
    layers, value = layers.float(), value.float()
    with torch.autocast("cpu", torch.bfloat16):
        assert not can_fuse(value[:0])
        assert layers(value[:0]).shape == (0, 30, SIZES[-1])
        assert torch.vmap(layers)(value).shape == layers(value).shape


@pytest.mark.parametrize(
    "layers",
    [
        [nn.ReLU(), nn.Linear(3, 3), nn.Tanh(), nn.Linear(3, 2), nn.Linear(2, 1)],
        [nn.Linear(3, 3), nn.ReLU(), nn.ReLU()],
        [nn.Linear(3, 3, bias=False), nn.ReLU()],
        [nn.Linear(3, 3), nn.Linear(3, 3), nn.ReLU()],
    ],
)
def test_fused_layers_accept_any_layer_sequence(layers):
    value = torch.randn(5, 3)
    for enabled in (False, True):
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            expected = nn.Sequential(*layers)(value)
            torch.testing.assert_close(Perceptron(*layers)(value), expected, atol=2e-2, rtol=2e-2)
    assert isinstance(network()[1:], Perceptron)
