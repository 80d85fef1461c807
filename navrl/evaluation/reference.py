"""Reference policy of comparisons."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache

import numpy as np

from navrl.evaluation.seeds import split_seed
from navrl.evaluation.stored import Evaluation
from navrl.policies import classical, controller

_PAPER = "paper"


def is_privileged(evaluation: Evaluation) -> bool:
    """Return whether the policy reads the true state.

    The summary says so; in older ones the name of one of navrl's controllers does.
    """
    found = evaluation.summary.get("privileged")
    return evaluation.summary["policy"] in _privileged_names() if found is None else bool(found)


@lru_cache(maxsize=1)
def _privileged_names() -> frozenset[str]:
    members = vars(classical).items()
    return frozenset(name.lower() for name, member in members if controller.is_privileged(member))


def default_reference(by_label: Mapping[str, Evaluation]) -> str | None:
    """Return the default reference of a table.

    Args:
        by_label: Evaluations by label.

    Returns:
        ``paper`` if present, with any seed; else the non-privileged approach with the highest
        success, as mean over its seeds, and the first by name of equals; ``None`` if there is no
        such approach, or no other run.
    """
    rates: dict[str, list[float]] = {}
    for label, evaluation in by_label.items():
        if not is_privileged(evaluation):
            rate = float(evaluation.summary["success_rate"])
            rates.setdefault(split_seed(label)[0], []).append(rate)
    if _PAPER in rates:
        return _PAPER
    if not rates or len(by_label) < 2:
        return None
    return min(rates, key=lambda approach: (-np.mean(rates[approach]), approach))


def check_reference(reference: str, labels: Iterable[str]) -> None:
    """Check that a requested reference exists.

    Raises:
        ValueError: If it is neither a label nor an approach with several seeds; the message lists
            both.
    """
    known = sorted({name for label in labels for name in (label, split_seed(label)[0])})
    if reference not in known:
        raise ValueError(
            f"reference={reference}: must be one of these policies; there are {', '.join(known)}"
        )


def reference_of(label: str, reference: str | None, known: Iterable[str]) -> str | None:
    """Return the label of the reference of a run.

    It is the reference with the same seed, if any; a run without seed in its name has seed 0.
    """
    known = list(known)
    seed = split_seed(label)[1]
    if seed is None and reference in known:
        return reference
    for other in known:
        if split_seed(other) == (reference, seed or 0):
            return other
    return reference
