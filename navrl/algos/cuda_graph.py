"""Updates recorded as CUDA graphs and replayed with one launch instead of some hundred."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

Gradients = Callable[[TensorDictBase], dict[str, Tensor]]


class Move(NamedTuple):
    """Optimizers and targets that an update changes after its gradients are computed.

    Args:
        optimizers: Optimizers that step; fused, capturable, with learning rates in tensors.
        moves_targets: Whether the target weights are updated.
    """

    optimizers: tuple[torch.optim.Adam, ...]
    moves_targets: bool


class CapturedUpdates:
    """Replay gradients, optimizer steps and target updates without host synchronization.

    The update of a small network on a GPU takes less time than the launch of its operations. The
    first updates run eagerly, so that libraries and optimizers allocate their state; then one
    update of each kind (:class:`Move`) is recorded. Many batches at a time are copied to the input
    memory of the recordings, and a counter on the device selects the current one, so that an update
    costs the host a single launch.

    Whether an update is finite is tested on the device, because a test on the host would
    synchronize. From the first non-finite update on, no weight changes and neither batch nor
    scalars are overwritten, until :meth:`failure` returns them some updates later.

    Args:
        gradients: Maps a batch to detached scalars; leaves clipped gradients in the weights.
        due: Returns the :class:`Move` of the current update; called before each update.
        optimizers: All optimizers.
        weights: Online weights.
        targets: Target weights in the same order.
        tau: Share of the online weights in the soft update of the targets.
        num_eager: Number of updates before the recordings; on the CPU all updates are eager.
        num_rows: Number of batches copied at a time.

    Raises:
        ValueError: If a later batch differs in shape or dtype from the first one.
    """

    def __init__(
        self,
        gradients: Gradients,
        due: Callable[[], Move],
        optimizers: Sequence[torch.optim.Adam],
        weights: Sequence[Tensor],
        targets: Sequence[Tensor],
        tau: float,
        num_eager: int = 4,
        num_rows: int = 64,
    ) -> None:
        self._gradients, self._due = gradients, due
        self._weights, self._targets = list(weights), list(targets)
        self._tau, self._num_eager, self._num_rows = tau, num_eager, num_rows
        self.device = self._weights[0].device
        self._on_cuda = self.device.type == "cuda"
        self._failed = torch.zeros((), device=self.device)  # 1 from the first failure on
        for optimizer in optimizers:
            optimizer.found_inf = self._failed  # at 1, a fused step does not change weights
        self._row = torch.zeros(1, dtype=torch.int64, device=self.device)  # of the next batch
        self._seen = torch.zeros((), pin_memory=self._on_cuda)  # host copy of the flag
        self._event: torch.cuda.Event | None = None  # end of the current copy of the flag
        self._is_reported = False
        self.reset()

    def reset(self) -> None:
        """Discard the recordings, because tensors that they read have been replaced."""
        self._graphs: dict[Move, torch.cuda.CUDAGraph] = {}
        self._batches: TensorDictBase | None = None
        self._names: list[str] = []
        self._scalars: Tensor | None = None  # of the last update
        self._sums: Tensor | None = None
        self._num_updates = 0

    @property
    def is_recorded(self) -> bool:
        """Return whether updates are replayed from a recording."""
        return bool(self._graphs)

    def __call__(
        self, batches: TensorDictBase, after_each: Callable[[], None]
    ) -> dict[str, Tensor]:
        """Update from each of K batches ``[K, B]`` in order.

        Args:
            batches: K batches.
            after_each: Called after the launch of each update.

        Returns:
            Detached sums of the scalars of the updates, copied.

        Raises:
            ValueError: If the batches differ in shape or dtype from the first ones.
        """
        if self._sums is not None:
            self._sums.zero_()
        for rows in batches.split(self._num_rows):
            self._take(rows)
            for _ in range(len(rows)):
                self._launch(self._due())
                after_each()
        self._look()
        assert self._sums is not None  # there is at least one batch
        return dict(zip(self._names, self._sums.clone().unbind(), strict=True))

    def failure(self, wait: bool = False) -> tuple[dict[str, Tensor], TensorDictBase] | None:
        """Return scalars and batch of the first non-finite update; None afterwards.

        Args:
            wait: Whether to wait for the device; otherwise the failure may be reported some updates
                later.
        """
        if wait:
            self._seen.copy_(self._failed)
        elif self._event is not None and not self._event.query():
            return None
        if self._is_reported or not bool(self._seen):
            return None
        self._is_reported = True
        assert self._scalars is not None
        return dict(zip(self._names, self._scalars.unbind(), strict=True)), self._batch()

    def _launch(self, move: Move) -> None:
        if not self._on_cuda:
            self._update(move)
        elif self._num_updates < self._num_eager:
            self._update_aside(move)
        else:
            if move not in self._graphs:
                graph = torch.cuda.CUDAGraph()
                with torch.cuda.graph(graph):  # records without computing
                    self._update(move)
                self._graphs[move] = graph
            self._graphs[move].replay()
        self._num_updates += 1

    # --- recorded operations ---------------------------------------------------------------------

    def _batch(self) -> TensorDictBase:
        """Return a copy of the current batch."""

        def chosen(rows: Tensor) -> Tensor:
            return rows.index_select(0, self._row).squeeze(0)

        assert self._batches is not None  # see _take
        return self._batches.apply(chosen, batch_size=self._batches.shape[1:])

    def _update(self, move: Move) -> None:
        scalars = self._gradients(self._batch())
        values = torch.stack(list(scalars.values()))
        if self._scalars is None or self._sums is None:
            self._names, self._scalars = list(scalars), values.clone()
            self._sums = torch.zeros_like(values)
        torch.where(self._failed > 0, self._scalars, values, out=self._scalars)
        self._sums.add_(self._scalars)
        self._failed.copy_(torch.maximum(self._failed, (~values.isfinite().all()).float()))
        for optimizer in move.optimizers:
            optimizer.step()
        if move.moves_targets:
            way = torch._foreach_sub(self._weights, self._targets)
            torch._foreach_mul_(way, self._tau * (1.0 - self._failed))
            torch._foreach_add_(self._targets, way)
        self._row.add_((self._failed == 0).long())

    # --- eager operations ------------------------------------------------------------------------

    def _take(self, batches: TensorDictBase) -> None:
        """Copy batches to the input memory of the recordings, unless it holds a failed batch."""
        if self._batches is None:
            rows = torch.arange(self._num_rows) % len(batches)
            self._batches = batches.to(self.device)[rows.to(self.device)].clone()
        for key, kept in self._batches.items(True, True):
            fresh = batches.get(key)
            if fresh.shape[1:] != kept.shape[1:] or fresh.dtype != kept.dtype:
                raise ValueError(
                    f"cuda_graph=True: batches must be alike, {key!r} was {list(kept.shape[1:])} "
                    f"{kept.dtype}, got {list(fresh.shape[1:])} {fresh.dtype}"
                )
            kept = kept[: len(fresh)]
            torch.where(self._failed > 0, kept, fresh, out=kept)
        self._row.mul_((self._failed > 0).long())

    def _update_aside(self, move: Move) -> None:
        """Update on a side stream, which torch requires before a recording."""
        stream, current = torch.cuda.Stream(self.device), torch.cuda.current_stream(self.device)
        stream.wait_stream(current)
        with torch.cuda.stream(stream):
            self._update(move)
        current.wait_stream(stream)

    def _look(self) -> None:
        """Start an asynchronous copy of the failure flag, if the last one has completed."""
        if self._event is None or self._event.query():
            self._seen.copy_(self._failed, non_blocking=True)
            if self._on_cuda:
                self._event = torch.cuda.Event()
                self._event.record()
