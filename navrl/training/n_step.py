"""N-step returns."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase

STEPS = "steps_to_next_obs"  # TorchRL's key; its value estimators discount by gamma to this power


class NStepReturn:
    """Combine single steps to transitions over up to ``num_steps``, incrementally.

    A step is delayed until ``num_steps - 1`` later steps are known. Its reward is then the
    discounted sum up to the horizon or, if earlier, the end of its episode, and ``next`` the state
    after the last of these steps. Rewards propagate ``num_steps`` times as fast through
    bootstrapped values. The returns are those of the behavior policy, without off-policy
    correction.

    Args:
        num_steps: Horizon; 1 returns every step unchanged and without delay.
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
        """Add one step of ``[M]`` worlds; return the transitions that it completes.

        Args:
            step: Transitions with ``reward``, ``done`` and ``terminated`` ``[M, 1]`` under
                ``next``; row i is the same world in every call.

        Returns:
            ``[M]`` transitions that started ``num_steps - 1`` calls ago, with
            ``steps_to_next_obs [M, 1]``; ``None`` while the first ones are incomplete.

        Raises:
            ValueError: If the number of worlds changed.
        """
        if self.num_steps == 1:
            return step
        if self._window and len(self._window[0]) != len(step):
            raise ValueError(
                f"step: must have the same {len(self._window[0])} worlds in every call for n-step "
                f"returns, got {len(step)}"
            )
        self._window.append(step.clone())
        if len(self._window) < self.num_steps:
            return None
        oldest = self._window.pop(0)
        return self._fold(oldest, self._window)

    def _fold(self, first: TensorDictBase, later: list[TensorDictBase]) -> TensorDictBase:
        following = first.get("next").clone()
        reward, done = following.get("reward").clone(), following.get("done").clone()
        steps = torch.ones_like(reward)
        for power, step in enumerate(later, start=1):
            running = ~done
            reward = reward + self.gamma**power * step["next", "reward"] * running
            steps = steps + running
            following = torch.where(running.squeeze(-1), step["next"], following)
            done = done | step["next", "done"]
        following.set("reward", reward)
        return first.clone(False).update({"next": following, STEPS: steps})

    def state_dict(self) -> list[dict]:
        """Return the pending steps."""
        return [step.to_dict() for step in self._window]

    def load_state_dict(self, state: list[dict], device: torch.device | str = "cpu") -> None:
        """Restore the pending steps of :meth:`state_dict` on ``device``."""
        steps = [TensorDict(step, [len(step["next"]["done"])]) for step in state]
        self._window = [step.to(device) for step in steps]
