"""Waypoints of the global path in the robot frame."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from navrl import keys
from navrl.checks import check_counts, check_positive
from navrl.ops import se2
from navrl.ops.path import point_at, project_onto_path
from navrl.ops.path_search import check_window
from navrl.transforms.observation_map import (
    Keys,
    cloned,
    nested_keys,
    observed_specs,
    read,
    read_spec,
    real_spec,
    require_history,
    world_values,
)
from navrl.transforms.stateful import StatefulTransform


class Waypoints(StatefulTransform):
    """Compute the next points of the global path in the robot frame.

    The projection of the robot on the path is passed from step to step in the TensorDict and
    searched only around its last value, so where the path crosses itself the waypoints stay on the
    robot's branch. After a reset the whole path is searched. Beyond the end of the path the goal is
    repeated.

    Args:
        num_waypoints: Number of points N_f.
        spacing: Arc length between waypoints, m.
        include_closest: Whether the first point is the projection itself, as in the paper's
            formula, instead of one spacing ahead of it.
        ahead: Length of the search window after the last projection, m.
        behind: Length of the search window before the last projection, m; with 0 progress never
            decreases.
        in_keys: Pose ``[*B, 3]`` and path ``[*B, P, 2]`` in the same world frame; float64 for
            coordinates far from the origin (UTM), which is preserved until they are subtracted.
        out_keys: Waypoints ``[*B, N_f, 2]`` m in the robot frame, and the arc length of the
            projection ``[*B, 1]`` m, which the next step reads.

    Raises:
        ValueError: If an argument is invalid, or later if the environment lacks a key.

    Example:
        >>> path = torch.tensor([[[0.0, 0.0], [4.0, 0.0]]])
        >>> waypoints, progress = Waypoints(num_waypoints=2, spacing=0.5)(
        ...     pose=torch.tensor([[1.0, 0.0, 0.0]]), path=path
        ... )
        >>> waypoints.tolist(), progress.tolist()
        ([[[0.5, 0.0], [1.0, 0.0]]], [[1.0]])

    Reference:
        Paper Sec. IV-C, P_t^f. Its formula includes the closest point p^c, while its text refers to
        upcoming points; the authors' precursor starts one spacing ahead, which is the default.
    """

    INPUTS: tuple[str, ...] = ("pose", "path")
    OUTPUTS: tuple[str, ...] = ("waypoints", "progress")

    def __init__(
        self,
        num_waypoints: int = 5,
        spacing: float = 0.3,
        include_closest: bool = False,
        ahead: float = 1.0,
        behind: float = 0.0,
        in_keys: Keys = (keys.POSE, keys.PATH),
        out_keys: Keys = (keys.WAYPOINTS, keys.PATH_PROGRESS),
    ) -> None:
        super().__init__(in_keys=nested_keys(in_keys), out_keys=nested_keys(out_keys))
        for argument, names in (("in_keys", self.INPUTS), ("out_keys", self.OUTPUTS)):
            if len(getattr(self, argument)) != len(names):
                raise ValueError(
                    f"{type(self).__name__}: {argument}={getattr(self, argument)}: must be "
                    f"{len(names)} keys ({', '.join(names)}); write a nested key as a list within "
                    "the list"
                )
        check_counts(num_waypoints=num_waypoints)
        check_positive(spacing=spacing)
        check_window(ahead, behind)
        self.num_waypoints = num_waypoints
        self.spacing = spacing
        self.include_closest = include_closest
        self.ahead = ahead
        self.behind = behind

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        previous = read(self, tensordict, self.out_keys[1]).squeeze(-1)
        return self._write(next_tensordict, previous)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Search the whole path, as after a reset."""
        return self._write(next_tensordict, None)

    @dispatch(source="in_keys", dest="out_keys", auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Map data outside an environment; stored progress is used instead of a new search.

        Data without stored progress and without ``"next"`` is treated as starts of episodes.

        Raises:
            ValueError: If the root of a transition lacks its progress.
        """
        progress_key = self.out_keys[1]
        if progress_key in tensordict.keys(True, True):
            self._write_points(tensordict, tensordict.get(progress_key))
        else:
            require_history(self, tensordict, [progress_key])
            self._call(tensordict)
        if "next" in tensordict:
            following = tensordict.get("next")
            if progress_key in following.keys(True, True):
                self._write_points(following, following.get(progress_key))
            else:
                self._step(tensordict, following)
        return tensordict

    def restart(self, tensordict: TensorDictBase, progress: Tensor) -> None:
        """Overwrite what is passed to the next step, as for another path.

        Args:
            tensordict: ``[*B]``, root of the next step.
            progress: ``[*B, 1]`` m, arc length on the path at which the search starts.
        """
        tensordict.set(self.out_keys[1], progress)

    def _write(self, tensordict: TensorDictBase, previous: Tensor | None) -> TensorDictBase:
        """Project the pose of ``tensordict`` onto its path and write both outputs."""
        return self._write_points(tensordict, self._project(tensordict, previous))

    def _project(self, tensordict: TensorDictBase, previous: Tensor | None) -> Tensor:
        """Write the progress of ``tensordict`` and return it, ``[*B, 1]``."""
        pose, path = self._world(tensordict)
        projection = project_onto_path(path, pose[..., :2], previous, self.ahead, self.behind)
        progress = projection.progress.unsqueeze(-1).float()
        tensordict.set(self.out_keys[1], progress)
        return progress

    def _write_points(self, tensordict: TensorDictBase, progress: Tensor) -> TensorDictBase:
        """Write the waypoints ahead of ``progress [*B, 1]``."""
        return tensordict.set(self.out_keys[0], self._ahead(tensordict, progress))

    def _ahead(self, tensordict: TensorDictBase, progress: Tensor) -> Tensor:
        """Return the next points of the path in the robot frame, ``[*B, N_f, 2]`` m."""
        pose, path = self._world(tensordict)
        points_world = point_at(path, progress + self._offsets(progress))
        return se2.transform_points(se2.inverse(pose), points_world).float()

    def _offsets(self, progress: Tensor) -> Tensor:
        """Return the arc lengths from the projection to the waypoints, ``[N_f]`` m."""
        index = torch.arange(self.num_waypoints, device=progress.device, dtype=progress.dtype)
        return (index + (0 if self.include_closest else 1)) * self.spacing

    def _world(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return pose and path."""
        pose, path = world_values(*(read(self, tensordict, key) for key in self.in_keys[:2]))
        return pose, path

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the specs of waypoints and progress to those of the environment.

        Raises:
            ValueError: If the environment lacks a key or its shape is wrong.
        """
        observation_spec = cloned(observation_spec)
        pose, path = (read_spec(self, observation_spec, key) for key in self.in_keys[:2])
        if pose.shape[-1:] != (3,) or path.shape[-1:] != (2,):
            raise ValueError(
                f"{type(self).__name__} needs {self.in_keys[0]!r} [*B, 3] and "
                f"{self.in_keys[1]!r} [*B, P, 2], got {tuple(pose.shape)} and {tuple(path.shape)}"
            )
        batch = pose.shape[:-1]
        observation_spec[self.out_keys[0]] = real_spec(pose, *batch, self.num_waypoints, 2)
        observation_spec[self.out_keys[1]] = real_spec(pose, *batch, 1)
        return observation_spec

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Add the progress to the state spec, because a step reads it."""
        input_spec = cloned(input_spec)
        pose = read_spec(self, observed_specs(self), self.in_keys[0])
        input_spec["full_state_spec"][self.out_keys[1]] = real_spec(pose, *pose.shape[:-1], 1)
        return input_spec
