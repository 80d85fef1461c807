"""Memory of poses and pedestrians, from which scans of the past are taken."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.ops import se2
from navrl.ops.bodies import STATE_SIZE
from navrl.sim.delays import Delays, copied, restored


class ScanMemory:
    """Ring of the robots' poses and the pedestrians' states after each of the last substeps.

    It has no entries if no scan can be older than the state.

    Args:
        num_worlds: Number of worlds N.
        num_pedestrians: Number of pedestrian rows K.
        delays: Delays, for age, revolution time and jitter of scans.
        coverage: Share of a circle that the lidar's beams cover, in (0, 1].
        substeps: Substeps S per step.
        substep_s: Duration of a substep, s.
        device: Device of the rows.

    Attributes:
        rows: Rows of the worlds: ``pose`` [N, L, 3] and ``boxes`` [N, L, K, 7] float64, the ring
            of L entries; ``age`` [N] int64, substeps since the last beam of the current scan;
            ``delay`` [N] int64, the same without jitter; ``sweep`` [N] int64, substeps from the
            first to the last beam; ``seed`` and ``step`` [N] int64 of the episodes; ``present`` [N]
            int64, index of the entry of the current state. Entries that no scan sees may be
            missing. A frozen world retains its scan.
    """

    def __init__(
        self,
        num_worlds: int,
        num_pedestrians: int,
        delays: Delays,
        coverage: float,
        substeps: int,
        substep_s: float,
        device: torch.device,
    ) -> None:
        """Allocate the rows."""
        self._delays, self._substeps, self._substep_s = delays, substeps, substep_s
        self._coverage = coverage
        age, jitter, revolution = (
            delays.max_substeps(name, substep_s)
            for name in ("scan_age_s", "scan_jitter_s", "revolution_s")
        )
        self.max_jitter = jitter
        """Largest jitter of a scan's age, substeps."""
        oldest = age + jitter + round(revolution * coverage)
        self.length = oldest + 1 if oldest else 0
        """Number L of entries of the ring; 0 if no scan can be older than the state."""
        real = {"dtype": torch.float64, "device": device}
        whole = {"dtype": torch.int64, "device": device}
        self.rows = {
            "pose": torch.zeros(num_worlds, self.length, 3, **real),
            "boxes": torch.zeros(num_worlds, self.length, num_pedestrians, STATE_SIZE, **real),
        }
        for name in ("age", "delay", "sweep", "seed", "step", "present"):
            self.rows[name] = torch.zeros(num_worlds, **whole)

    @property
    def is_used(self) -> bool:
        """Return whether scans can be older than the state."""
        return self.length > 0

    @property
    def newest(self) -> Tensor:
        """Index [N] int64 of the entry that the last beam of the current scan sees."""
        return torch.remainder(self.rows["present"] - self.rows["age"], self.length)

    @property
    def sweep(self) -> Tensor:
        """Substeps [N] int64 from the first to the last beam of the current scan."""
        return self.rows["sweep"]

    def reset(self, worlds: Tensor, seed: Tensor, now: dict[str, Tensor]) -> None:
        """Start episodes: a stationary past, delays drawn from the seeds.

        Args:
            worlds: [M] int64.
            seed: [M] int64, ``noise_seed`` of the scenarios.
            now: ``pose`` [N, 3] and ``boxes`` [N, K, 7] of all worlds.
        """
        if not self.is_used:
            return
        rows = self.rows
        for name, value in now.items():
            rows[name][worlds] = value[worlds][:, None]
        revolution = self._delays.substeps("revolution_s", self._substep_s, seed)
        rows["sweep"][worlds] = (revolution * self._coverage).round().long()
        rows["delay"][worlds] = self._delays.substeps("scan_age_s", self._substep_s, seed)
        rows["seed"][worlds], rows["step"][worlds] = seed, 0
        rows["age"][worlds] = self._drawn_ages()[worlds]

    def write(self, world: int, pose: Tensor, boxes: Tensor) -> None:
        """Store the substeps of a step of one world: ``pose`` [S, 3] and ``boxes`` [S, K, 7]."""
        kept = min(self._substeps, self.length)
        entries = self.rows["present"][world] + self._substeps - torch.arange(kept).flip(0)
        self.rows["pose"][world, entries % self.length] = pose[-kept:]
        self.rows["boxes"][world, entries % self.length] = boxes[-kept:]

    def advance(self, moved: Tensor) -> None:
        """Make the last stored substep the current state, and draw the ages of the next scans.

        Args:
            moved: [N] bool, worlds that were not frozen in this step; the others do not change.
        """
        rows = self.rows
        rows["present"] = (rows["present"] + self._substeps * moved) % self.length
        rows["step"] = rows["step"] + moved
        if self.max_jitter:  # a scan is never older than the one before it
            age = torch.minimum(self._drawn_ages(), rows["age"] + self._substeps)
            rows["age"] = torch.where(moved, age, rows["age"])

    def _drawn_ages(self) -> Tensor:
        """Return the ages [N] int64 of scans at the current steps."""
        rows = self.rows
        if not self.max_jitter:
            return rows["delay"]
        draws = (self._substep_s, rows["seed"], rows["step"])
        return rows["delay"] + self._delays.jitter_substeps("scan_jitter_s", *draws)

    def entries(self, world: int) -> list[tuple[list[float], list[list[float]]]]:
        """Return pose and boxes of one world's current scan, from its first to its last beam."""
        newest, sweep = int(self.newest[world]), int(self.sweep[world])
        indices = [(newest - back) % self.length for back in range(sweep, -1, -1)]
        pose, boxes = (self.rows[name][world, indices].tolist() for name in ("pose", "boxes"))
        return list(zip(pose, boxes, strict=True))

    def motion(self, pose: Tensor) -> Tensor:
        """Return the frames of :meth:`navrl.sim.Simulator.scan_motion` for poses [N, 3] float64."""
        if not self.is_used:
            return pose.new_zeros(pose.shape[0], 2, 3)
        entries = torch.stack((self.newest - self.sweep, self.newest), dim=-1) % self.length
        then = self.rows["pose"].gather(1, entries[..., None].expand(-1, -1, 3))
        now = pose[:, None]
        offset = se2.rotate(then[..., :2] - now[..., :2], -now[..., 2])
        turn = se2.wrap_angle(then[..., 2:] - now[..., 2:])
        return torch.cat((offset, turn), dim=-1)  # zeros for equal poses, bit for bit

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all rows; empty if the ring is not used."""
        return copied(self.rows, "scans.") if self.is_used else {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the rows of :meth:`state_dict`; other keys are ignored.

        Raises:
            ValueError: If a key is missing or its shape differs.
        """
        if self.is_used:
            self.rows = restored(self.rows, state, "scans.")
