"""Errors of a reported pose: age, noise and drift."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from navrl.ops.noise import TABLE_SIZE, noise_table
from navrl.sim.draws import Uniform, Value, check_not_negative, draw, limits

_TWO_PI = 2.0 * math.pi


@dataclass(frozen=True)
class Localization:
    """Errors of the pose that a robot's localization reports; without arguments it is exact.

    Each value is fixed or drawn per episode. All draws depend on (seed, step) only.

    Args:
        age_s: Age of the reported pose, s. Between the poses of two steps x and y are interpolated
            linearly and the yaw along the shorter arc; the chord of a step of 0.2 s at 1 m/s and
            pi rad/s is within 1.6 cm of the arc. Before the start the robot was stationary there.
        noise_m: Standard deviation of x and y, each drawn at every step, m.
        noise_rad: The same for the yaw, rad.
        drift_m_per_s: Speed at which the reported position departs from the true one, in a
            direction that is drawn per episode, m/s.
        drift_rad_per_s: The same for the yaw, to a side that is drawn per episode, rad/s.

    Raises:
        ValueError: If a value is negative or not finite.

    Example:
        >>> late = Localization(age_s=0.1)
        >>> poses = torch.tensor([[[1.0, 0.0, 0.2], [0.8, 0.0, 0.0]]])  # now, and a step before
        >>> zero = torch.tensor([0])
        >>> late.report(poses, seed=zero, step=zero, time_step_s=0.2)
        tensor([[0.9000, 0.0000, 0.1000]])
    """

    age_s: Value = 0.0
    noise_m: Value = 0.0
    noise_rad: Value = 0.0
    drift_m_per_s: Value = 0.0
    drift_rad_per_s: Value = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        check_not_negative(**vars(self))

    @property
    def is_exact(self) -> bool:
        """Return whether the reported pose is the true one in all episodes."""
        return all(limits(getattr(self, field.name))[1] == 0.0 for field in fields(self))

    def num_poses(self, time_step_s: float) -> int:
        """Return the number of poses, of the last steps, that :meth:`report` needs; 0 if exact."""
        return 0 if self.is_exact else math.ceil(limits(self.age_s)[1] / time_step_s) + 1

    def report(self, poses: Tensor, seed: Tensor, step: Tensor, time_step_s: float) -> Tensor:
        """Return the reported pose.

        Args:
            poses: [N, R, 3] (x, y, yaw) m and rad, world: the true poses after the last R steps,
                latest first, with R from :meth:`num_poses`.
            seed: [N] int64, ``noise_seed`` of the scenarios.
            step: [N] int64, steps since the reset of each world.
            time_step_s: Duration of a step, s.

        Returns:
            [N, 3] (x, y, yaw), yaw in (-pi, pi], in the dtype of ``poses``.
        """
        pose = self._past(poses.double(), seed, time_step_s)
        error = self._noise(seed, step) + self._drift(seed, step * time_step_s)
        x, y, yaw = (pose + error).unbind(-1)
        yaw = yaw - _TWO_PI * ((yaw - math.pi) / _TWO_PI).ceil()
        return torch.stack((x, y, yaw), dim=-1).to(poses.dtype)

    def _past(self, poses: Tensor, seed: Tensor, time_step_s: float) -> Tensor:
        """Return [N, 3] float64, the interpolated pose of ``age_s`` ago."""
        last = poses.shape[1] - 1
        steps = draw("localization.age_s", self.age_s, seed) / time_step_s
        newer = steps.long().clamp_max(last)
        older = (newer + 1).clamp_max(last)
        world = torch.arange(len(poses), device=poses.device)
        change = poses[world, older] - poses[world, newer]
        turn = torch.remainder(change[:, 2] + math.pi, _TWO_PI) - math.pi
        change = torch.cat((change[:, :2], turn.unsqueeze(-1)), dim=-1)
        return poses[world, newer] + (steps - newer).unsqueeze(-1) * change

    def _noise(self, seed: Tensor, step: Tensor) -> Tensor:
        """Return [N, 3] float64, normal noise by the quantiles of the lidar's noise."""
        quantiles = noise_table("gaussian", 1.0).double().to(seed.device)
        errors = []
        for name, value in (("x", self.noise_m), ("y", self.noise_m), ("yaw", self.noise_rad)):
            row = draw(f"localization.noise.{name}", Uniform(0.0, TABLE_SIZE), seed, step).long()
            size = draw("localization.noise_" + ("rad" if name == "yaw" else "m"), value, seed)
            errors.append(size * quantiles[row])
        return torch.stack(errors, dim=-1)

    def _drift(self, seed: Tensor, time_s: Tensor) -> Tensor:
        """Return [N, 3] float64, the drift after ``time_s`` [N]."""
        distance = draw("localization.drift_m_per_s", self.drift_m_per_s, seed) * time_s
        direction = draw("localization.drift_direction", Uniform(0.0, _TWO_PI), seed)
        side = torch.where(draw("localization.drift_side", Uniform(-1.0, 1.0), seed) < 0.0, -1, 1)
        turn = side * draw("localization.drift_rad_per_s", self.drift_rad_per_s, seed) * time_s
        return torch.stack((distance * direction.cos(), distance * direction.sin(), turn), dim=-1)


class PoseMemory:
    """Poses of the last steps of N worlds, of which the localization reports one.

    Args:
        localization: Errors of the reported pose.
        num_worlds: Number of worlds N.
        time_step_s: Duration of a step, s.
        device: Device of the poses.
    """

    def __init__(
        self, localization: Localization, num_worlds: int, time_step_s: float, device: torch.device
    ) -> None:
        """Allocate the poses."""
        self._localization, self._time_step_s = localization, time_step_s
        count = localization.num_poses(time_step_s)
        self.poses = torch.zeros(num_worlds, count, 3, device=device)
        """[N, R, 3] (x, y, yaw), latest first; R is 0 if the localization is exact."""

    def reset(self, worlds: Tensor, pose: Tensor) -> None:
        """Fill the past of the worlds [M] with their rows of ``pose`` [N, 3]: stationary."""
        past = pose[worlds, None].expand(-1, self.poses.shape[1], -1)
        self.poses = self.poses.index_put((worlds,), past)

    def push(self, pose: Tensor) -> None:
        """Add the poses [N, 3] after a step."""
        if self.poses.shape[1] > 0:
            self.poses = torch.cat((pose[:, None], self.poses[:, :-1]), dim=1)

    def report(self, pose: Tensor, seed: Tensor, step: Tensor) -> Tensor:
        """Return the reported pose [N, 3]: ``pose`` itself if the localization is exact."""
        if self.poses.shape[1] == 0:
            return pose
        return self._localization.report(self.poses, seed, step, self._time_step_s)

    def load(self, poses: Tensor | None) -> None:
        """Restore :attr:`poses`; ``None`` (older states) for an exact localization.

        Raises:
            ValueError: If the localization needs another number of them.
        """
        count = 0 if poses is None else poses.shape[1]
        if count != self.poses.shape[1]:
            raise ValueError(
                f"localization: must need {count} past poses as the loaded state, "
                f"got {self.poses.shape[1]}"
            )
        if poses is not None:
            self.poses = poses.to(self.poses.device, copy=True)
