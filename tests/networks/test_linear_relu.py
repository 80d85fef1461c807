"""One fused step gives what a linear layer and its ReLU give, gradients included."""

import pytest
import torch
from torch import nn
from torch.nn.functional import linear

from navrl.networks.linear_relu import linear_relu
from navrl.networks.mlp import Perceptron, mlp


def operands(dtype=torch.float32, requires_grad=True):
    generator = torch.Generator().manual_seed(0)
    shapes = ((4, 30, 22), (64, 22), (64,))
    return [
        torch.randn(shape, generator=generator).to(dtype).requires_grad_(requires_grad)
        for shape in shapes
    ]


def gradients(function, inputs):
    output = function(*inputs)
    weights = torch.linspace(-1, 1, output.numel()).view(output.shape)
    (output.float() * weights).sum().backward()
    return output.detach(), [value.grad for value in inputs]


def two_steps(value, weight, bias):
    return linear(value, weight, bias).relu()


@pytest.mark.parametrize(("precision", "tolerance"), [(None, 1e-5), (torch.bfloat16, 2e-2)])
def test_values_and_gradients_equal_the_two_steps(precision, tolerance):
    results = []
    for function in (linear_relu, two_steps):
        with torch.autocast("cpu", precision, enabled=precision is not None):
            results.append(gradients(function, operands()))
    (fused, ours), (plain, theirs) = results
    assert fused.dtype == plain.dtype == (precision or torch.float32)
    torch.testing.assert_close(fused, plain, atol=tolerance, rtol=tolerance)
    for one, other in zip(ours, theirs, strict=True):
        assert one.dtype == other.dtype == torch.float32
        torch.testing.assert_close(one, other, atol=20 * tolerance, rtol=tolerance)


def test_only_what_is_asked_for_gets_a_gradient():
    value, weight, bias = operands()
    value.requires_grad_(False)
    linear_relu(value, weight, bias).sum().backward()
    assert value.grad is None and weight.grad is not None and bias.grad is not None
    value, weight, bias = operands(requires_grad=False)
    value.requires_grad_()
    linear_relu(value, weight, bias).sum().backward()
    assert value.grad is not None and weight.grad is None


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_other_types_transforms_and_empty_batches_take_the_two_steps(dtype):
    value, weight, bias = operands(dtype, requires_grad=False)
    expected = two_steps(value, weight, bias)
    mapped = torch.vmap(linear_relu, in_dims=(0, None, None))(value, weight, bias)
    torch.testing.assert_close(mapped, expected)
    torch.testing.assert_close(linear_relu(value, weight, bias), expected)
    assert linear_relu(value[:0], weight, bias).shape == (0, 30, 64)


def test_a_perceptron_is_the_sequence_of_its_layers():
    torch.manual_seed(0)
    for activate_last in (False, True):
        network = mlp(22, (16, 8, 4), activate_last=activate_last)
        expected = value = torch.randn(5, 22)
        for layer in network:
            expected = layer(expected)
        torch.testing.assert_close(network(value), expected)
        assert isinstance(network[1:], Perceptron)
    odd = Perceptron(nn.ReLU(), nn.Linear(3, 3), nn.Tanh(), nn.Linear(3, 2), nn.Linear(2, 1))
    value = torch.randn(5, 3)
    torch.testing.assert_close(odd(value), nn.Sequential(*odd)(value))
