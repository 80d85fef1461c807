"""Recording of episodes while they are played."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from navrl import keys
from navrl.envs.transformed import base_env
from navrl.evaluation.recording import DECIDED, OBSERVED, REQUESTED, Recording
from navrl.evaluation.rollout import ERROR, EpisodeRecord, evaluate
from navrl.evaluation.series import requested_command, true_pose
from navrl.worlds import Scenario, ScenarioBatch


class EpisodeRecorder:
    """Recorder of all worlds, the ``on_step`` of :func:`navrl.evaluation.evaluate`.

    It does not affect the episodes.

    Args:
        env: Environment of the evaluation, with ``privileged=True``.
    """

    def __init__(self, env: TransformedEnv) -> None:
        self._env = env
        self.clear()

    def clear(self) -> None:
        """Discard the collected steps."""
        self._observed: list[dict[str, np.ndarray]] = []
        self._decided: list[dict[str, np.ndarray]] = []
        self._terms: list[dict[str, np.ndarray]] = []
        self._contact: list[np.ndarray] = []

    def __call__(self, stepped: TensorDictBase) -> None:
        """Add a batch of transitions."""
        after = stepped.get("next")
        if not self._observed:
            self._observed.append(_observed(stepped))
        self._observed.append(_observed(after))
        commands = {
            keys.ACTION: after[keys.COMMAND],
            REQUESTED: requested_command(self._env, stepped),
        }
        attention = [name for name in DECIDED if name not in commands]
        self._decided.append({**_copies(stepped, attention), **_copies(commands, commands)})
        terms = after.get(keys.REWARD_TERMS)
        self._terms.append(_copies(terms, terms.keys()))
        self._contact.append(_copies(after, [keys.CONTACT])[keys.CONTACT])

    def recording(self, row: int, scenario: Scenario, record: EpisodeRecord) -> Recording:
        """Return the recording of an episode; steps of its world after the end are ignored.

        Args:
            row: Index of the world.
            scenario: Scenario of the world.
            record: Record of the episode, with its outcome and number of steps.

        Raises:
            ValueError: If its steps were not collected.
        """
        steps = record.steps
        if not 0 < steps <= len(self._decided):
            raise ValueError(
                f"record.steps={steps}: must be within 1..{len(self._decided)}, the collected steps"
            )
        terms = {name: value[:, 0] for name, value in _series(self._terms[:steps], row).items()}
        return Recording.of_episode(
            scenario,
            record.outcome,
            base_env(self._env),
            reward_terms=terms,
            contact=self._contact[steps - 1][row].item(),  # later rows belong to other contacts
            **_series(self._observed[: steps + 1], row),
            **_series(self._decided[:steps], row),
        )


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
    recorder = EpisodeRecorder(env)
    (record,) = evaluate(env, policy, ScenarioBatch.pack([scenario]), on_step=recorder)
    if record.outcome == ERROR:
        raise RuntimeError(f"scenario {scenario.index} of {scenario.suite}:\n{record.error}")
    return recorder.recording(0, scenario, record)


def _observed(step: TensorDictBase) -> dict[str, np.ndarray]:
    """Return the observations of a step, with the true pose."""
    pose = true_pose(step).detach().cpu().numpy().copy()
    return {**_copies(step, OBSERVED), keys.POSE: pose}


def _copies(
    step: TensorDictBase | dict[str, Tensor], names: Iterable[str]
) -> dict[str, np.ndarray]:
    found = {name: step.get(name, None) for name in names}
    return {k: v.detach().cpu().numpy().copy() for k, v in found.items() if v is not None}


def _series(steps: list[dict[str, np.ndarray]], row: int) -> dict[str, np.ndarray]:
    """Return one world's rows of every array, stacked over time."""
    return {name: np.stack([step[name][row] for step in steps]) for name in steps[0]}
