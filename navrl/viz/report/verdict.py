"""Summary sentences of the report: the best policy, its lead and significance."""

from __future__ import annotations

from collections.abc import Sequence

from navrl.evaluation.comparison import ComparisonTable, Lead
from navrl.evaluation.statistics import MIN_PAIRS, interval_text, p_value_text
from navrl.evaluation.stored import Evaluation

_SIGNIFICANT = 0.05
_DEFAULT_REFERENCE = "paper"  # default reference, not mentioned


def members(table: ComparisonTable, evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Return the evaluations of a table in the order of its rows."""
    by_folder = {str(e.folder): e for e in evaluations}
    return [by_folder[row.folder] for row in table.rows]


def headline(table: ComparisonTable) -> str:
    """Return the best policy and its success, without privileged ones and without full stop."""
    best = next((row for row in table.rows if not row.is_privileged), None)
    if best is None:
        return "Every controller here is privileged (reads the true state)"
    low, high = best.intervals["success"]
    rate = f"{100 * best.rates['success']:.1f} %{interval_text(100 * low, 100 * high, '.1f')}"
    tied = [
        row.policy
        for row in table.rows
        if not row.is_privileged and row.rates["success"] == best.rates["success"]
    ]
    if len(tied) > 1:
        names = f"{', '.join(tied[:-1])} and {tied[-1]}"
        return f"{names} succeed in {rate} of {best.episodes:,} episodes each"
    return f"{best.policy} succeeds in {rate} of {best.episodes:,} episodes"


def verdict(table: ComparisonTable) -> str:
    """Return sentences on the best policy, its lead and the significance of differences."""
    sentences = [headline(table), _lead_sentence(table.lead, table.rows[0].episodes)]
    if table.reference not in (None, _DEFAULT_REFERENCE):
        sentences.append(f"Differences are to {table.reference}")
    sentences += _differences(table)
    return " ".join(f"{sentence}." for sentence in sentences if sentence)


def _differences(table: ComparisonTable) -> list[str]:
    """Classify differences to the reference as ties, not significant, and significant."""
    compared = [row for row in table.rows if row.difference is not None]
    tested = [row for row in compared if row.p_holm is not None]
    ties = [row.policy for row in compared if row.difference == 0]
    inconclusive = [row.policy for row in tested if row.difference and row.p_holm >= _SIGNIFICANT]
    test = f"by exact McNemar tests, corrected by Holm for {len(tested)}"
    sentences = [f"Tied with {table.reference}: {', '.join(ties)}"] if ties else []
    if inconclusive:
        sentences.append(
            f"Differences to {table.reference} that are not significant "
            f"(p ≥ {_SIGNIFICANT}) {test}: {', '.join(inconclusive)}"
        )
    elif len(tested) > len(ties):
        every = "Every other" if ties else "Every"
        sentences.append(
            f"{every} difference to {table.reference} is significant (p < {_SIGNIFICANT}) {test}"
        )
    elif len(compared) > len(tested):
        sentences.append(f"There is no test with fewer than {MIN_PAIRS} episodes")
    return sentences


def _lead_sentence(lead: Lead | None, num_episodes: int) -> str:
    """Return the lead of the best over the second best on the same episodes; empty without."""
    if lead is None or lead.is_tie:
        return ""
    low, high = lead.difference_interval
    interval = interval_text(100 * low, 100 * high, "+.1f").strip()
    found = [f"paired 95 % interval {interval}"] if interval else []
    chance = ""
    if lead.p_value is not None:
        p_text = p_value_text(lead.p_value)
        found.append(f"exact McNemar p {p_text if p_text[0] == '<' else f'= {p_text}'}")
        chance = (
            ", which is not significant"
            if lead.p_value >= _SIGNIFICANT
            else ", which is significant"
        )
    results = f" ({', '.join(found)})" if found else ""
    return (
        f"On the same {num_episodes:,} episodes these are {100 * lead.difference:.1f} points more "
        f"than the next approach, {lead.second}{results}{chance}"
    )
