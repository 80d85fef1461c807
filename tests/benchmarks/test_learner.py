"""Operations of an update: torch's count against one by hand."""

import functools

import pytest
from torch import nn

from navrl.benchmarks import Budget, count_flops, random_transitions, update_rows
from navrl.config import compose, instantiate
from navrl.factory import make_agent

SHAPES = {"spatial": [180, 2], "temporal": [30, 4], "waypoints_scaled": [5, 2]}
ITEMS = 30  # sectors, or descriptors, that the layers of a stream run on


def products(layers) -> list[int]:
    return [layer.in_features * layer.out_features for layer in layers]


def linear_layers(module) -> list[nn.Linear]:
    return [layer for layer in module.modules() if isinstance(layer, nn.Linear)]


def multiplications(network) -> tuple[int, int, int]:
    """Of one sample: forward, of the first layers, and of the output module."""
    total = first = 0
    for stream in network.encoder.streams.values():
        attention = stream.attention
        layers = sum(products(linear_layers(attention)))
        weighing = attention.out_features  # the weighted sum of the features
        total += ITEMS * (layers + weighing)
        first += ITEMS * products(linear_layers(attention))[0]
    output = sum(products(linear_layers(network.output)))
    return total + output, first, output


@pytest.mark.parametrize("batch_size", [4, 32])
def test_flops_of_the_papers_network_match_a_manual_count(batch_size):
    cfg = compose("train", ["experiment=paper"])
    actor, critic = make_agent(cfg, SHAPES)
    (actor_all, actor_first, _), (critic_all, critic_first, critic_output) = (
        multiplications(network.module) for network in (actor, critic)
    )
    forward = 2 * actor_all + 3 * critic_all  # online and target; the critic judges two actions
    # A backward pass has a product for the weights and one for the inputs of each layer; inputs of
    # the first need none. The actor's loss passes back through the critic's output module alone.
    backward = 2 * (actor_all + critic_all) - actor_first - critic_first + critic_output
    by_hand = 2 * batch_size * (forward + backward)
    learner = instantiate(cfg.algorithm, actor=actor, critic=critic, precision="float32")
    batch = random_transitions(SHAPES, batch_size)
    assert count_flops(learner, batch) == pytest.approx(by_hand, rel=0.02)
    once = 2 * batch_size * (critic_all - critic_output)  # one observation is encoded once
    done = count_flops(learner, batch, textbook=False)
    assert done == pytest.approx(by_hand - once, rel=0.02)


def test_random_transitions_fit_the_learner():
    batch = random_transitions(SHAPES, 100)
    assert batch.batch_size == (100,)
    assert batch["spatial"].shape == (100, 180, 2)
    assert batch["next", "temporal"].abs().max() <= 1
    assert batch["next", "done"].any() and not batch["next", "done"].all()
    same = functools.partial(random_transitions, SHAPES, 100)
    assert (same() == same()).all()


@pytest.mark.gpu
def test_cuda_device_has_its_own_rows():
    cfg = compose("train", ["experiment=paper"])

    def make(precision, device):
        actor, critic = (network.to(device) for network in make_agent(cfg, SHAPES))
        return instantiate(cfg.algorithm, actor=actor, critic=critic, precision=precision)

    rows = update_rows(make, SHAPES, 16, "bfloat16", Budget(0.01, 2), 1, "cuda")
    assert [row.key for row in rows][:2] == ["update_cuda.flops", "update_cuda.done"]
    assert all(row.median > 0 for row in rows)
