"""Results of a benchmark: rows, series and report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from navrl.benchmarks.growth import fit_exponents
from navrl.files import write_json

PUBLISHED = {
    "scan.ratio": 212.0,
    "peers.navground_ratio": 10.8,
    "peers.ir_sim_ratio": 2947.0,
    "step.ratio": 68.5,
}
"""Published medians (docs/benchmark.md) of comparisons with other simulators, by key.

These are ratios of alternating measurements, which depend little on machine and load.
"""


@dataclass(frozen=True)
class Bar:
    """Target value of a row.

    Args:
        limit: Limit in the unit of the row.
        is_lower_bound: Whether the limit is a lower bound; otherwise it is an upper bound.
    """

    limit: float
    is_lower_bound: bool = True

    def is_met_by(self, value: float) -> bool:
        """Return whether ``value`` reaches the bar."""
        return value >= self.limit if self.is_lower_bound else value <= self.limit

    def __str__(self) -> str:
        return f"{'≥' if self.is_lower_bound else '≤'} {number(self.limit)}"


def at_most(limit: float) -> Bar:
    """Return a target with an upper bound."""
    return Bar(limit, is_lower_bound=False)


@dataclass(frozen=True)
class Row:
    """One measured quantity.

    Args:
        key: Unique name, for programs.
        label: Display name.
        unit: Unit of the values.
        values: One value for each repetition.
        bar: Limit of the median, or ``None``.

    Raises:
        ValueError: If there are no values, or one is not finite.
    """

    key: str
    label: str
    unit: str
    values: Sequence[float] | np.ndarray
    bar: Bar | None = None

    def __post_init__(self) -> None:
        values = np.asarray(self.values, dtype=float)
        if values.size == 0 or not np.isfinite(values).all():
            raise ValueError(f"{self.key}={values.tolist()}: must be finite values")

    @property
    def median(self) -> float:
        """Median of the values."""
        return float(np.median(self.values))

    @property
    def spread(self) -> tuple[float, float]:
        """First and third quartile."""
        low, high = np.percentile(self.values, [25, 75])
        return float(low), float(high)

    @property
    def is_met(self) -> bool | None:
        """Return whether the median reaches the bar; ``None`` without a bar."""
        return None if self.bar is None else self.bar.is_met_by(self.median)

    def is_within(self, factor: float) -> bool:
        """Return whether the median is within a factor of the published value, if there is one."""
        published = PUBLISHED.get(self.key)
        return published is None or published / factor <= self.median <= published * factor

    def to_dict(self) -> dict:
        """Return plain data."""
        bar = (
            None
            if self.bar is None
            else {"limit": self.bar.limit, "least": self.bar.is_lower_bound}
        )
        return {
            "key": self.key,
            "label": self.label,
            "unit": self.unit,
            "median": self.median,
            "quartiles": list(self.spread),
            "values": [float(value) for value in self.values],
            "bar": bar,
            "met": self.is_met,
            "published": PUBLISHED.get(self.key),
        }


@dataclass(frozen=True)
class Series:
    """Growth of a cost with a size.

    Args:
        key: Unique machine-readable name.
        label: Description of the cost for tables.
        size: Description of the size for tables.
        unit: Unit of the cost.
        sizes: ``[n]``, at least two different values.
        costs: ``[repeats, n]``, positive.
        bar: Target of the exponent, or ``None``.
    """

    key: str
    label: str
    size: str
    unit: str
    sizes: Sequence[float]
    costs: np.ndarray
    bar: Bar | None = None

    def row(self) -> Row:
        """Return the exponent of growth per repetition: the slope of log cost over log size."""
        exponents = fit_exponents(self.sizes, self.costs)
        return Row(
            f"growth.{self.key}",
            f"growth with {self.size}, {min(self.sizes):,} to {max(self.sizes):,}: exponent",
            "",
            exponents,
            self.bar,
        )

    def to_dict(self) -> dict:
        """Return plain data."""
        return {
            "key": self.key,
            "label": self.label,
            "size": self.size,
            "unit": self.unit,
            "sizes": [int(size) for size in self.sizes],
            "median": np.median(self.costs, axis=0).tolist(),
            "quartiles": np.percentile(self.costs, [25, 75], axis=0).T.tolist(),
        }


@dataclass
class Report:
    """Report of one run of the benchmark.

    Args:
        machine: Description of the computer.
        rows: Rows in the order of the table.
        series: Measured growth of costs with size; each also has a row.
        skipped: Skipped rows with reasons.
        factor: Ratio to the published figure above which a row causes a warning; ``None`` for none.
    """

    machine: dict
    rows: list[Row] = field(default_factory=list)
    series: list[Series] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    factor: float | None = None

    def add(self, *results: Row | Series | str) -> None:
        """Append rows, series (with their rows) and reasons for skipped rows."""
        for result in results:
            if isinstance(result, str):
                self.skipped.append(result)
                continue
            if isinstance(result, Series):
                self.series.append(result)
                result = result.row()
            if any(result.key == row.key for row in self.rows):
                raise ValueError(f"key={result.key!r}: must be unique, a row has it already")
            self.rows.append(result)

    def to_dict(self) -> dict:
        """Return plain data."""
        return {
            "machine": self.machine,
            "rows": [row.to_dict() for row in self.rows],
            "series": [series.to_dict() for series in self.series],
            "skipped": self.skipped,
        }

    def save(self, file: Path) -> None:
        """Write the report as JSON."""
        write_json(file, self.to_dict(), indent=2, ensure_ascii=False)

    def table(self) -> str:
        """Return the rows as an aligned Markdown table, with the machine above."""
        head = ("what", "median", "middle half", "unit", "bar", "met")
        lines = [
            (
                row.label,
                number(row.median),
                " … ".join(number(value) for value in row.spread),
                row.unit,
                "" if row.bar is None else str(row.bar),
                {None: "", True: "yes", False: "NO"}[row.is_met],
            )
            for row in self.rows
        ]
        width = [max(len(line[i]) for line in (head, *lines)) for i in range(len(head))]
        rule = tuple("-" * w for w in width)
        text = ["| " + " | ".join(_cells(line, width)) + " |" for line in (head, rule, *lines)]
        machine = "; ".join(f"{name} {value}" for name, value in self.machine.items())
        skipped = (f"left out: {why}" for why in self.skipped)
        return "\n".join([machine, "", *text, *skipped, *self.warnings()])

    def warnings(self) -> list[str]:
        """Return a line for each row that is far from its published value."""
        if self.factor is None:
            return []
        return [
            f"warning: {row.key}={number(row.median)} {row.unit}: more than {self.factor:g} times "
            f"from the published {number(PUBLISHED[row.key])} {row.unit} (docs/benchmark.md); "
            "is the same work measured?"
            for row in self.rows
            if not row.is_within(self.factor)
        ]


def _cells(line: Sequence[str], width: Sequence[int]) -> list[str]:
    """Pad cells: numbers right-aligned, words left-aligned."""
    return [
        cell.rjust(w) if i in (1, 2) else cell.ljust(w)
        for i, (cell, w) in enumerate(zip(line, width, strict=True))
    ]


def number(value: float) -> str:
    """Format a value with three significant digits, or all digits of the integer part."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
