"""Rates of one GPU with many worlds: scans, complete steps, updates and training."""

from __future__ import annotations

from collections.abc import Mapping

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

NUM_UNMEASURED = 5  # updates, in which a recording is made
AT_A_TIME = 64  # updates that a training asks for in one call
NUM_ROOMS = 64  # that differ; worlds beyond repeat them
EPISODES, STEPS_PER_EPISODE = 300_000, 90  # paper Sec. V-A, and what an episode takes on average


def gpu_rows(
    simulator: Simulator,
    env: TransformedEnv,
    learners: Mapping[str, DDPG],
    batch: TensorDictBase,
    frames_per_s: np.ndarray,
    budget: Budget,
) -> list[Row]:
    """Measure a GPU; closes the environment.

    Args:
        simulator: On the GPU; its scans alone are measured.
        env: On the GPU with all transforms; complete steps, resets included.
        learners: On the GPU, by what is special about them; the last is held to the bar.
        batch: What they update from.
        frames_per_s: Of a training with all of this, as its log has it.
        budget: How much to measure.
    """
    rooms = clutter(min(NUM_ROOMS, simulator.num_worlds), NUM_BOXES)
    rooms = rooms[torch.arange(simulator.num_worlds) % len(rooms)]
    for learner in learners.values():
        for _ in range(NUM_UNMEASURED):
            learner.update(batch)
    tasks = {"scans": scan_task(simulator, rooms), "steps": Task(RandomDrive(env))}
    tasks |= {name: update_task(learner, batch, 1, AT_A_TIME) for name, learner in learners.items()}
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
