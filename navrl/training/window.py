"""Statistics of a training since the last row of its log."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from tensordict import TensorDictBase

from navrl import keys
from navrl.envs import Outcome
from navrl.training.collectors import Phases


@dataclass
class Window:
    """Sums since the last row of the log, as tensors on their device without synchronization."""

    terms: dict[str, torch.Tensor | float] = field(default_factory=lambda: defaultdict(float))
    outcomes: torch.Tensor | int = 0  # episodes ended, by outcome
    learning: dict[str, torch.Tensor | float] = field(default_factory=lambda: defaultdict(float))
    phases: Phases = field(default_factory=Phases)
    frames: int = 0
    updates: int = 0

    def add_step(self, following: TensorDictBase) -> torch.Tensor:
        """Add the results of one step of ``[M]`` worlds; return the number of ended episodes."""
        for name, term in following.get(keys.REWARD_TERMS).items():
            self.terms[name] = self.terms[name] + term.sum().double()
        ended = _count_outcomes(following)
        self.outcomes = ended + torch.as_tensor(self.outcomes, device=ended.device)
        self.frames += following.numel()
        return ended.sum()

    def add_updates(self, sums: Mapping[str, torch.Tensor], count: int) -> None:
        """Add the learner's scalars, summed over ``count`` updates."""
        for name, value in sums.items():
            self.learning[name] = self.learning[name] + value
        self.updates += count

    def row(self) -> dict[str, float]:
        """Return the means and rates of a row of the log; synchronizes with the device."""
        seconds = sum(self.phases.seconds.values())
        outcomes = torch.as_tensor(self.outcomes).expand(len(Outcome)).tolist()
        ended, frames = max(sum(outcomes), 1), max(self.frames, 1)
        return {
            **{f"reward/{k}": float(v) / frames for k, v in self.terms.items()},
            **{
                f"train/{outcome.name.lower()}_rate": outcomes[outcome] / ended
                for outcome in Outcome
                if outcome is not Outcome.RUNNING
            },
            **{f"learn/{k}": float(v) / self.updates for k, v in self.learning.items()},
            **{f"seconds/{k}": v / self.updates for k, v in self.phases.seconds.items()},
            "speed/frames_per_s": self.frames / seconds,
            "speed/updates_per_s": self.updates / seconds,
        }

    def state_dict(self) -> dict:
        """Return the sums as Python numbers; the conversion from tensors is exact."""
        return {
            "terms": {name: float(value) for name, value in self.terms.items()},
            "outcomes": torch.as_tensor(self.outcomes).tolist(),
            "learning": {name: float(value) for name, value in self.learning.items()},
            "seconds": dict(self.phases.seconds),
            "frames": self.frames,
            "updates": self.updates,
        }

    @classmethod
    def from_state(cls, state: Mapping) -> Window:
        """Create a window from a state of :meth:`state_dict`."""
        window = cls(frames=state["frames"], updates=state["updates"])
        window.terms.update(state["terms"])
        window.learning.update(state["learning"])
        window.phases.seconds.update(state["seconds"])
        window.outcomes = torch.tensor(state["outcomes"])
        return window


def _count_outcomes(following: TensorDictBase) -> torch.Tensor:
    """Return the number of episodes that ended at this step by outcome, ``[outcomes]`` int64."""
    outcome, done = (following.get(key).flatten() for key in (keys.OUTCOME, "done"))
    return outcome.new_zeros(len(Outcome)).index_add_(0, outcome, done.to(outcome.dtype))
