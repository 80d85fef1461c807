"""Supervised training of the scan flow."""

from __future__ import annotations

import math
import time
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

from navrl.checks import check_counts, check_positive
from navrl.networks import ScanFlow
from navrl.progress_bar import progress_bar as make_bar
from navrl.training.checkpoint import CheckpointStore
from navrl.training.flow_data import FlowSamples
from navrl.training.flow_loss import FlowLoss, flow_scores
from navrl.training.interruption import StopRequested, StopSignals, TrainingStoppedError
from navrl.training.metrics_log import LOG_FILE, MetricsLog

CHECKPOINT_EVERY_S = 60.0


class FlowTrainer:
    """Training of a scan flow that can be killed at any time and resumed, bit for bit.

    Each update draws a batch with replacement and augments it: half of the samples are mirrored,
    and all are rotated by a random number of bins. The optimizer is Adam, whose learning rate
    decreases linearly.

    Args:
        net: Network, on its device; trained in place.
        samples: Samples for the updates, on the CPU.
        held_out: Samples for the figures, of other episodes.
        folder: Run folder: ``metrics.csv`` and ``checkpoint/``.
        updates: Number of updates of the whole training.
        batch_size: Samples of an update.
        learning_rate: Of the first update.
        final_learning_rate_scale: Share of it at the end.
        loss: Loss; ``None`` for the default one.
        evaluate_every_updates: Updates from one row of ``metrics.csv`` to the next.
        seed: Seed of batches and augmentation.
        progress_bar: Whether to show a progress bar.

    Raises:
        ValueError: If a value is out of range, or there are no samples.
    """

    def __init__(
        self,
        net: ScanFlow,
        samples: FlowSamples,
        held_out: FlowSamples,
        folder: Path,
        updates: int,
        batch_size: int = 64,
        learning_rate: float = 2e-3,
        final_learning_rate_scale: float = 0.02,
        loss: FlowLoss | None = None,
        evaluate_every_updates: int = 1000,
        seed: int = 0,
        progress_bar: bool = True,
    ) -> None:
        """Check the values and prepare the optimizer."""
        check_counts(updates=updates, batch_size=batch_size)
        check_counts(evaluate_every_updates=evaluate_every_updates)
        check_positive(learning_rate=learning_rate)
        check_positive(final_learning_rate_scale=final_learning_rate_scale)
        for name, given in {"samples": samples, "held_out": held_out}.items():
            if not len(given):
                raise ValueError(f"{name}: must have at least one sample; record more rounds")
        self.net, self.samples, self.held_out, self.folder = net, samples, held_out, Path(folder)
        self.updates, self.batch_size = updates, batch_size
        self.learning_rate, self.final_scale = learning_rate, final_learning_rate_scale
        self.loss = FlowLoss() if loss is None else loss
        self.evaluate_every, self.progress_bar = evaluate_every_updates, progress_bar
        self.checkpoints = CheckpointStore(self.folder / "checkpoint")
        self.done = 0
        """Updates done."""
        self._device = next(net.parameters()).device
        self._optimizer = torch.optim.Adam(net.parameters(), learning_rate)
        self._generator = torch.Generator().manual_seed(seed)
        self._sum = torch.zeros((), dtype=torch.float64, device=self._device)
        self._log: MetricsLog  # made by run()

    def run(self) -> dict[str, float]:
        """Train, from the checkpoint of the folder if there is one.

        Returns:
            The figures of :func:`navrl.training.flow_loss.flow_scores` at the end.

        Raises:
            TrainingStoppedError: If SIGTERM, SIGINT or SIGHUP was received; the training is saved.
            ValueError: If the loss is not finite, or the checkpoint is damaged.
            OSError: If a file cannot be written.
        """
        resumed = self.checkpoints.exists
        rows = self._restore() if resumed else self.checkpoints.check_new(self.folder / LOG_FILE)
        self._log = MetricsLog(self.folder, self._frames if resumed else None, rows)
        bar = make_bar(self.updates, "update", initial=self.done, enabled=self.progress_bar)
        with StopSignals() as signals:
            try:
                self._loop(signals, bar)
                return flow_scores(self.net, self.held_out, self.loss)
            except StopRequested:
                self._save()
                assert signals.received is not None
                done = f"{self.done} of {self.updates} updates"
                command = "the same command"
                stopped = TrainingStoppedError(signals.received, done, self.folder, command)
                raise stopped from None
            finally:
                bar.close()
                self._log.close()

    @property
    def _frames(self) -> int:
        """Samples drawn."""
        return self.done * self.batch_size

    def _loop(self, signals: StopSignals, bar: tqdm) -> None:
        last_checkpoint = time.monotonic()
        if not self.checkpoints.exists:
            self._save()
        while self.done < self.updates:
            signals.check()
            self._sum += self._update()
            self.done += 1
            bar.update()
            if self.done % self.evaluate_every == 0 or self.done == self.updates:
                self._report(bar)
            if time.monotonic() - last_checkpoint > CHECKPOINT_EVERY_S:
                self._save()
                last_checkpoint = time.monotonic()
        self._save()

    def _update(self) -> Tensor:
        """Do one update; return its loss."""
        size, generator = (self.batch_size,), self._generator
        rows = torch.randint(len(self.samples), size, generator=generator)
        is_mirrored = torch.rand(size, generator=generator) < 0.5
        shift = torch.randint(self.samples.returns.shape[-1], size, generator=generator)
        batch = self.samples[rows].augmented(is_mirrored, shift).to(self._device)
        for group in self._optimizer.param_groups:
            group["lr"] = self._rate
        moving, velocity = self.net(batch.ranges.float(), batch.returns)
        loss = self.loss(moving, velocity, batch)
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        return loss.detach()

    @property
    def _rate(self) -> float:
        """Learning rate of the next update."""
        share = self.done / self.updates
        return self.learning_rate * (1.0 - (1.0 - self.final_scale) * share)

    def _report(self, bar: tqdm) -> None:
        """Write the mean loss since the last report, and the figures on the held-out samples."""
        mean = float(self._sum) / ((self.done - 1) % self.evaluate_every + 1)
        if not math.isfinite(mean):
            raise ValueError(
                f"learning_rate={self.learning_rate}: the loss is not finite after {self.done} "
                "updates; choose a smaller one in a new run"
            )
        self._sum.zero_()
        scores = flow_scores(self.net, self.held_out, self.loss)
        row = {f"held_out/{name}": value for name, value in scores.items()}
        self._log.log(self._frames, self.done, {"train/loss": mean, **row})
        bar.set_postfix(
            error=f"{scores['velocity_error_median']:.2f} m/s",
            recall=f"{scores['recall']:.0%}",
            refresh=False,
        )

    def _save(self) -> None:
        self._log.synchronize()
        self.checkpoints.save(
            {
                "updates": self.done,
                "net": self.net.state_dict(),
                "optimizer": self._optimizer.state_dict(),
                "generator": self._generator.get_state(),
                "sum": self._sum,
                "log_rows": self._log.num_rows,
            }
        )

    def _restore(self) -> int:
        """Load the last checkpoint; return its number of log rows."""
        state = self.checkpoints.load()
        self.net.load_state_dict(state["net"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._generator.set_state(state["generator"])
        self._sum.copy_(state["sum"])
        self.done = state["updates"]
        return state["log_rows"]
