"""Recording of an episode while it is played."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from navrl import keys
from navrl.envs import Outcome
from navrl.envs.transformed import base_env
from navrl.evaluation.recording import DECIDED, OBSERVED, TERM, Recording
from navrl.evaluation.rollout import ERROR, evaluate
from navrl.worlds import Scenario, ScenarioBatch


class EpisodeRecorder:
    """Recorder of one world, the ``on_step`` of :func:`navrl.evaluation.evaluate`.

    It does not affect the episode.

    Args:
        env: Environment of the evaluation, with ``privileged=True``.
        scenario: Scenario of the world.
        row: Index of the world.
    """

    def __init__(self, env: TransformedEnv, scenario: Scenario, row: int = 0) -> None:
        self._env, self._scenario, self._row = env, scenario, row
        self._series: dict[str, list[np.ndarray]] = defaultdict(list)
        self._outcome, self._contact = Outcome.RUNNING, 0

    def __call__(self, stepped: TensorDictBase) -> None:
        """Add a batch of transitions; steps after the world's end are ignored."""
        if self._outcome != Outcome.RUNNING:
            return
        before, after = stepped[self._row], stepped.get("next")[self._row]
        self._contact = int(after.get(keys.CONTACT))
        if not self._series:
            self._append(before, OBSERVED)
        self._append(after, OBSERVED)
        self._append(before, [name for name in DECIDED if name != keys.ACTION])
        command = self._env.transform.inv(stepped.exclude("next"))[keys.ACTION]
        self._series[keys.ACTION].append(_copy(command[self._row]))
        for name, term in after.get(keys.REWARD_TERMS).items():
            self._series[TERM + name].append(_copy(term.squeeze(-1)))
        self._outcome = Outcome(int(after.get(keys.OUTCOME)))

    def recording(self) -> Recording:
        """Return the recording of the episode.

        Raises:
            ValueError: If it has not ended.
        """
        if self._outcome == Outcome.RUNNING:
            raise ValueError("the episode has not ended")
        series: dict[str, Any] = {name: np.stack(rows) for name, rows in self._series.items()}
        names = [name for name in series if name.startswith(TERM)]
        series["contact"] = self._contact
        terms = {name.removeprefix(TERM): series.pop(name) for name in names}
        outcome = self._outcome.name.lower()
        base = base_env(self._env)
        return Recording.of_episode(self._scenario, outcome, base, reward_terms=terms, **series)

    def _append(self, step: TensorDictBase, names: list[str] | dict[str, tuple]) -> None:
        for name in names:
            value = step.get(name, None)
            if value is not None:
                self._series[name].append(_copy(value))


def record_episode(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    scenario: Scenario,
) -> Recording:
    """Play one scenario and record it.

    Args:
        env: Environment with ``privileged=True`` and any number of worlds; the first is recorded.
        policy: Writes a normalized action; attention weights are recorded if it writes them.
        scenario: Scenario to play.

    Returns:
        The recording of the episode, which equals that of :func:`navrl.evaluation.evaluate`.

    Raises:
        RuntimeError: If the episode raised an exception; the message has the traceback.
    """
    recorder = EpisodeRecorder(env, scenario)
    (record,) = evaluate(env, policy, ScenarioBatch.pack([scenario]), on_step=recorder)
    if record.outcome == ERROR:
        raise RuntimeError(f"scenario {scenario.index} of {scenario.suite}:\n{record.error}")
    return recorder.recording()


def _copy(value: Tensor) -> np.ndarray:
    return value.detach().cpu().numpy().copy()
