"""An update recorded once as a CUDA graph and replayed: one launch in place of some hundred."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

Gradients = Callable[[TensorDictBase], dict[str, Tensor]]


class CapturedUpdate:
    """Replay gradients, optimiser steps and target update without asking the host.

    A small network's update on a GPU takes less time than launching its operations one by one. The
    first updates run as usual, so that libraries and optimisers make what they need; then one is
    recorded, in the memory of the batch that it saw, and from there on batches are copied into that
    memory.

    The host would have to wait to see whether an update is finite. Here the device sees for itself:
    from the first that is not, no weight changes and neither batch nor scalars are overwritten,
    until :meth:`failure` hands them over, some updates later.

    Args:
        gradients: From a batch to detached scalars; leaves clipped gradients in the weights.
        optimizers: That take them; fused, capturable, with learning rates in tensors.
        weights: Online weights, and
        targets: those that follow them, in the same order.
        tau: Share of the online weights that enters the targets.
        num_eager: Updates before the recording; all of them, if the device is the CPU.

    Raises:
        ValueError: Later, if a batch is not of the first one's shape.
    """

    def __init__(
        self,
        gradients: Gradients,
        optimizers: Sequence[torch.optim.Adam],
        weights: Sequence[Tensor],
        targets: Sequence[Tensor],
        tau: float,
        num_eager: int = 3,
    ) -> None:
        self._gradients, self._optimizers = gradients, list(optimizers)
        self._weights, self._targets = list(weights), list(targets)
        self._tau, self._num_eager = tau, num_eager
        self.device = self._weights[0].device
        self._on_cuda = self.device.type == "cuda"
        self._failed = torch.zeros((), device=self.device)  # 1 from the first failure on
        for optimizer in self._optimizers:
            optimizer.found_inf = self._failed  # a fused step with this at 1 changes nothing
        self._seen = torch.zeros((), pin_memory=self._on_cuda)  # the flag as the host last saw it
        self._event: torch.cuda.Event | None = None  # of the flag's copy under way
        self._is_told = False
        self.reset()

    def reset(self) -> None:
        """Forget the recording, since tensors that it reads have been replaced."""
        self._graph: torch.cuda.CUDAGraph | None = None
        self._batch: TensorDictBase | None = None
        self._names: list[str] = []
        self._scalars: Tensor | None = None
        self._num_updates = 0

    @property
    def is_recorded(self) -> bool:
        """Whether updates are replayed by now."""
        return self._graph is not None

    def __call__(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Update; ``td_error`` is written into the batch.

        Returns:
            Detached scalars of this update, in memory of their own.
        """
        self._take(batch)
        if self._graph is not None:
            self._graph.replay()
        elif not self._on_cuda:
            self._update()
        elif self._num_updates < self._num_eager:
            self._update_aside()
        else:
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph):
                self._update()
            self._graph = graph
            self._graph.replay()  # recording computes nothing
        self._num_updates += 1
        self._look()
        if "td_error" in self._batch:
            batch.set("td_error", self._batch.get("td_error").clone())
        return dict(zip(self._names, self._scalars.clone().unbind(), strict=True))

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
        return dict(zip(self._names, self._scalars.unbind(), strict=True)), self._batch

    # --- what is recorded ------------------------------------------------------------------------

    def _update(self) -> None:
        scalars = self._gradients(self._batch)
        values = torch.stack(list(scalars.values()))
        if self._scalars is None:
            self._names, self._scalars = list(scalars), values.clone()
        torch.where(self._failed > 0, self._scalars, values, out=self._scalars)
        self._failed.copy_(torch.maximum(self._failed, (~values.isfinite().all()).float()))
        for optimizer in self._optimizers:
            optimizer.step()
        way = torch._foreach_sub(self._weights, self._targets)
        torch._foreach_mul_(way, self._tau * (1.0 - self._failed))
        torch._foreach_add_(self._targets, way)

    # --- around it -------------------------------------------------------------------------------

    def _take(self, batch: TensorDictBase) -> None:
        """Copy a batch to where the recording reads it, unless a failed one is kept there."""
        if self._batch is None:
            self._batch = batch.to(self.device).clone()
            return
        for key, kept in self._batch.items(True, True):
            if key == "td_error":  # an output
                continue
            fresh = batch.get(key)
            if fresh.shape != kept.shape or fresh.dtype != kept.dtype:
                raise ValueError(
                    f"cuda_graph=True: batches must be alike; {key!r} was {list(kept.shape)} "
                    f"{kept.dtype}, got {list(fresh.shape)} {fresh.dtype}"
                )
            torch.where(self._failed > 0, kept, fresh, out=kept)

    def _update_aside(self) -> None:
        """Update on a stream of its own, as torch wants it before a recording."""
        stream, current = torch.cuda.Stream(self.device), torch.cuda.current_stream(self.device)
        stream.wait_stream(current)
        with torch.cuda.stream(stream):
            self._update()
        current.wait_stream(stream)

    def _look(self) -> None:
        """Fetch the flag in the background, if the last copy of it has arrived."""
        if self._event is None or self._event.query():
            self._seen.copy_(self._failed, non_blocking=True)
            if self._on_cuda:
                self._event = torch.cuda.Event()
                self._event.record()
