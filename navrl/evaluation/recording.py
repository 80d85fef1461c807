"""Recordings of episodes as arrays in one file, replayed without a simulator."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from navrl import keys
from navrl.envs import NavigationEnv
from navrl.evaluation.recording_checks import check_finite, check_plain, check_shape
from navrl.evaluation.rounding import restored, rounded
from navrl.files import replacing
from navrl.untrusted import DamagedFileError, read_arrays
from navrl.worlds import Scenario

_FORMAT = "navrl-recording-1"
_REMEDY = "delete it or record the episode again"
TERM = f"{keys.REWARD_TERMS}/"
REQUESTED = "requested"  # the policy's command before a shield
OBSERVED = {  # shape without the time axis; None is any size
    keys.POSE: (3,),
    keys.PEDESTRIAN_BOXES: (None, 5),
    keys.RANGES: (None,),
    keys.POINTS: (None, 2),
    keys.ALIGNED_POINTS: (None, 2),
    keys.TAGD: (None, 4),
    keys.TAGD_VALID: (None, 2),
    keys.WAYPOINTS: (None, 2),
}
DECIDED = {
    keys.ACTION: (None,),
    REQUESTED: (None,),
    keys.SPATIAL_ATTENTION: (None,),
    keys.TEMPORAL_ATTENTION: (None,),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Observations, decisions and rewards of an episode of T steps.

    Observations have T + 1 rows, row t before step t and the last one after the end; decisions and
    rewards have T. Arrays that a pipeline or policy does not produce (an ablation without TAGDs, a
    controller without attention) are ``None``. Names and frames are those of :mod:`navrl.keys`.

    Args:
        scenario: The episode's :class:`navrl.worlds.Scenario` as JSON, which can be played again.
        outcome: ``success``, ``collision_pedestrian``, ``collision_static`` or ``timeout``.
        time_step_s: Time between samples, s.
        robot_radius: Radius of the robot, m.
        goal_radius: Distance to the goal that counts as success, m.
        max_range: Range of a beam without return, m.
        walls: ``[W, 5]`` boxes (cx, cy, hx, hy, yaw), m and rad, world, then the bounding squares
            of discs; ``scenario`` has their heights.
        path: ``[P, 2]`` m, world.
        goal: ``[2]`` m, world.
        pose: ``[T + 1, 3]`` (x, y, yaw), world.
        pedestrian_boxes: ``[T + 1, K, 5]`` m and rad, world; NaN for absent ones.
        ranges: ``[T + 1, beams]`` m, the noisy scan, beam 0 along the lidar's x axis.
        points: ``[T + 1, N, 2]`` m, the pooled scan, robot frame.
        points_aligned: ``[T + 1, N, 2]`` m, the previous scan in the current robot frame.
        tagd: ``[T + 1, N_c, 4]`` m, (c_{t-1}, c_t), robot frame.
        tagd_valid: ``[T + 1, N_c, 2]`` bool, which centroids are valid.
        waypoints: ``[T + 1, N_f, 2]`` m, robot frame.
        action: ``[T, C]`` driven command, e.g. (v, w) in m/s and rad/s, as the simulator got it.
        requested: ``[T, C]`` the policy's command before a shield; ``None`` in older files.
        spatial_attention: ``[T, N_b]``, sums to 1.
        temporal_attention: ``[T, N_c]``, sums to 1.
        reward_terms: ``[T]`` weighted contribution of each term, by name.
        lidar_mount: ``[3]`` (x, y, yaw) of the lidar in the robot frame, m and rad; ``None`` (older
            files) for the robot's center.
        lidar_angles: ``[2]`` angle of beam 0 and from beam to beam, rad, in the lidar's frame;
            ``None`` (older files) for a full circle from beam 0 ahead.
        contact: Code of :class:`navrl.sim.Contact` at the end, with the at-fault party; ``None`` in
            older files.

    Raises:
        ValueError: If a shape does not fit; the message names the array.
    """

    scenario: str
    outcome: str
    time_step_s: float
    robot_radius: float
    goal_radius: float
    max_range: float
    walls: np.ndarray
    path: np.ndarray
    goal: np.ndarray
    pose: np.ndarray
    pedestrian_boxes: np.ndarray
    ranges: np.ndarray
    action: np.ndarray
    reward_terms: dict[str, np.ndarray]
    points: np.ndarray | None = None
    points_aligned: np.ndarray | None = None
    tagd: np.ndarray | None = None
    tagd_valid: np.ndarray | None = None
    waypoints: np.ndarray | None = None
    requested: np.ndarray | None = None
    spatial_attention: np.ndarray | None = None
    temporal_attention: np.ndarray | None = None
    contact: int | None = None
    lidar_mount: np.ndarray | None = None
    lidar_angles: np.ndarray | None = None

    def __post_init__(self) -> None:
        steps = self.num_steps
        expected = {"walls": (None, 5), "path": (None, 2), "goal": (2,), "lidar_mount": (3,)}
        expected["lidar_angles"] = (2,)
        expected |= {name: (steps + 1, *shape) for name, shape in OBSERVED.items()}
        expected |= {name: (steps, *shape) for name, shape in DECIDED.items()}
        arrays = {name: getattr(self, name) for name in expected}
        for name, term in self.reward_terms.items():
            expected[TERM + name], arrays[TERM + name] = (steps,), term
        for name, array in arrays.items():
            if array is not None:
                check_shape(name, array, expected[name])

    @classmethod
    def of_episode(
        cls, scenario: Scenario, outcome: str, env: NavigationEnv, **series: Any
    ) -> Recording:
        """Build from a scenario, ``env``'s robot and lidar, and time series.

        Args:
            scenario: Played scenario.
            outcome: Outcome of the episode.
            env: Environment of the episode.
            series: Arrays over time, by field name.
        """
        return cls(
            scenario=scenario.to_json(),
            outcome=outcome,
            time_step_s=float(env.simulator.time_step_s),
            robot_radius=float(env.simulator.robot.radius),
            goal_radius=float(env.goal_radius),
            max_range=float(env.simulator.lidar.max_range),
            lidar_mount=np.array(env.simulator.lidar.mount),
            lidar_angles=np.array([env.simulator.lidar.angle_min, env.simulator.lidar.increment]),
            walls=np.array(scenario.obstacles),
            path=np.array(scenario.path),
            goal=np.array(scenario.goal),
            **series,
        )

    @property
    def num_steps(self) -> int:
        """Number of steps T."""
        return len(self.action)

    def beam_ends(self) -> np.ndarray:
        """Return the end points of the raw scans' beams, ``[T + 1, beams, 2]`` m, robot frame."""
        x, y, yaw = (0.0, 0.0, 0.0) if self.lidar_mount is None else self.lidar_mount
        beams = np.arange(self.ranges.shape[1])
        if self.lidar_angles is None:
            angle = yaw + 2.0 * np.pi * beams / len(beams)
        else:
            angle = yaw + self.lidar_angles[0] + self.lidar_angles[1] * beams
        ends = self.ranges[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return ends + np.array([x, y])

    def scan_points(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of the pooled scans, or of the raw ones without pooling.

        Returns:
            Points ``[T + 1, N, 2]`` m in the robot frame, those without return at ``max_range``,
            and a mask of returns ``[T + 1, N]`` bool.
        """
        limit = self.max_range - 1e-3  # m; no return at the maximum range
        points = self.beam_ends() if self.points is None else self.points
        distance = np.linalg.norm(points, axis=-1)
        returned = distance < limit
        if self.points is None:
            returned &= self.ranges < limit
            far = points * (self.max_range / np.maximum(distance, 1e-9))[..., None]
            points = np.where(returned[..., None], points, far)
        return points, returned

    def save(self, file: str | Path, compact: bool = False) -> None:
        """Write one compressed ``.npz`` that numpy alone can read.

        Args:
            file: Destination.
            compact: Whether scans, points and attention are rounded, for half the size
                (:mod:`navrl.evaluation.rounding`); all other arrays are exact.

        Raises:
            ValueError: If the name does not end in ``.npz``.
        """
        if Path(file).suffix != ".npz":
            raise ValueError(f"file={file}: must end in .npz")
        values = {name: value for name, value in vars(self).items() if value is not None}
        terms = values.pop(keys.REWARD_TERMS)
        values |= {TERM + name: term for name, term in terms.items()}
        with replacing(file) as stream:
            np.savez_compressed(stream, format=_FORMAT, **(rounded(values) if compact else values))

    @classmethod
    def load(cls, file: str | Path) -> Recording:
        """Read a file written by :meth:`save`; the file cannot execute code.

        Raises:
            FileNotFoundError: If the file does not exist.
            DamagedFileError: If it is damaged, not a recording, or has values out of range.
        """
        arrays = read_arrays(file, _REMEDY)
        try:
            return cls._of_arrays(arrays)
        except (TypeError, ValueError) as error:
            raise DamagedFileError(file, f"not a recording of navrl ({error})", _REMEDY) from error

    @classmethod
    def _of_arrays(cls, arrays: dict[str, np.ndarray]) -> Recording:
        """Build from the arrays of a file.

        Raises:
            TypeError: If an array is not numeric.
            ValueError: If a field is missing, unknown or out of range.
        """
        stored = restored(arrays)
        if str(stored.pop("format", "")) != _FORMAT:
            raise ValueError(f"format must be {_FORMAT!r}")
        terms = {
            name.removeprefix(TERM): stored.pop(name)
            for name in list(stored)
            if name.startswith(TERM)
        }
        names = {f.name for f in fields(cls)} - {keys.REWARD_TERMS}
        missing = {f.name for f in fields(cls) if f.default is not None} & names - stored.keys()
        unknown = stored.keys() - names
        if missing or unknown:
            raise ValueError(f"missing {sorted(missing)}, unknown {sorted(unknown)}")
        plain: dict[str, Any] = {
            name: value.item() if value.ndim == 0 else value for name, value in stored.items()
        }
        check_plain(plain)
        check_finite({**plain, **{TERM + name: term for name, term in terms.items()}})
        return cls(**plain, reward_terms=terms)
