"""Trajectories of a batch of episodes as arrays, the input of every metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import ArrayLike

from navrl.envs import Outcome
from navrl.ops.distance import point_box_distance
from navrl.sim import Contact
from navrl.worlds import Scenario, ScenarioBatch

if TYPE_CHECKING:
    from navrl.evaluation.recording import Recording

_CONTACTS = {  # for recordings without the at-fault party
    Outcome.COLLISION_STATIC: Contact.STATIC,
    Outcome.COLLISION_PEDESTRIAN: Contact.PEDESTRIAN,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Batch of E episodes, the longest with T steps.

    Sample t of an episode is its state t time steps after the start; sample 0 is the start and
    sample ``num_steps`` the end. Later samples are NaN and ignored: a metric of an episode does not
    depend, bit for bit, on the other episodes of the batch.

    Args:
        time_step_s: Time between samples, s. A step with a contact ends at the contact.
        robot_radius: Radius of the robot, m.
        max_speed: Speed limit of the robot, m/s.
        num_steps: ``[E]`` int64, at least 1.
        outcome: ``[E]`` codes of :class:`navrl.envs.Outcome`.
        contact: ``[E]`` codes of :class:`navrl.sim.Contact` at the end.
        pose: ``[E, T + 1, 3]`` (x, y, yaw) of the robot, m and rad, world.
        pedestrians: ``[E, T + 1, K, 5]`` (cx, cy, hx, hy, yaw), m and rad, world; NaN rows for
            absent ones.
        command: ``[E, T, C]`` driven command of each step, e.g. (v, w), m/s and rad/s; NaN if
            unknown.
        requested: ``[E, T, C]`` the policy's command of each step, before a shield; NaN if unknown.
        boxes: ``[E, W, 5]`` walls and furniture, m and rad, world; NaN rows are padding.
        is_furniture: ``[E, W]`` bool.
        path: ``[E, P, 2]`` m, world; the planned path, padded by repeating the goal.
        planned_length: ``[E]`` m, length of that path.

    Raises:
        ValueError: If a shape does not fit; the message names the array.

    Example:
        >>> drive = Trajectory.of_positions([(0, 0), (3, 4)])
        >>> len(drive), drive.num_steps, drive.planned_length
        (1, array([1]), array([5.], dtype=float32))
    """

    time_step_s: float
    robot_radius: float
    max_speed: float
    num_steps: np.ndarray
    outcome: np.ndarray
    contact: np.ndarray
    pose: np.ndarray
    pedestrians: np.ndarray
    command: np.ndarray
    requested: np.ndarray
    boxes: np.ndarray
    is_furniture: np.ndarray
    path: np.ndarray
    planned_length: np.ndarray

    def __post_init__(self) -> None:
        episodes, samples = np.shape(self.pose)[:2]
        expected = {
            "num_steps": (episodes,),
            "outcome": (episodes,),
            "contact": (episodes,),
            "pose": (episodes, samples, 3),
            "pedestrians": (episodes, samples, None, 5),
            "command": (episodes, samples - 1, None),
            "requested": (episodes, samples - 1, *np.shape(self.command)[2:]),
            "boxes": (episodes, None, 5),
            "is_furniture": (episodes, np.shape(self.boxes)[1]),
            "path": (episodes, None, 2),
            "planned_length": (episodes,),
        }
        for name, shape in expected.items():
            got = np.shape(getattr(self, name))
            if len(got) != len(shape) or not all(
                want in (None, have) for want, have in zip(shape, got, strict=True)
            ):
                raise ValueError(f"{name}.shape={list(got)}: must be {list(shape)}")
        if not ((self.num_steps >= 1) & (self.num_steps < samples)).all():
            raise ValueError(f"num_steps={self.num_steps}: must be in 1 to {samples - 1}")

    def __len__(self) -> int:
        return len(self.num_steps)

    @cached_property
    def is_sample(self) -> np.ndarray:
        """Mask ``[E, T + 1]`` of samples that are part of their episode."""
        return np.arange(self.pose.shape[1]) <= self.num_steps[:, None]

    @cached_property
    def is_whole_step(self) -> np.ndarray:
        """Mask ``[E, T]`` of steps of their episode that are not cut short by a contact."""
        cut = (self.contact != Contact.NONE)[:, None]
        return np.arange(self.pose.shape[1] - 1) < self.num_steps[:, None] - cut

    @cached_property
    def is_command(self) -> np.ndarray:
        """Mask ``[E, T]`` of steps of their episode with a known command (v, w)."""
        if self.command.shape[2] != 2:
            return np.zeros(self.command.shape[:2], dtype=bool)
        return self.is_sample[:, 1:] & ~np.isnan(self.command).any(-1)

    @cached_property
    def clearances(self) -> np.ndarray:
        """Distance ``[E, T + 1, K]`` m from the robot's hull to each pedestrian.

        Infinite for absent pedestrians, zero at a contact; samples after the end are infinite.
        """
        center = torch.from_numpy(np.ascontiguousarray(self.pose[..., :2]))
        boxes = torch.from_numpy(np.ascontiguousarray(self.pedestrians))
        return (point_box_distance(center, boxes).numpy() - self.robot_radius).clip(min=0.0)

    @classmethod
    def of_positions(
        cls,
        positions: Sequence[Sequence[float]],
        *,
        yaw: float | Sequence[float] = 0.0,
        people: Sequence[ArrayLike] = (),
        command: Sequence[Sequence[float]] | None = None,
        requested: Sequence[Sequence[float]] | None = None,
        boxes: Sequence[Sequence[float]] = (),
        num_furniture: int = 0,
        path: Sequence[Sequence[float]] | None = None,
        outcome: Outcome = Outcome.SUCCESS,
        contact: Contact = Contact.NONE,
        time_step_s: float = 0.2,
        robot_radius: float = 0.2,
        max_speed: float = 1.0,
    ) -> Trajectory:
        """Build one episode from the robot's positions, e.g. to test a metric on known numbers.

        Args:
            positions: (x, y) of each sample, m, world.
            yaw: Of all samples or of each, rad, world.
            people: Box (cx, cy, hx, hy, yaw) of each pedestrian, of all samples or of each.
            command: Driven (v, w) of each step; None is unknown.
            requested: The policy's (v, w) of each step; None is the driven one.
            boxes: Box of each wall, then of each piece of furniture.
            num_furniture: Number of furniture boxes.
            path: (x, y) of the planned path; None is the straight line.
            outcome: Of the episode.
            contact: At the end.
            time_step_s: See the class.
            robot_radius: See the class.
            max_speed: See the class.
        """
        count = len(positions)
        pose = np.zeros((1, count, 3))
        pose[0, :, :2], pose[0, :, 2] = positions, yaw
        pedestrians = np.zeros((1, count, len(people), 5))
        for index, series in enumerate(people):
            pedestrians[0, :, index] = series
        driven = np.full((1, count - 1, 2), np.nan)
        if command is not None:
            driven[0] = command
        planned = np.array((positions[0], positions[-1]) if path is None else path, np.float32)
        walls = np.array(boxes, dtype=float).reshape(1, -1, 5)
        return cls(
            time_step_s=time_step_s,
            robot_radius=robot_radius,
            max_speed=max_speed,
            num_steps=np.array([count - 1]),
            outcome=np.array([outcome]),
            contact=np.array([contact]),
            pose=pose,
            pedestrians=pedestrians,
            command=driven,
            requested=driven if requested is None else np.array([requested], dtype=float),
            boxes=walls,
            is_furniture=np.arange(walls.shape[1])[None] >= walls.shape[1] - num_furniture,
            path=planned[None],
            planned_length=np.linalg.norm(np.diff(planned, axis=0), axis=1).sum()[None],
        )

    @classmethod
    def from_series(
        cls,
        scenarios: ScenarioBatch,
        pose: np.ndarray,
        pedestrians: np.ndarray,
        command: np.ndarray,
        requested: np.ndarray,
        num_steps: np.ndarray,
        outcome: np.ndarray,
        contact: np.ndarray,
        **constants: float,
    ) -> Trajectory:
        """Build from time series; rows after an episode's end are ignored.

        Args:
            scenarios: Played scenarios, one per row.
            pose: See the class.
            pedestrians: See the class.
            command: See the class.
            requested: See the class.
            num_steps: See the class.
            outcome: See the class.
            contact: See the class.
            constants: ``time_step_s``, ``robot_radius`` and ``max_speed``.
        """
        over = np.arange(pose.shape[1]) > num_steps[:, None]
        pose, pedestrians = pose.astype(np.float64), pedestrians.astype(np.float64)
        pose[over], pedestrians[over] = np.nan, np.nan
        command, requested = command.astype(np.float64), requested.astype(np.float64)
        command[over[:, 1:]], requested[over[:, 1:]] = np.nan, np.nan
        index = torch.arange(scenarios.boxes.shape[1])
        is_box = index < scenarios.num_boxes[:, None]
        is_furniture = is_box & (index >= (scenarios.num_boxes - scenarios.num_furniture)[:, None])
        return cls(
            num_steps=num_steps,
            outcome=outcome,
            contact=contact,
            pose=pose,
            pedestrians=pedestrians,
            command=command,
            requested=requested,
            boxes=scenarios.boxes.masked_fill(~is_box[..., None], torch.nan).numpy(),
            is_furniture=is_furniture.numpy(),
            path=scenarios.path.numpy(),
            planned_length=scenarios.path_length.numpy(),
            **constants,
        )

    @classmethod
    def from_recordings(cls, recordings: Sequence[Recording], max_speed: float) -> Trajectory:
        """Build from recordings of any lengths with the same robot and time step.

        Args:
            recordings: At least one.
            max_speed: Speed limit of the robot, m/s.

        Raises:
            ValueError: If there are no recordings, or robots or time steps differ.
        """
        constants = {(r.time_step_s, r.robot_radius) for r in recordings}
        if len(constants) != 1:
            raise ValueError(
                f"recordings: must have one robot and one time step, got {len(constants)}"
            )
        ((time_step_s, robot_radius),) = constants
        steps = np.array([r.num_steps for r in recordings])
        outcomes = [Outcome[r.outcome.upper()] for r in recordings]
        people = max(r.pedestrian_boxes.shape[1] for r in recordings)
        shape = (len(steps), steps.max() + 1)
        pose, pedestrians = np.full((*shape, 3), np.nan), np.full((*shape, people, 5), np.nan)
        size = recordings[0].action.shape[1]
        command, requested = np.full((2, len(steps), steps.max(), size), np.nan)
        for row, recording in enumerate(recordings):
            boxes = recording.pedestrian_boxes
            pose[row, : len(boxes)] = recording.pose
            pedestrians[row, : len(boxes), : boxes.shape[1]] = boxes
            command[row, : recording.num_steps] = recording.action
            if recording.requested is not None:
                requested[row, : recording.num_steps] = recording.requested
        contact = [
            _CONTACTS.get(outcome, Contact.NONE) if r.contact is None else r.contact
            for r, outcome in zip(recordings, outcomes, strict=True)
        ]
        return cls.from_series(
            ScenarioBatch.pack([Scenario.from_json(r.scenario) for r in recordings]),
            pose,
            pedestrians,
            command,
            requested,
            steps,
            np.array(outcomes, dtype=np.int64),
            np.array(contact, dtype=np.int64),
            time_step_s=time_step_s,
            robot_radius=robot_radius,
            max_speed=max_speed,
        )


def total(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Return the sum ``[E]`` of ``values [E, T]`` where ``counted [E, T]``.

    The terms are added sequentially: numpy's sum groups terms by the array's length, so an
    episode's last digit would depend on the longest episode of the batch.
    """
    if values.shape[1] == 0:
        return np.zeros(len(values))
    return np.where(counted, values, 0.0).cumsum(axis=1)[:, -1]


def mean(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Return the mean ``[E]`` of ``values [E, T]`` where ``counted``; NaN without any."""
    count = counted.sum(axis=1)
    return np.where(count > 0, total(values, counted) / np.maximum(count, 1), np.nan)


def largest(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Return the maximum ``[E]`` of ``values [E, T]`` where ``counted``; NaN without any."""
    found = np.where(counted, values, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(counted.any(axis=1), found, np.nan)
