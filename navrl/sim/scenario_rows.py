"""Scenarios of all worlds, stored as one batch of N rows."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.ops.bodies import STATE_SIZE
from navrl.worlds import ScenarioBatch, pedestrian_states
from navrl.worlds.batch import tensor_names

_PREFIX = "scenario."


class ScenarioRows:
    """Batch of N scenarios, one per world, with replacement of single rows.

    Every row has space for ``max_pedestrians`` pedestrians, present ones first, and for the largest
    number of walls so far.

    Args:
        num_worlds: Number of worlds N.
        max_pedestrians: Number of pedestrian rows K.
    """

    def __init__(self, num_worlds: int, max_pedestrians: int) -> None:
        self._num_worlds, self._max_pedestrians = num_worlds, max_pedestrians
        self._batch: ScenarioBatch | None = None  # rows of worlds without a reset are undefined

    def put(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        """Write scenario ``i`` into row ``worlds[i]``."""
        scenarios = compact_pedestrians(scenarios, self._max_pedestrians)
        if self._batch is None:
            self._batch = scenarios[torch.zeros(self._num_worlds, dtype=torch.int64)]
        both = (self._batch, scenarios)
        width = max(batch.boxes.shape[1] for batch in both)
        points = max(batch.route.shape[2] for batch in both)
        kept, new = (_widened(batch, width, points) for batch in both)
        for name, rows in kept.items():
            rows[worlds] = new[name]
        self._batch = ScenarioBatch.from_tensors(kept)

    def row(self, world: int) -> dict[str, Tensor]:
        """Return the tensors of one scenario by name."""
        assert self._batch is not None
        return {name: rows[world] for name, rows in self._batch.tensors().items()}

    def pedestrians(self, times_s: Tensor) -> Tensor:
        """Return the states of all pedestrians on their routes and tracks.

        Args:
            times_s: [N, T] float64 s since the reset of each world.

        Returns:
            [N, T, K, 7] float64, see :func:`navrl.worlds.pedestrian_states`; NaN rows are absent.
        """
        shape = (*times_s.shape, self._max_pedestrians, STATE_SIZE)
        if self._batch is None:
            return torch.full(shape, torch.nan, dtype=torch.float64)
        worlds = torch.arange(self._num_worlds).repeat_interleave(times_s.shape[1])
        return pedestrian_states(self._batch[worlds], times_s.flatten()).reshape(shape)

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all rows; empty before the first :meth:`put`."""
        tensors = {} if self._batch is None else self._batch.tensors()
        return {_PREFIX + name: rows.clone() for name, rows in tensors.items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the rows of :meth:`state_dict`; other keys are ignored.

        Raises:
            ValueError: If a key is missing, or the rows have another N or K.
        """
        tensors = {
            name.removeprefix(_PREFIX): rows.clone()
            for name, rows in state.items()
            if name.startswith(_PREFIX)
        }
        if not tensors:
            self._batch = None
            return
        missing = set(tensor_names()) - tensors.keys()
        if missing:
            raise ValueError(f"state: lacks {sorted(_PREFIX + name for name in missing)}")
        wanted, got = (self._num_worlds, self._max_pedestrians), tensors["ped_present"].shape
        if wanted != tuple(got):
            raise ValueError(
                f"state['{_PREFIX}ped_present']: must have shape {list(wanted)}, got {[*got]}"
            )
        self._batch = ScenarioBatch.from_tensors(tensors)


def compact_pedestrians(scenarios: ScenarioBatch, max_pedestrians: int) -> ScenarioBatch:
    """Move present pedestrians to the first of K rows, in order."""
    order = torch.argsort(~scenarios.ped_present, dim=1, stable=True)[:, :max_pedestrians]
    row, count = torch.arange(len(scenarios), device=order.device)[:, None], order.shape[1]
    tensors = scenarios.tensors()
    for name, value in tensors.items():
        if name.startswith(("ped_", "route")):
            rows = value.new_zeros(len(scenarios), max_pedestrians, *value.shape[2:])
            rows[:, :count] = value[row, order]
            tensors[name] = rows
    return ScenarioBatch.from_tensors(tensors)


def _widened(scenarios: ScenarioBatch, num_walls: int, num_points: int) -> dict[str, Tensor]:
    """Return the tensors padded to ``num_walls`` walls and ``num_points`` points of a route."""
    tensors = scenarios.tensors()
    missing = num_walls - scenarios.boxes.shape[1]
    for name in ("boxes", "box_heights"):
        tensors[name] = torch.nn.functional.pad(tensors[name], (0, 0, 0, missing))
    tensors["box_is_disc"] = torch.nn.functional.pad(tensors["box_is_disc"], (0, missing))
    count = num_points - scenarios.route.shape[2]
    for name in ("route", "route_arc"):
        tensors[name] = extended(tensors[name], count)
    return tensors


def extended(points: Tensor, count: int) -> Tensor:
    """Return points ``[N, K, R, ...]`` with ``count`` more: the last one, zeros if R = 0."""
    if points.shape[2] == 0:
        return points.new_zeros(*points.shape[:2], count, *points.shape[3:])
    last = points[:, :, -1:].expand(-1, -1, count, *points.shape[3:])
    return torch.cat((points, last), dim=2)
