"""Speed of simulators: scans, and steps with scans."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.results import Bar, Row, Series, at_most
from navrl.benchmarks.scenes import clutter
from navrl.sim import Simulator
from navrl.worlds import ScenarioBatch

MakeSimulator = Callable[..., Simulator]
"""Maps ``num_worlds``, ``num_beams`` and ``max_pedestrians`` to a simulator."""

NUM_BEAMS, NUM_BOXES = 1440, 32


def scan_task(simulator: Simulator, scenes: ScenarioBatch, num_threads: int = 1) -> Task:
    """Return a task whose unit is one noise-free scan.

    Robots turn between scans, which is not measured, because a simulator may cache the scan of a
    stationary world.
    """
    turn = _turning(simulator, scenes)

    def scan() -> int:
        simulator.ranges()
        return simulator.num_worlds

    return Task(scan, num_threads, turn)


def drive_task(simulator: Simulator, scenes: ScenarioBatch, num_threads: int = 1) -> Task:
    """Return a task whose unit is one step and one noise-free scan, robots turning in place."""
    turn = _turning(simulator, scenes)

    def drive() -> int:
        turn()
        simulator.ranges()
        return simulator.num_worlds

    return Task(drive, num_threads)


def _turning(simulator: Simulator, scenes: ScenarioBatch) -> Callable[[], None]:
    """Reset the worlds; return a function that turns every robot in place for one step."""
    simulator.reset(torch.arange(simulator.num_worlds), scenes)
    command = torch.zeros(simulator.num_worlds, 2)
    command[:, 1] = torch.linspace(0.5, 1.0, simulator.num_worlds)
    command[::2, 1] *= -1  # no stationary robot, for any number

    def turn() -> None:
        simulator.step(command)

    return turn


def scan_rows(
    make: MakeSimulator, make_reference: MakeSimulator, num_worlds: int, budget: Budget, cores: int
) -> list[Row]:
    """Measure scans of 32 boxes against those of PyBullet.

    Args:
        make: Builds the batched simulator.
        make_reference: Builds the PyBullet simulator.
        num_worlds: Worlds of the batched simulator.
        budget: Duration and number of measurements.
        cores: Number of threads in the row for all cores.
    """
    simulator, reference = make(num_worlds), make_reference(4)
    scenes = clutter(num_worlds, NUM_BOXES)
    tasks = {
        "one": scan_task(simulator, scenes),
        "bullet": scan_task(reference, clutter(4, NUM_BOXES)),
    }
    if cores > 1:
        tasks["all"] = scan_task(simulator, scenes, cores)
    rates = alternate(tasks, budget)
    reference.close()
    one, what = rates["one"], f"{NUM_BEAMS:,}-beam scans, {NUM_BOXES} boxes"
    rows = [Row("scan.one_core", f"{what}, 1 core", "/s", one, Bar(30_000))]
    rows.append(Row("scan.beams", "… beams", "million/s", one * NUM_BEAMS / 1e6))
    if cores > 1:
        rows.append(Row("scan.all_cores", f"… {cores} cores", "/s", rates["all"]))
        rows.append(Row("scan.speedup", f"… {cores} cores / 1 core", "x", rates["all"] / one))
    rows.append(Row("scan.bullet", "… in PyBullet", "/s", rates["bullet"]))
    rows.append(Row("scan.ratio", "… 1 core / PyBullet", "x", one / rates["bullet"]))
    return rows


def growth_series(
    make: MakeSimulator,
    num_worlds: int,
    budget: Budget,
    beams: Sequence[int],
    boxes: Sequence[int],
    pedestrians: Sequence[int],
) -> list[Series]:
    """Measure the growth of the time of a step and scan with beams, boxes and pedestrians.

    Args:
        make: Builds the simulator.
        num_worlds: Number of worlds.
        budget: Duration and number of measurements.
        beams: Numbers of beams, among 32 boxes.
        boxes: Numbers of boxes, for 1,440 beams.
        pedestrians: Numbers of pedestrians among 4 walls, for 1,440 beams.
    """
    room = clutter(num_worlds, NUM_BOXES)

    def of_beams(count: int) -> Task:
        return drive_task(make(num_worlds, num_beams=count), room)

    def of_boxes(count: int) -> Task:
        return drive_task(make(num_worlds), clutter(num_worlds, count))

    def of_pedestrians(count: int) -> Task:
        return drive_task(make(num_worlds, max_pedestrians=count), clutter(num_worlds, 4, count))

    linear = at_most(1.0)
    return [
        _growth("beams", beams, of_beams, budget, linear),
        _growth("boxes", boxes, of_boxes, budget, linear),
        _growth("pedestrians", pedestrians, of_pedestrians, budget, None),
    ]


def _growth(
    size: str, sizes: Sequence[int], task: Callable[[int], Task], budget: Budget, bar: Bar | None
) -> Series:
    rates = alternate({str(n): task(n) for n in sizes}, budget)
    costs_us = 1e6 / np.stack([rates[str(n)] for n in sizes], axis=-1)
    return Series(size, "one world's step and scan", size, "µs", sizes, costs_us, bar)
