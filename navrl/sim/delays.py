"""Delays of scans and commands, fixed or drawn per episode."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from navrl.sim.draws import Uniform, Value, check_not_negative, draw, limits, nominal

_TOLERANCE = 1e-6  # substeps


@dataclass(frozen=True)
class Delays:
    """Delays of scans and commands.

    Each value is a number, a multiple of the simulator's substep, or a
    :class:`navrl.sim.Uniform`, which is drawn per episode from the scenario's ``noise_seed`` and
    rounded to whole substeps. The two jitters are drawn at each step.

    Args:
        scan_age_s: Age of a scan's last beam when the policy reads it, s. The reported pose is not
            delayed.
        speed_delay_s: Time from the start of a step until its forward speed takes effect, s; the
            earlier commands apply until then, and zero before the first command.
        turn_rate_delay_s: The same for the turn rate, s.
        command_delay_s: Delay of all components of a command, s, added to the two above.
        revolution_s: Time of a revolution of a spinning lidar, s; 0 measures all beams at once.
            The beams are measured in their order, at constant speed. With beams all around the
            first is measured ``revolution_s`` before the last, otherwise their share of a circle
            earlier. Each beam sees robot and pedestrians at the nearest substep.
        scan_jitter_s: Extra age of each scan, s; a number j draws from 0 to j. A scan is never
            older than the scan before it.
        command_jitter_s: Extra delay of each command, s, as ``scan_jitter_s``. A command never
            gives way to an earlier one.

    Raises:
        ValueError: If a value is negative or not finite.

    Example:
        >>> delays = Delays(scan_age_s=Uniform(0.0, 0.2), command_delay_s=0.1)
        >>> seed = torch.tensor([3, 4])
        >>> delays.substeps("command_delay_s", 0.02, seed).tolist()
        [5, 5]
        >>> delays.max_substeps("scan_age_s", 0.02)
        10

    Reference:
        SRU (Yang et al. 2025) draws an observation delay of 0 to 0.4 s; a spinning RPLidar turns at
        5 to 15 Hz.
    """

    scan_age_s: Value = 0.0
    speed_delay_s: Value = 0.0
    turn_rate_delay_s: Value = 0.0
    command_delay_s: Value = 0.0
    revolution_s: Value = 0.0
    scan_jitter_s: Value = 0.0
    command_jitter_s: Value = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        check_not_negative("finite and >= 0 s", **vars(self))

    @property
    def nominal_command_delays_s(self) -> tuple[float, float]:
        """Medians of the delays of speed and turn rate, without jitter, s."""
        common = nominal(self.command_delay_s)
        return common + nominal(self.speed_delay_s), common + nominal(self.turn_rate_delay_s)

    @property
    def nominal_scan_age_s(self) -> float:
        """Median age of the middle of a scan, without jitter, s."""
        return nominal(self.scan_age_s) + 0.5 * nominal(self.revolution_s)

    def max_substeps(self, name: str, substep_s: float) -> int:
        """Return the largest possible value of a delay in substeps.

        Raises:
            ValueError: If the delay is fixed and not a multiple of the substep.
        """
        value = getattr(self, name)
        high = limits(value)[1] / substep_s
        is_drawn = isinstance(value, Uniform) or name.endswith("_jitter_s")
        if not is_drawn and abs(high - round(high)) > _TOLERANCE:
            raise ValueError(
                f"{name}={value}: must be a multiple of the substep, {substep_s} s, "
                "or a navrl.sim.Uniform"
            )
        return round(high)

    def substeps(self, name: str, substep_s: float, seed: Tensor) -> Tensor:
        """Return a delay of each episode [M] int64 substeps; ``seed`` [M] int64."""
        return (draw(name, getattr(self, name), seed) / substep_s).round().long()

    def jitter_substeps(self, name: str, substep_s: float, seed: Tensor, step: Tensor) -> Tensor:
        """Return a jitter [M] int64 substeps at the steps [M] int64 of the episodes."""
        value = getattr(self, name)
        value = value if isinstance(value, Uniform) else Uniform(0.0, value)
        return (draw(name, value, seed, step) / substep_s).round().long()


class CommandQueue:
    """Queue of commands that have not taken effect yet.

    Args:
        num_worlds: Number of worlds N.
        command_size: Number of command components C.
        delays: Delays of speed and turn rate; further components have that of the turn rate.
        substeps: Substeps S per step.
        substep_s: Duration of a substep, s.
        device: Device of the commands.

    Attributes:
        rows: Rows of the worlds: ``pending`` [N, D, C] float64, the commands of the last D steps,
            latest first; ``waits`` [N, D, 2] int64, substeps from the start of their step until
            speed and turn rate take effect; ``delay`` [N, 2] int64, the same without jitter for
            the next commands; ``seed`` and ``step`` [N] int64 of the episodes.
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
        self._delays, self._substeps, self._substep_s = delays, substeps, substep_s
        most = {
            field.name: delays.max_substeps(field.name, substep_s)
            for field in fields(delays)
            if not field.name.startswith(("scan", "revolution"))
        }
        axis = max(most["speed_delay_s"], most["turn_rate_delay_s"])
        longest = axis + most["command_delay_s"] + most["command_jitter_s"]
        self._jitters = most["command_jitter_s"] > 0
        self.num_steps = -(-longest // substeps)
        """Number D of steps until the latest command takes effect; 0 without delays."""
        whole = {"dtype": torch.int64, "device": device}
        shape = (num_worlds, self.num_steps)
        self.rows = {
            "pending": torch.zeros(*shape, command_size, dtype=torch.float64, device=device),
            "waits": torch.zeros(*shape, 2, **whole),
            "delay": torch.zeros(num_worlds, 2, **whole),
            "seed": torch.zeros(num_worlds, **whole),
            "step": torch.zeros(num_worlds, **whole),
        }
        self._axis = torch.tensor([0] + [1] * (command_size - 1), device=device)
        self._age = torch.arange(self.num_steps + 1, device=device)[:, None]  # steps
        self._index = torch.arange(substeps, device=device)[:, None]  # substep of a step

    def push(self, command: Tensor) -> Tensor:
        """Add the commands of a step.

        Args:
            command: [N, C] float64.

        Returns:
            [N, S, C] float64, the commands that apply in each substep; [N, 1, C] without delays.
        """
        if self.num_steps == 0:
            return command[:, None]
        rows = self.rows
        wait = rows["delay"]
        if self._jitters:
            draws = (self._substep_s, rows["seed"], rows["step"])
            wait = wait + self._delays.jitter_substeps("command_jitter_s", *draws)[:, None]
        given = torch.cat((command[:, None], rows["pending"]), dim=1)
        waits = torch.cat((wait[:, None], rows["waits"]), dim=1)
        start = waits - self._age * self._substeps  # after the start of this step
        is_due = start[:, :, None] <= self._index
        newest = torch.where(is_due, self._age[:, None], self.num_steps).amin(1)  # [N, S, 2]
        rows["pending"], rows["waits"] = given[:, :-1].contiguous(), waits[:, :-1].contiguous()
        rows["step"] = rows["step"] + 1
        return given.gather(1, newest[:, :, self._axis])

    def reset(self, worlds: Tensor, seed: Tensor) -> None:
        """Start episodes: stationary robots, delays drawn from the seeds.

        Args:
            worlds: [M] int64.
            seed: [M] int64, ``noise_seed`` of the scenarios.
        """
        if self.num_steps == 0:
            return
        common, speed, turn = (
            self._delays.substeps(name, self._substep_s, seed)
            for name in ("command_delay_s", "speed_delay_s", "turn_rate_delay_s")
        )
        self.rows["delay"][worlds] = torch.stack((common + speed, common + turn), dim=-1)
        self.rows["seed"][worlds] = seed
        for name in ("pending", "waits", "step"):
            self.rows[name][worlds] = 0

    def remaining_substeps(self) -> Tensor:
        """Return the time until the pending commands take effect.

        Returns:
            [N, D, 2] int64 substeps from now for speed and turn rate; 0 or less if the command has
            taken effect.
        """
        return self.rows["waits"] - (self._age[:-1] + 1) * self._substeps

    def upcoming(self) -> tuple[Tensor, Tensor]:
        """Return the commands that apply before a command given now takes effect.

        Returns:
            The commands [N, U, C] float64 of the next U substeps, and the number [N] int64 of those
            substeps before both components of a command given now take effect, without jitter.
        """
        count = self.rows["delay"].amax(-1)
        ahead = torch.arange(self.num_steps * self._substeps, device=count.device)
        if self.num_steps == 0:
            return self.rows["pending"], count
        is_due = self.remaining_substeps()[:, :, None] <= ahead[:, None]  # [N, D, U, 2]
        newest = torch.where(is_due, self._age[:-1, None], self.num_steps - 1).amin(1)
        return self.rows["pending"].gather(1, newest[:, :, self._axis]), count

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all rows; empty without delays."""
        return copied(self.rows, "commands.") if self.num_steps else {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the rows of :meth:`state_dict`; other keys are ignored.

        Raises:
            ValueError: If a key is missing or its shape differs.
        """
        if self.num_steps:
            self.rows = restored(self.rows, state, "commands.")


def copied(rows: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return copies of the rows under names with a prefix."""
    return {prefix + name: value.clone() for name, value in rows.items()}


def restored(rows: dict[str, Tensor], state: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return copies of the rows of a state, with the names, devices and dtypes of ``rows``.

    Raises:
        ValueError: If a key is missing or its shape differs.
    """
    for name, own in rows.items():
        got = list(state[prefix + name].shape) if prefix + name in state else "nothing"
        if got != list(own.shape):
            raise ValueError(
                f"state['{prefix}{name}']: must have shape {list(own.shape)}, got {got}"
            )
    return {
        name: state[prefix + name].to(own.device, own.dtype, copy=True)
        for name, own in rows.items()
    }
