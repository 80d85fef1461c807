"""Sensing and actuation delays, as multiples of the substep of the simulator."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_TOLERANCE = 1e-6  # substeps


@dataclass(frozen=True)
class Delays:
    """Delays of scans and commands.

    Args:
        scan_age_s: Age of a scan when the policy reads it, s. The reported pose is not delayed.
        speed_delay_s: Time from the start of a step until its forward speed takes effect, s; the
            earlier commands apply until then, and zero before the first command.
        turn_rate_delay_s: The same for the turn rate, s.

    Raises:
        ValueError: If a value is negative or not finite.
    """

    scan_age_s: float = 0.0
    speed_delay_s: float = 0.0
    turn_rate_delay_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("scan_age_s", "speed_delay_s", "turn_rate_delay_s"):
            value = getattr(self, name)
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"{name}={value}: must be finite and >= 0 s")

    def substeps(self, name: str, substep_s: float) -> int:
        """Return a delay as a number of substeps.

        Raises:
            ValueError: If the delay is not a multiple of the substep.
        """
        value = getattr(self, name)
        count = round(value / substep_s)
        if abs(value / substep_s - count) > _TOLERANCE:
            raise ValueError(f"{name}={value}: must be a multiple of the substep, {substep_s} s")
        return count


class CommandQueue:
    """Queue of commands that have not taken effect yet.

    Args:
        num_worlds: Number of worlds N.
        command_size: Number of command components C.
        delays: Delays of speed and turn rate; further components have that of the turn rate.
        substeps: Substeps per step.
        substep_s: Duration of a substep, s.
        device: Device of the commands.
    """

    def __init__(
        self,
        num_worlds: int,
        command_size: int,
        delays: Delays,
        substeps: int,
        substep_s: float,
        device: torch.device,
    ) -> None:
        waits = [
            delays.substeps(name, substep_s) for name in ("speed_delay_s", "turn_rate_delay_s")
        ]
        self._steps = [-(-wait // substeps) for wait in waits]
        self.first_substeps = tuple(
            wait - (steps - 1) * substeps if steps else 0
            for wait, steps in zip(waits, self._steps, strict=True)
        )
        """Substep at which the newer command of :meth:`push` takes effect: speed, turn rate."""
        count = max(self._steps)
        self.pending = torch.zeros(
            num_worlds, count, command_size, dtype=torch.float64, device=device
        )
        """[N, D, C] float64, commands of the last steps, latest first."""

    def push(self, command: Tensor) -> tuple[Tensor, Tensor]:
        """Add the commands of a step.

        Args:
            command: [N, C] float64.

        Returns:
            ``(older, newer)``, [N, C] each: commands before and from :attr:`first_substeps` on.
        """
        if self.pending.shape[1] == 0:
            return command, command
        given = torch.cat((command[:, None], self.pending), dim=1)
        self.pending = given[:, :-1].contiguous()
        speed, turn = self._steps
        older = torch.cat((given[:, speed, :1], given[:, turn, 1:]), dim=-1)
        newer = torch.cat((given[:, max(speed - 1, 0), :1], given[:, max(turn - 1, 0), 1:]), dim=-1)
        return older, newer

    def reset(self, worlds: Tensor) -> None:
        """Set the pending commands of these worlds [M] to zero; the robots are stationary."""
        self.pending[worlds] = 0.0


class ScanMemory:
    """Snapshots of robot and pedestrians at the times of scans that are not reported yet.

    Args:
        delays: Delays, for the age of a scan.
        substeps: Substeps per step.
        substep_s: Duration of a substep, s.
    """

    def __init__(self, delays: Delays, substeps: int, substep_s: float) -> None:
        age = delays.substeps("scan_age_s", substep_s)
        self.num_steps = -(-age // substeps)
        """Steps between a snapshot and its scan, rounded up; 0 without delay."""
        self.scanned_substep = self.num_steps * substeps - age if age else substeps
        """Substep of each step before which the snapshot is taken; ``substeps`` without delay."""
        self._snapshots: list[dict[str, Tensor]] = []

    @property
    def is_used(self) -> bool:
        """Return whether scans are older than the state."""
        return self.num_steps > 0

    def reset(self, worlds: Tensor, now: dict[str, Tensor]) -> None:
        """Fill the snapshots of these worlds [M] with the current rows ``now`` [N, ...]."""
        while len(self._snapshots) < self.num_steps:
            self._snapshots.append({name: rows.clone() for name, rows in now.items()})
        for snapshot in self._snapshots:
            for name, rows in snapshot.items():
                rows[worlds] = now[name][worlds]

    def next(self) -> dict[str, Tensor]:
        """Discard the oldest snapshot and return the rows for the snapshot of the next step."""
        latest = self._snapshots[-1]
        rows = {name: value.clone() for name, value in latest.items()}
        self._snapshots = [*self._snapshots[1:], rows]
        return rows

    @property
    def oldest(self) -> dict[str, Tensor]:
        """Snapshot of the current scan."""
        return self._snapshots[0]

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all snapshots."""
        return {
            f"snapshot.{index}.{name}": rows.clone()
            for index, snapshot in enumerate(self._snapshots)
            for name, rows in snapshot.items()
        }

    def load_state_dict(self, state: dict[str, Tensor], device: torch.device) -> None:
        """Restore the snapshots of :meth:`state_dict`; other keys are ignored."""
        snapshots: dict[int, dict[str, Tensor]] = {}
        for key, rows in state.items():
            if key.startswith("snapshot."):
                _, index, name = key.split(".")
                snapshots.setdefault(int(index), {})[name] = rows.to(device, copy=True)
        self._snapshots = [snapshots[index] for index in sorted(snapshots)]
