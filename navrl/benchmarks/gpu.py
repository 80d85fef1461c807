"""Rates of one GPU with many worlds: scans, complete steps, updates and training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from navrl.algos import DDPG
from navrl.benchmarks.learner import update_task
from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.results import Bar, Row, at_most
from navrl.benchmarks.scanning import NUM_BEAMS, NUM_BOXES, scan_task
from navrl.benchmarks.scenes import clutter
from navrl.benchmarks.stepping import RandomDrive
from navrl.sim import Simulator

NUM_UNMEASURED = 5  # warm-up updates, which include the recording of CUDA graphs
UPDATES_PER_CALL = 64  # updates per call, as in a training
NUM_ROOMS = 64  # distinct rooms; further worlds repeat them
EPISODES, STEPS_PER_EPISODE = 300_000, 90  # paper Sec. V-A; average length of an episode


def gpu_rows(
    simulator: Simulator,
    env: TransformedEnv,
    learners: Mapping[str, DDPG],
    batch: TensorDictBase,
    frames_per_s: Sequence[float] | np.ndarray,
    budget: Budget,
) -> list[Row]:
    """Measure a GPU; closes the environment.

    Args:
        simulator: Simulator on the GPU, for scans.
        env: Environment on the GPU with all transforms, for complete steps including resets.
        learners: Learners on the GPU by distinguishing feature; the target is set for the last.
        batch: Batch of transitions for updates.
        frames_per_s: Logged frame rates of a training on the GPU.
        budget: Duration and number of measurements.
    """
    rooms = clutter(min(NUM_ROOMS, simulator.num_worlds), NUM_BOXES)
    rooms = rooms[torch.arange(simulator.num_worlds) % len(rooms)]
    for learner in learners.values():
        for _ in range(NUM_UNMEASURED):
            learner.update(batch)
    tasks = {"scans": scan_task(simulator, rooms), "steps": Task(RandomDrive(env))}
    tasks |= {
        name: update_task(learner, batch, 1, UPDATES_PER_CALL) for name, learner in learners.items()
    }
    rates = alternate(tasks, budget)
    env.close()
    what = f"{simulator.num_worlds:,} worlds on the GPU"
    beams = f"{NUM_BEAMS:,}-beam scans, {NUM_BOXES} boxes, {what}"
    rows = [
        Row("gpu.scans", beams, "/s", rates["scans"]),
        Row("gpu.steps", f"complete steps, {what}", "/s", rates["steps"], Bar(1_000_000)),
    ]
    for name in learners:
        bar = Bar(1_500) if name == list(learners)[-1] else None
        label = f"DDPG update, batch {len(batch)}, on the GPU, {name}"
        rows.append(Row(f"gpu.update_{name}", label, "/s", rates[name], bar))
    minutes = EPISODES * STEPS_PER_EPISODE / np.asarray(frames_per_s) / 60
    paper = f"… at this rate, the paper's {EPISODES:,} episodes of {STEPS_PER_EPISODE} steps"
    rows.append(Row("gpu.training", f"training, {what}: frames", "/s", frames_per_s))
    rows.append(Row("gpu.paper", paper, "min", minutes, at_most(10.0)))
    return rows
