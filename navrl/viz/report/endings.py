"""Labels and colors of outcomes in the report, by at-fault party and object."""

from __future__ import annotations

from collections.abc import Mapping

from navrl.evaluation.metrics import METRICS, Trajectory, collision_furniture
from navrl.evaluation.recording import Recording
from navrl.evaluation.results import OUTCOMES
from navrl.sim import Contact
from navrl.viz.style import BLACK

_PARTS = {
    "collision_pedestrian": ("moved_into_pedestrian", "hit_by_pedestrian"),
    "collision_static": ("collision_wall", "collision_furniture"),
}
_UNCLASSIFIED = {  # of files from before the contacts were classified
    "collision_pedestrian": ("collision with a pedestrian, fault unknown", "#EFB08C"),
    "collision_static": ("collision with a wall or furniture", "#F3D694"),
}


def _endings() -> dict[str, tuple[str, str]]:
    """Return label and color of each ending, in the order of the outcomes."""
    known = {m.name: (m.label, m.color) for m in METRICS if m.is_ending} | _UNCLASSIFIED
    names = [name for outcome in OUTCOMES for name in (*_PARTS.get(outcome, ()), outcome)]
    return {**{name: known[name] for name in names}, "error": ("error", BLACK)}


ENDINGS = _endings()
"""Label and color of each ending; two are of files from before contacts were classified."""
_ENDING_OF_CONTACT = {
    Contact.PEDESTRIAN: "moved_into_pedestrian",
    Contact.HIT_BY_PEDESTRIAN: "hit_by_pedestrian",
}


def ending_of_row(row: Mapping[str, str]) -> str:
    """Return the key of :data:`ENDINGS` of a row of ``episodes.csv``.

    It is the outcome if the columns that refine it are missing or empty.
    """
    outcome = row["outcome"]
    set_ = [part for part in _PARTS.get(outcome, ()) if float(row.get(part) or 0) == 1.0]
    return set_[0] if set_ else outcome


def ending_of_recording(recording: Recording) -> str:
    """Return the key of :data:`ENDINGS` of a recording; the touched object is measured."""
    if recording.outcome == "collision_static":
        touched = Trajectory.from_recordings([recording], max_speed=1.0)
        return "collision_furniture" if collision_furniture(touched)[0] else "collision_wall"
    if recording.outcome == "collision_pedestrian":
        return _ENDING_OF_CONTACT.get(recording.contact, recording.outcome)
    return recording.outcome
