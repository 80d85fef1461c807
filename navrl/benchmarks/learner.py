"""Rate of DDPG updates relative to the machine's rate of matrix products."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode
from torchrl.objectives import DDPGLoss

from navrl import keys
from navrl.algos import DDPG
from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.results import Bar, Row

MakeLearner = Callable[..., DDPG]
"""Maps ``precision`` and ``device`` to a learner with new weights."""

DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16}
ROWS_PER_SAMPLE, WIDTH_IN, WIDTH_OUT = 30, 256, 128  # dominant layer of the paper's networks


def random_transitions(
    shapes: Mapping[str, Sequence[int]], batch_size: int, device: str = "cpu"
) -> TensorDictBase:
    """Return transitions in the format of the replay, with uniformly random observations."""
    generator = torch.Generator().manual_seed(0)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(batch_size, *shape, generator=generator) * 2 - 1

    def observation() -> dict[str, Tensor]:
        return {key: uniform(*shape) for key, shape in shapes.items()}

    ended = uniform(1) > 0.9
    following = {**observation(), "reward": uniform(1), "done": ended, "terminated": ended}
    batch = {
        **observation(),
        keys.ACTION: uniform(2),
        "next": TensorDict(following, [batch_size]),
    }
    return TensorDict(batch, [batch_size]).to(device)


def count_flops(learner: DDPG, batch: TensorDictBase, textbook: bool = True) -> int:
    """Return the floating-point operations of the matrix products of one update.

    Args:
        learner: Learner with networks in float32.
        batch: Transitions.
        textbook: Whether to count the operations of TorchRL's loss instead of those of this
            learner.
    """
    counter = FlopCounterMode(display=False)
    counter.mod_tracker = _OneModule()
    with counter:
        if textbook:
            terms = DDPGLoss.forward(learner.loss, batch)
            (terms["loss_actor"] + terms["loss_value"]).backward()
        else:
            learner.update(batch)
    return counter.get_total_flops()


class _OneModule:
    """Replacement of torch's module tracker, which fails for parameters in a TensorDict."""

    parents = ("Global",)

    def __enter__(self) -> None:
        return None

    def __exit__(self, *_: object) -> None:
        return None


def update_task(
    learner: DDPG, batch: TensorDictBase, num_threads: int, updates_per_call: int = 1
) -> Task:
    """Return a task whose unit is one update, with ``updates_per_call`` updates per call."""
    batches = batch.expand(updates_per_call, *batch.shape)

    def update() -> int:
        if updates_per_call == 1:
            learner.update(batch)
        else:
            learner.update_from_each(batches)
        _wait(batch.device)
        return updates_per_call

    return Task(update, num_threads)


def product_task(dtype: torch.dtype, batch_size: int, num_threads: int, device: str) -> Task:
    """Return a task whose unit is one matrix product with the shape of the dominant layer."""
    rows = ROWS_PER_SAMPLE * batch_size
    left = torch.randn(rows, WIDTH_IN, device=device).to(dtype)
    right = torch.randn(WIDTH_IN, WIDTH_OUT, device=device).to(dtype)
    out = torch.empty(rows, WIDTH_OUT, device=device, dtype=dtype)

    def product() -> int:
        for _ in range(10):
            torch.mm(left, right, out=out)
        _wait(out.device)
        return 10

    return Task(product, num_threads)


def update_rows(
    make: MakeLearner,
    shapes: Mapping[str, Sequence[int]],
    batch_size: int,
    chosen: str,
    budget: Budget,
    cores: int,
    device: str = "cpu",
) -> list[Row]:
    """Measure updates and their upper bound in float32 and bfloat16.

    Args:
        make: Builds the learner.
        shapes: Feature shape of every key that the networks read.
        batch_size: Transitions per update.
        chosen: Precision of the training configuration, for which the target is set.
        budget: Duration and number of measurements.
        cores: Number of threads.
        device: ``cpu`` or ``cuda``.
    """
    batch = random_transitions(shapes, batch_size, device)
    flops = count_flops(make(precision="float32", device=device), batch)
    done = count_flops(make(precision="float32", device=device), batch, textbook=False)
    tasks = {}
    for name, dtype in DTYPES.items():
        learner = make(precision=name, device=device)
        tasks[f"{name} update"] = update_task(learner, batch, cores)
        tasks[f"{name} product"] = product_task(dtype, batch_size, cores, device)
    rates = alternate(tasks, budget)
    place = "GPU" if device == "cuda" else f"{cores} core{'s' if cores > 1 else ''}"
    key = "update" if device == "cpu" else f"update_{device}"
    label = f"DDPG update, batch {batch_size}, {place}"
    rows = [
        Row(f"{key}.flops", f"{label}: operations of TorchRL's loss", "GFLOP", [flops / 1e9]),
        Row(f"{key}.done", "… operations that ours does for it", "GFLOP", [done / 1e9]),
    ]
    for name in DTYPES:
        rows += _precision_rows(
            f"{key}.{name}", f"… {name}", flops, batch_size, rates, name, name == chosen
        )
    return rows


def _precision_rows(
    key: str, label: str, flops: int, batch_size: int, rates: Mapping, name: str, has_bar: bool
) -> list[Row]:
    per_product = 2 * ROWS_PER_SAMPLE * batch_size * WIDTH_IN * WIDTH_OUT
    ceiling = rates[f"{name} product"] * per_product
    updates = rates[f"{name} update"]
    shape = f"{ROWS_PER_SAMPLE * batch_size}x{WIDTH_IN} @ {WIDTH_IN}x{WIDTH_OUT}"
    share = 100 * updates * flops / ceiling
    return [
        Row(f"{key}.updates", label, "/s", updates),
        Row(f"{key}.ceiling", f"{label}: ceiling, {shape}", "GFLOP/s", ceiling / 1e9),
        Row(f"{key}.share", f"{label}: of the ceiling", "%", share, Bar(50.0) if has_bar else None),
    ]


def _wait(device: torch.device | None) -> None:
    if device is not None and device.type == "cuda":
        torch.cuda.synchronize()
