"""Checks of ``summary.json`` from untrusted files."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from navrl.evaluation.metrics import METRICS, Metric
from navrl.untrusted import is_number

_MAX_NAME = 500  # characters; labels of swept policies have about 60
_SHOWN = 60  # characters of an invalid value in a message

_TEXTS = ("policy", "suite", "suite_hash", "simulator")
_PERTURBATION = ("name", "kind", "about")
_PART = {"episodes", "success_rate"}  # keys of each kind of world
_KNOWN = frozenset(metric.name for metric in METRICS)
_NEEDED = (*_TEXTS, "episodes", "success_rate", "collision_rate", "timeout_rate")


def check_summary(summary: Mapping[str, object]) -> str | None:
    """Return the first error of a summary, or ``None``.

    Unknown keys are ignored, since newer versions may add some.
    """
    missing = [name for name in _NEEDED if name not in summary]
    if missing:
        return f"keys {missing} are missing"
    wrong = _first_wrong(summary)
    if wrong is not None:
        return wrong
    try:
        own_metrics(summary)
    except ValueError as error:
        return str(error)
    kinds = summary.get("by_scenario") or {}
    if not isinstance(kinds, Mapping):
        return "by_scenario: must be an object"
    for kind, part in kinds.items():
        if not isinstance(part, Mapping) or not part.keys() >= _PART:
            return f"by_scenario.{kind[:_SHOWN]}: must be an object with {sorted(_PART)}"
        wrong = _first_wrong(part)
        if wrong is not None:
            return f"by_scenario.{kind[:_SHOWN]}.{wrong}"
    return None


def own_metrics(summary: Mapping[str, object]) -> tuple[Metric, ...]:
    """Return the user's own metrics that a summary lists, without their functions.

    Raises:
        ValueError: If what it holds of one is not allowed.
    """
    metrics = summary.get("metrics") or {}
    if not isinstance(metrics, Mapping):
        raise ValueError("metrics: must be an object")
    found = []
    for name, facts in metrics.items():
        if name in _KNOWN or not isinstance(facts, Mapping) or "compared" not in facts:
            continue  # navrl's own, or of a version that does not say how to compare it
        try:
            found.append(Metric.from_facts(name, facts))
        except ValueError as error:
            raise ValueError(f"metrics.{name[:_SHOWN]}: {error}") from None
    return tuple(found)


def _first_wrong(part: Mapping[str, object]) -> str | None:
    """Return the first value that is not allowed for its name, or ``None``."""
    for name, value in part.items():
        is_right, allowed = _rule(name)
        if not is_right(value):
            return f"{name}={str(value)[:_SHOWN]!r}: must be {allowed}"
    return None


def _rule(name: str) -> tuple[Callable[[object], bool], str]:
    """Return the test of a key's value and a description of allowed values."""
    if name in _TEXTS:
        return _is_name, f"text of at most {_MAX_NAME} characters"
    if name == "change":
        return _is_change, "an object of plain values"
    if name == "perturbation":
        return _is_perturbation, f"an object with {', '.join(_PERTURBATION)}, texts"
    if name == "observes":
        return _is_names, "a list of texts"
    if name == "privileged":
        return lambda value: isinstance(value, bool), "true or false"
    if name == "episodes":
        return (
            lambda value: isinstance(value, int) and is_number(value, 1),
            "a number of at least 1",
        )
    if name in ("errors", "successes", "solved", "hit_by_pedestrian"):
        return (
            lambda value: isinstance(value, int) and is_number(value, 0),
            "a number of at least 0",
        )
    if name.endswith("_rate"):
        return lambda value: is_number(value, 0, 1), "a number in [0, 1]"
    if name.endswith("_interval"):
        return _is_interval, "two numbers in [0, 1]"
    if name == "navigation_time_s":
        return lambda value: value is None or is_number(value, 0), "a number of at least 0, or null"
    return lambda _: True, "anything"


def _is_name(value: object) -> bool:
    return isinstance(value, str) and len(value) <= _MAX_NAME


def _is_names(value: object) -> bool:
    return isinstance(value, list) and len(value) <= _SHOWN and all(map(_is_name, value))


def _is_change(value: object) -> bool:
    return value is None or isinstance(value, Mapping)


def _is_perturbation(value: object) -> bool:
    return isinstance(value, Mapping) and all(_is_name(value.get(key)) for key in _PERTURBATION)


def _is_interval(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(is_number(v, 0, 1) for v in value)
