"""Speed of ICP and TAGD on scans of a drive, and of a compiled pipeline."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.envs import Transform, TransformedEnv

from navrl import keys
from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.results import Row, at_most
from navrl.benchmarks.stepping import RandomDrive
from navrl.transforms.observation_map import ObservationMap

_NUM_STEPS = 8


def perception_rows(
    env: TransformedEnv, variants: Mapping[str, tuple[Transform, Transform]], budget: Budget
) -> list[Row]:
    """Measure alignment and grouping of one scan on one core.

    Args:
        env: Environment; scans are those of the last step of a short random drive in all worlds.
        variants: ICP and TAGD transforms by name.
        budget: Duration and number of measurements.
    """
    scans = record_scans(env)
    tasks = {name: Task(_work(scans, *pair)) for name, pair in variants.items()}
    rates = alternate(tasks, budget)
    return [
        Row(f"icp_tagd.{name}", f"ICP ({name}) + TAGD, 1 core", "µs", 1e6 / rate, at_most(30.0))
        for name, rate in rates.items()
    ]


def compile_rows(
    env: TransformedEnv, steps: Sequence[ObservationMap], budget: Budget
) -> list[Row | str]:
    """Measure pooling, ICP and TAGD of all worlds, eager and by ``torch.compile``, on one core.

    Args:
        env: Environment, for the scans of the last step of a short random drive.
        steps: The pooling, ICP and TAGD transforms.
        budget: Duration and number of measurements.

    Returns:
        Rows, or the reason why there are none.
    """
    if not any(shutil.which(name) for name in ("g++", "clang++", "cl")):
        return ["compile: torch.compile needs a C++ compiler, none of g++, clang++, cl was found"]
    scans, eager = record_scans(env), _Perception(*steps)
    inputs = [scans[key] for key in (keys.RANGES, keys.PREVIOUS_POINTS, keys.PREVIOUS_RETURNS)]
    forms = {"eager": eager, "compiled": torch.compile(eager, fullgraph=True)}
    rates = alternate({name: Task(_call(form, inputs)) for name, form in forms.items()}, budget)
    times = {name: 1e3 * len(scans) / rate for name, rate in rates.items()}
    label = f"pooling + ICP + TAGD of {len(scans)} scans, 1 core"
    return [
        Row("compile.eager", label, "ms", times["eager"]),
        Row("compile.compiled", "… torch.compile", "ms", times["compiled"]),
        Row("compile.ratio", "… / eager", "x", times["compiled"] / times["eager"], at_most(1.0)),
    ]


class _Perception(nn.Module):
    def __init__(self, pool: ObservationMap, icp: ObservationMap, tagd: ObservationMap) -> None:
        super().__init__()
        self.pool, self.icp, self.tagd = pool, icp, tagd

    def forward(
        self, ranges: Tensor, points_before: Tensor, returns_before: Tensor
    ) -> list[Tensor]:
        pooled = self.pool.map_values(ranges)
        aligned = self.icp.map_values(points_before, returns_before, *pooled[1:])
        groups = self.tagd.map_values(*pooled[1:], aligned[0], returns_before)
        return [*pooled, *aligned, *groups]


def _call(form: Callable, inputs: Sequence[Tensor]) -> Callable[[], int]:
    def work() -> int:
        with torch.no_grad():
            form(*inputs)
        return len(inputs[0])

    return work


def record_scans(env: TransformedEnv) -> TensorDictBase:
    """Return the transforms' inputs after some random steps."""
    drive = RandomDrive(env)
    for _ in range(_NUM_STEPS):
        drive()
    return drive.carrier


def _work(scans: TensorDictBase, icp: Transform, tagd: Transform) -> Callable[[], int]:
    def work() -> int:
        with torch.no_grad():
            tagd(icp(scans.copy()))
        return len(scans)

    return work
