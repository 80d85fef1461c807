"""From a scan, a pose and a path to a command, one robot at a time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import ActionScaling, EnvBase, Transform, TransformedEnv

from navrl import keys
from navrl.policies import load_bundle
from navrl.sim import DifferentialDrive, Lidar
from navrl.worlds.scenario import MAX_PATH_POINTS


class PolicyRunner:
    """Run a policy on a robot: one call for each scan, the past is carried along.

    The numbers are those of the same policy in the same place of a simulation. Nothing but torch
    and the transforms runs: no simulator, no environment.

    Args:
        transforms: From raw observations to network inputs, as in training.
        actor: Writes an action in [-1, 1].
        lidar: What the policy was trained with: number of beams and largest range.
        robot: Limits of the command.

    Raises:
        ValueError: If the transforms do not fit the lidar, naming the step.

    Example:
        >>> from navrl.policies import ZOO
        >>> runner = PolicyRunner.from_bundle(ZOO / "paper")
        >>> command = runner.act(np.full(1440, 3.5), pose=(0.0, 0.0, 0.0), path=[(0, 0), (4, 0)])
        >>> 0.0 <= command[0] <= 1.0
        True
    """

    def __init__(
        self, transforms: Transform, actor: TensorDictModule, lidar: Lidar, robot: DifferentialDrive
    ) -> None:
        self.num_beams, self.max_range = lidar.num_beams, lidar.max_range
        senses = TransformedEnv(_Senses(lidar, robot), transforms)
        senses.append_transform(ActionScaling())
        senses.action_spec  # noqa: B018, built now: a misfit is told here and not at the first scan
        self._env, self._transform = senses, senses.transform
        self._actor = actor
        self._past: TensorDictBase | None = None

    @classmethod
    def from_bundle(cls, folder: str | Path, allow: Sequence[str] = ()) -> PolicyRunner:
        """Load a policy's folder: one of the zoo, or ``policy`` of a training run.

        Args:
            folder: The bundle.
            allow: See :func:`navrl.policies.load_bundle`.

        Raises:
            BundleError: If the bundle is damaged or not allowed.
        """
        bundle = load_bundle(folder, allow)
        parts = (bundle.build(part) for part in ("lidar", "robot"))
        return cls(bundle.build("transforms"), bundle.actor, *parts)

    def reset(self) -> None:
        """Forget the past: the next scan is the first of a new drive."""
        self._past = None

    @torch.no_grad()
    def act(self, ranges: ArrayLike, pose: ArrayLike, path: ArrayLike) -> np.ndarray:
        """Return the command for one scan.

        Args:
            ranges: ``[num_beams]`` m, beam j at bearing ``2 pi j / num_beams``, counted
                counter-clockwise from straight ahead. A beam without return reads at least
                ``max_range``, or NaN, infinity or zero, as drivers have it.
            pose: ``[3]`` (x, y, yaw) m and rad, in the frame of ``path``.
            path: ``[P, 2]`` m, from about the robot to the goal, at most 200 points. It may change
                between calls only together with :meth:`reset`: progress along it is remembered.

        Returns:
            ``[2]`` float32 (v, w), m/s and rad/s, within the robot's limits; to be driven until the
            next scan, 0.2 s later in training.

        Raises:
            ValueError: If a shape does not fit, if pose or path is not finite, or if every beam is
                NaN: a blind robot must not take the world for empty. Nothing is remembered then.
        """
        sensed = self._checked(ranges, pose, path)
        if self._past is None:
            now = self._transform._reset(sensed, sensed)
        else:
            now = self._transform._step(self._past, sensed)
            now.set(keys.ACTION, self._past.get(keys.ACTION))  # controllers read their last action
        action = self._decide(now)
        self._past = now.set(keys.ACTION, action)
        command = self._transform.inv(now.copy())[keys.ACTION]
        return command[0].numpy()

    def _decide(self, now: TensorDictBase) -> Tensor:
        actor = self._actor
        if type(actor) is TensorDictModule and actor.out_keys == [keys.ACTION]:
            # The network itself: around it a TensorDictModule looks for packages at every call.
            return actor.module(*(now.get(key) for key in actor.in_keys))
        return actor(now.copy())[keys.ACTION]

    def _checked(self, ranges: ArrayLike, pose: ArrayLike, path: ArrayLike) -> TensorDictBase:
        ranges, pose, path = (np.asarray(value, dtype=np.float32) for value in (ranges, pose, path))
        if ranges.shape != (self.num_beams,):
            raise ValueError(f"ranges: need shape [{self.num_beams}], got {list(ranges.shape)}")
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise ValueError(f"pose: need 3 finite numbers (x, y, yaw), got {pose.tolist()}")
        if path.ndim != 2 or path.shape[1] != 2 or not 1 <= len(path) <= MAX_PATH_POINTS:
            raise ValueError(
                f"path: need shape [P, 2] with P from 1 to {MAX_PATH_POINTS}, "
                f"got {list(path.shape)}"
            )
        if not np.isfinite(path).all():
            raise ValueError("path: a point is not finite")
        if np.isnan(ranges).all():
            raise ValueError("ranges: every beam is NaN")
        whole = np.concatenate([path, np.repeat(path[-1:], MAX_PATH_POINTS - len(path), axis=0)])
        ranges = np.where(ranges <= self.max_range, ranges, np.float32(self.max_range))
        values = {keys.RANGES: ranges, keys.POSE: pose, keys.PATH: whole}
        return TensorDict({k: torch.from_numpy(v).unsqueeze(0) for k, v in values.items()}, [1])


class _Senses(EnvBase):
    """What a robot observes and can do, as specs for the transforms; it is never stepped."""

    def __init__(self, lidar: Lidar, robot: DifferentialDrive) -> None:
        super().__init__(batch_size=[1])
        observation = {
            keys.RANGES: Bounded(0.0, lidar.max_range, shape=(1, lidar.num_beams)),
            keys.POSE: Unbounded((1, 3)),
            keys.PATH: Unbounded((1, MAX_PATH_POINTS, 2)),
        }
        self.observation_spec = Composite(observation, shape=(1,))
        low = torch.tensor([[robot.min_speed, -robot.max_turn_rate]])
        high = torch.tensor([[robot.max_speed, robot.max_turn_rate]])
        self.action_spec = Bounded(low, high)
        self.reward_spec = Unbounded((1, 1))

    def _reset(self, tensordict: TensorDictBase | None, **_: object) -> TensorDictBase:
        raise NotImplementedError("a robot is not reset")

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise NotImplementedError("a robot is not stepped")

    def _set_seed(self, seed: int | None) -> None:
        pass
