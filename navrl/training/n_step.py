"""Rewards of several steps in one transition."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase

STEPS = "steps_to_next_obs"  # TorchRL's name: its value estimators discount by gamma to this power


class NStepReturn:
    """Turn single steps into transitions over up to ``num_steps``, as they come.

    A step is held back until ``num_steps - 1`` later ones are known; then its reward becomes the
    discounted sum up to the horizon or the end of its episode, whichever is first, and ``next``
    what followed the last of them. News of a collision or a goal travel ``num_steps`` times as fast
    through bootstrapped values. The rewards are those of the behaviour, uncorrected.

    Args:
        num_steps: Horizon; 1 gives every step as it is, at once.
        gamma: Discount factor per step.

    Raises:
        ValueError: If ``num_steps`` is not positive or ``gamma`` not in [0, 1].

    Reference:
        Not in the paper; Barth-Maron et al., 2018 (D4PG) for DDPG.
    """

    def __init__(self, num_steps: int = 1, gamma: float = 0.98) -> None:
        if num_steps < 1 or not 0 <= gamma <= 1:
            raise ValueError(
                f"num_steps={num_steps}: must be >= 1; gamma={gamma}: must be in [0, 1]"
            )
        self.num_steps, self.gamma = num_steps, gamma
        self._window: list[TensorDictBase] = []

    def __call__(self, step: TensorDictBase) -> TensorDictBase | None:
        """Take one step of ``[M]`` worlds; return the transitions that are now complete.

        Args:
            step: With ``next`` holding ``reward``, ``done`` and ``terminated`` ``[M, 1]``; row i is
                the same world in every call.

        Returns:
            ``[M]`` transitions that started ``num_steps - 1`` calls ago, with
            ``steps_to_next_obs [M, 1]``; ``None`` while the first are not complete.

        Raises:
            ValueError: If the number of worlds changed.
        """
        if self.num_steps == 1:
            return step
        if self._window and len(self._window[0]) != len(step):
            raise ValueError(
                f"n-step returns need the same {len(self._window[0])} worlds in every step, "
                f"got {len(step)}"
            )
        self._window.append(step.clone())
        if len(self._window) < self.num_steps:
            return None
        oldest = self._window.pop(0)
        return self._fold(oldest, self._window)

    def _fold(self, first: TensorDictBase, later: list[TensorDictBase]) -> TensorDictBase:
        following = first["next"].clone()
        reward, done = following["reward"].clone(), following["done"].clone()
        steps = torch.ones_like(reward)
        for power, step in enumerate(later, start=1):
            running = ~done
            reward = reward + self.gamma**power * step["next", "reward"] * running
            steps = steps + running
            following = torch.where(running.squeeze(-1), step["next"], following)
            done = done | step["next", "done"]
        following["reward"] = reward
        return first.clone(False).update({"next": following, STEPS: steps})

    def state_dict(self) -> list[dict]:
        """Return the steps that are held back."""
        return [step.to_dict() for step in self._window]

    def load_state_dict(self, state: list[dict], device: torch.device | str = "cpu") -> None:
        """Restore what :meth:`state_dict` returned, on ``device``."""
        steps = [TensorDict(step, [len(step["next"]["done"])]) for step in state]
        self._window = [step.to(device) for step in steps]
