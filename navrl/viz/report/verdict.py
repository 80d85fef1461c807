"""Who is best, by how much, and whether that may be chance: the sentences of the page."""

from __future__ import annotations

from collections.abc import Sequence

from navrl.evaluation.comparison import ComparisonTable, compare
from navrl.evaluation.pairing import success_difference
from navrl.evaluation.stored import Evaluation

_SIGNIFICANT = 0.05


def compared(evaluations: Sequence[Evaluation], reference: str) -> list[ComparisonTable]:
    """Compare evaluations with ``reference``, or where there is none with the best that is fair.

    Args:
        evaluations: At least one.
        reference: Name of a policy; see :func:`navrl.evaluation.compare`.
    """
    tables = compare(evaluations, reference)
    for i, table in enumerate(tables):
        fair = [row.policy for row in table.rows if not row.cheats]
        if table.reference is None and fair and len(table.rows) > 1:
            (tables[i],) = compare(members(table, evaluations, in_order=False), fair[0])
    return tables


def members(
    table: ComparisonTable, evaluations: Sequence[Evaluation], in_order: bool = True
) -> list[Evaluation]:
    """Return the evaluations of a table, in the order of its rows or else as they came."""
    by_folder = {str(e.folder): e for e in evaluations}
    folders = [row.folder for row in table.rows]
    if in_order:
        return [by_folder[folder] for folder in folders]
    return [e for folder, e in by_folder.items() if folder in folders]


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


def verdict(table: ComparisonTable, evaluations: Sequence[Evaluation], asked: str) -> str:
    """Say who is best, test it against the next, and name what may differ by chance.

    Args:
        table: Of one suite.
        evaluations: Those of the table, at least.
        asked: The reference that was asked for; said if it is not there.
    """
    sentences = [headline(table), _ahead_of_next(table, evaluations)]
    if table.reference and table.reference != asked:
        sentences.append(
            f"No evaluation here is called {asked}: differences are to {table.reference}, "
            "the best that does not cheat"
        )
    tested = [row for row in table.rows if row.p_value is not None]
    unsure = [row.policy for row in tested if row.p_value >= _SIGNIFICANT]
    if unsure:
        sentences.append(
            f"Differences to {table.reference} that may be chance (p ≥ {_SIGNIFICANT}): "
            f"{', '.join(unsure)}"
        )
    elif tested:
        sentences.append(
            f"Every difference to {table.reference} is significant (p < {_SIGNIFICANT})"
        )
    return " ".join(f"{sentence}." for sentence in sentences if sentence)


def p_value_text(value: float) -> str:
    """Return ``< 0.001`` or three decimals."""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _ahead_of_next(table: ComparisonTable, evaluations: Sequence[Evaluation]) -> str:
    """Test the best against the next on the same episodes; nothing without a next one."""
    rows = zip(table.rows, members(table, evaluations), strict=True)
    fair = [(row.policy, evaluation) for row, evaluation in rows if not row.cheats]
    if len(fair) < 2:
        return ""
    (_, best), (name, second) = fair[:2]
    (value, low, high, _, pairs), p_value = success_difference(best, second)
    chance = "may be chance" if p_value >= _SIGNIFICANT else "is hardly chance"
    p_text = p_value_text(p_value)
    p_text = f"p {p_text}" if p_text.startswith("<") else f"p = {p_text}"
    return (
        f"On the same {pairs:,} episodes these are {100 * value:.1f} points more than the next, "
        f"{name} (paired 95 % interval [{100 * low:+.1f}, {100 * high:+.1f}], exact McNemar "
        f"{p_text}), which {chance}"
    )
