"""Updates recorded once as CUDA graphs and replayed: one launch in place of some hundred."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

Gradients = Callable[[TensorDictBase], dict[str, Tensor]]


class Move(NamedTuple):
    """What an update moves once its gradients are there.

    Args:
        optimizers: Those that step; fused, capturable, with learning rates in tensors.
        moves_targets: Whether the targets follow.
    """

    optimizers: tuple[torch.optim.Adam, ...]
    moves_targets: bool


class CapturedUpdates:
    """Replay gradients, optimiser steps and target updates without asking the host.

    A small network's update on a GPU takes less time than launching its operations one by one. The
    first updates run as usual, so that libraries and optimisers make what they need; then one of
    each kind (:class:`Move`) is recorded. Batches are copied to where recordings read them many at
    a time, and a counter on the device tells a recording which one is its turn, so that an update
    costs the host a single launch.

    The host would have to wait to see whether an update is finite. Here the device sees for itself:
    from the first that is not, no weight changes and neither batch nor scalars are overwritten,
    until :meth:`failure` hands them over, some updates later.

    Args:
        gradients: From a batch to detached scalars; leaves clipped gradients in the weights.
        due: What the present update moves; asked before each.
        optimizers: All there are.
        weights: Online weights, and
        targets: those that follow them, in the same order.
        tau: Share of the online weights that enters the targets.
        num_eager: Updates before the recordings; all of them, if the device is the CPU.
        num_rows: Batches that are copied at a time.

    Raises:
        ValueError: Later, if a batch is not of the first one's shape.
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
            optimizer.found_inf = self._failed  # a fused step with this at 1 changes nothing
        self._row = torch.zeros(1, dtype=torch.int64, device=self.device)  # of the next batch
        self._seen = torch.zeros((), pin_memory=self._on_cuda)  # the flag as the host last saw it
        self._event: torch.cuda.Event | None = None  # of the flag's copy under way
        self._is_told = False
        self.reset()

    def reset(self) -> None:
        """Forget the recordings, since tensors that they read have been replaced."""
        self._graphs: dict[Move, torch.cuda.CUDAGraph] = {}
        self._batches: TensorDictBase | None = None
        self._names: list[str] = []
        self._scalars: Tensor | None = None  # of the last update
        self._sums: Tensor | None = None
        self._num_updates = 0

    @property
    def is_recorded(self) -> bool:
        """Whether updates are replayed by now."""
        return bool(self._graphs)

    def __call__(
        self, batches: TensorDictBase, after_each: Callable[[], None]
    ) -> dict[str, Tensor]:
        """Update from each of ``[K, B]`` transitions in turn.

        Args:
            batches: K batches.
            after_each: Called when an update is on its way, before the next is asked for.

        Returns:
            Detached sums of the updates' scalars, in memory of their own.
        """
        if self._sums is not None:
            self._sums.zero_()
        for rows in batches.split(self._num_rows):
            self._take(rows)
            for _ in range(len(rows)):
                self._launch(self._due())
                after_each()
        self._look()
        return dict(zip(self._names, self._sums.clone().unbind(), strict=True))

    def failure(self, wait: bool = False) -> tuple[dict[str, Tensor], TensorDictBase] | None:
        """Return scalars and batch of the first update that was not finite, once.

        Args:
            wait: Whether to wait for the device; if not, it may be told some updates later.
        """
        if wait:
            self._seen.copy_(self._failed)
        elif self._event is not None and not self._event.query():
            return None
        if self._is_told or not bool(self._seen):
            return None
        self._is_told = True
        return dict(zip(self._names, self._scalars.unbind(), strict=True)), self._batch()

    def _launch(self, move: Move) -> None:
        if not self._on_cuda:
            self._update(move)
        elif self._num_updates < self._num_eager:
            self._update_aside(move)
        else:
            if move not in self._graphs:
                graph = torch.cuda.CUDAGraph()
                with torch.cuda.graph(graph):  # which computes nothing
                    self._update(move)
                self._graphs[move] = graph
            self._graphs[move].replay()
        self._num_updates += 1

    # --- what is recorded ------------------------------------------------------------------------

    def _batch(self) -> TensorDictBase:
        """Return a copy of the batch whose turn it is."""

        def chosen(rows: Tensor) -> Tensor:
            return rows.index_select(0, self._row).squeeze(0)

        return self._batches.apply(chosen, batch_size=self._batches.shape[1:])

    def _update(self, move: Move) -> None:
        scalars = self._gradients(self._batch())
        values = torch.stack(list(scalars.values()))
        if self._scalars is None:
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

    # --- around it -------------------------------------------------------------------------------

    def _take(self, batches: TensorDictBase) -> None:
        """Copy batches to where recordings read them, unless a failed one is kept there."""
        if self._batches is None:
            rows = torch.arange(self._num_rows) % len(batches)
            self._batches = batches.to(self.device)[rows.to(self.device)].clone()
        for key, kept in self._batches.items(True, True):
            fresh = batches.get(key)
            if fresh.shape[1:] != kept.shape[1:] or fresh.dtype != kept.dtype:
                raise ValueError(
                    f"cuda_graph=True: batches must be alike; {key!r} was {list(kept.shape[1:])} "
                    f"{kept.dtype}, got {list(fresh.shape[1:])} {fresh.dtype}"
                )
            kept = kept[: len(fresh)]
            torch.where(self._failed > 0, kept, fresh, out=kept)
        self._row.mul_((self._failed > 0).long())

    def _update_aside(self, move: Move) -> None:
        """Update on a stream of its own, as torch wants it before a recording."""
        stream, current = torch.cuda.Stream(self.device), torch.cuda.current_stream(self.device)
        stream.wait_stream(current)
        with torch.cuda.stream(stream):
            self._update(move)
        current.wait_stream(stream)

    def _look(self) -> None:
        """Fetch the flag in the background, if the last copy of it has arrived."""
        if self._event is None or self._event.query():
            self._seen.copy_(self._failed, non_blocking=True)
            if self._on_cuda:
                self._event = torch.cuda.Event()
                self._event.record()
