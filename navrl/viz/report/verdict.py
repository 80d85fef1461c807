"""Who is best, by how much, and whether that may be chance: the sentences of the page."""

from __future__ import annotations

from collections.abc import Sequence

from navrl.evaluation.comparison import ComparisonTable, Lead
from navrl.evaluation.statistics import p_value_text
from navrl.evaluation.stored import Evaluation

_SIGNIFICANT = 0.05
_USUAL = "paper"  # reference, which needs no mention


def members(table: ComparisonTable, evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Return the evaluations of a table in the order of its rows."""
    by_folder = {str(e.folder): e for e in evaluations}
    return [by_folder[row.folder] for row in table.rows]


def headline(table: ComparisonTable) -> str:
    """Say who succeeds how often, without a full stop; controllers that cheat do not count."""
    best = next((row for row in table.rows if not row.cheats), None)
    if best is None:
        return "Every controller here reads the true state: these are ceilings, not rivals"
    low, high = (f"{100 * bound:.1f}" for bound in best.intervals["success"])
    return (
        f"{best.policy} succeeds in {100 * best.rates['success']:.1f} % [{low}, {high}] "
        f"of {best.episodes:,} episodes"
    )


def verdict(table: ComparisonTable) -> str:
    """Say who is best, test it against the next, and name what may differ by chance."""
    sentences = [headline(table), _ahead_of_next(table.lead, table.rows[0].episodes)]
    if table.reference not in (None, _USUAL):
        sentences.append(f"Differences are to {table.reference}")
    tested = [row for row in table.rows if row.p_holm is not None]
    unsure = [row.policy for row in tested if row.p_holm >= _SIGNIFICANT]
    test = f"by exact McNemar tests, corrected by Holm for {len(tested)}"
    if unsure:
        sentences.append(
            f"Differences to {table.reference} that may be chance (p ≥ {_SIGNIFICANT}) {test}: "
            f"{', '.join(unsure)}"
        )
    elif tested:
        sentences.append(
            f"Every difference to {table.reference} is significant (p < {_SIGNIFICANT}) {test}"
        )
    return " ".join(f"{sentence}." for sentence in sentences if sentence)


def _ahead_of_next(lead: Lead | None, num_episodes: int) -> str:
    """Say how far the best is ahead of the next on the same episodes; nothing without a next."""
    if lead is None:
        return ""
    low, high = lead.difference_interval
    chance = "may be chance" if lead.p_value >= _SIGNIFICANT else "is hardly chance"
    p_text = p_value_text(lead.p_value)
    p_text = f"p {p_text}" if p_text.startswith("<") else f"p = {p_text}"
    return (
        f"On the same {num_episodes:,} episodes these are {100 * lead.difference:.1f} points more "
        f"than the next approach, {lead.second} (paired 95 % interval "
        f"[{100 * low:+.1f}, {100 * high:+.1f}], exact McNemar {p_text}), which {chance}"
    )
