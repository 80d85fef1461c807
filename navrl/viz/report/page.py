"""HTML page of the report with text, tables, figures and all assets."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import navrl
from navrl.evaluation.comparison import ComparisonTable, compare
from navrl.extras import install_hint
from navrl.files import write_text
from navrl.viz.report.html_tables import (
    comparison_table,
    episodes_table,
    measures_table,
    seeds_table,
)
from navrl.viz.report.player import player_episodes, player_section
from navrl.viz.report.sources import Sources, find_sources
from navrl.viz.report.verdict import headline, verdict

_NUM_EXPANDED = 3  # evaluations shown initially; the others are collapsed


def write_report(
    folders: Iterable[str | Path],
    file: str | Path,
    reference: str | None = None,
    num_episodes: int = 12,
) -> Path:
    """Write runs, evaluations and recorded episodes as one self-contained HTML page.

    Args:
        folders: Folders, searched recursively.
        file: ``.html``; missing folders are created.
        reference: The policy that the others are compared with; if ``None``, ``paper`` or, without
            it, the best that is not privileged.
        num_episodes: Maximum number of recorded episodes, failed ones first; each takes about 300
            kB.

    Returns:
        The file.

    Raises:
        ImportError: If plotly is not installed.
        ValueError: If a folder does not exist or has no results, or the suffix is not ``.html``.
    """
    file = Path(file)
    if file.suffix != ".html":
        raise ValueError(f"file={file}: must end in .html")
    if num_episodes < 0:
        raise ValueError(f"num_episodes={num_episodes}: must be at least 0")
    _need_plotly()
    sources = find_sources(folders, num_episodes)
    if reference is not None and not sources.evaluations:
        raise ValueError(f"reference={reference}: no effect, there is no evaluation")
    return write_text(file, _page(sources, reference))


def _need_plotly() -> None:
    try:
        import plotly  # noqa: F401
    except ImportError as error:
        raise ImportError(f"a report needs plotly; {install_hint('report')}") from error


def _page(sources: Sources, reference: str | None) -> str:
    from plotly.offline import get_plotlyjs

    figures = _Figures()
    tables = compare(sources.evaluations, reference) if sources.evaluations else []
    sections = [*_evaluation_sections(tables, sources, figures)]
    sections += _training_section(sources.logs, figures)
    sections.append(player_section(sources, _to_record(tables)))
    title = f"navrl: {', '.join(folder.resolve().name for folder in sources.folders)}"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>
{_asset("page.css")}</style>
<script>{get_plotlyjs()}</script>
</head>
<body>
<header>
<h1>{escape(title)}</h1>
<p>{escape(_contents(sources))} Made by navrl {escape(navrl.__version__)}.</p>
</header>
<main>
{_contents_list(sections)}{"".join(sections)}</main>
<script type="application/json" id="figures">{_embedded(figures.by_name)}</script>
<script type="application/json" id="episodes">{_embedded(player_episodes(sources))}</script>
<script>
{_asset("page.js")}</script>
<script>
{_asset("drawing.js")}</script>
<script>
{_asset("player.js")}</script>
</body>
</html>
"""


class _Figures:
    """Figures by name of their HTML element."""

    def __init__(self) -> None:
        self.by_name: dict[str, dict] = {}

    def place(self, figure: object, title: str, caption: str = "") -> str:
        """Store a plotly figure and return its HTML element; empty for ``None``."""
        if figure is None:
            return ""
        name = f"figure-{len(self.by_name)}"
        self.by_name[name] = json.loads(figure.to_json())
        height = self.by_name[name]["layout"]["height"]
        note = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
        place = f'<div id="{name}" class="plot" style="height:{height}px"></div>'
        return f"<figure><h3>{escape(title)}</h3>{place}{note}</figure>\n"


# --- evaluations ---------------------------------------------------------------------------------


def _evaluation_sections(
    tables: Sequence[ComparisonTable], sources: Sources, figures: _Figures
) -> list[str]:
    from navrl.viz.report import charts

    if not tables:
        return []
    sections = []
    for i, table in enumerate(tables):
        played = max(row.episodes for row in table.rows)
        name = f"{table.title} in {table.simulator}, {played:,} episodes ({table.suite_hash[:8]})"
        heading = f"<h2>{escape(name)}</h2>"
        content = _evaluation(table, sources, figures)
        if i >= _NUM_EXPANDED:
            summary = f"{heading}<p>{escape(headline(table))}.</p>"
            heading, content = "", f"<details><summary>{summary}</summary>\n{content}</details>\n"
        sections.append(f'<section class="evaluation">{heading}\n{content}</section>\n')
    chart = figures.place(
        charts.rates_chart(sources.evaluations), "Over speed and number of pedestrians"
    )
    return [*sections, f"<section><h2>Harder episodes</h2>{chart}</section>\n" if chart else ""]


def _evaluation(table: ComparisonTable, sources: Sources, figures: _Figures) -> str:
    """Return the content below the heading of a suite."""
    from navrl.viz.report import charts

    evaluations = sources.evaluations
    players = _players(sources)
    episodes = episodes_table(table, evaluations, players)
    click = " A click on a recorded one opens it in the player." if episodes else ""
    places = [
        figures.place(charts.success_chart(table), "Success", "Lines: 95 % Wilson intervals."),
        figures.place(charts.outcome_chart(table, evaluations), "How episodes ended"),
        figures.place(charts.world_chart(table, evaluations), "Success by kind of world"),
        figures.place(
            charts.episode_chart(table, evaluations, players),
            "Each episode",
            f"A column is the same episode for every policy.{click}",
        ),
    ]
    return (
        f'<p class="verdict">{escape(verdict(table))}</p>\n'
        f"{comparison_table(table)}{seeds_table(table)}{measures_table(table)}"
        f"<p>Episodes' hash: <code>{escape(table.suite_hash)}</code></p>\n"
        f"{''.join(places)}{episodes}"
    )


def _to_record(tables: Sequence[ComparisonTable]) -> str | None:
    """Return the folder of the first table's reference, or of its best."""
    if not tables:
        return None
    rows = tables[0].rows
    return next((row for row in rows if row.policy == tables[0].reference), rows[0]).folder


def _players(sources: Sources) -> dict[tuple[str, int], int]:
    """Return the index in the player of each recorded episode of an evaluation."""
    places = enumerate(sources.places())
    return {(str(place[0].folder), place[1]): i for i, place in places if place is not None}


# --- trainings and episodes ----------------------------------------------------------------------


def _training_section(logs: Sequence[Path], figures: _Figures) -> list[str]:
    from navrl.viz.report import charts

    if not logs:
        return []
    caption = "Runs NAME_seed_K share a color. Click a name to hide it."
    place = figures.place(charts.curves_chart(logs), "Learning curves", caption)
    return [f"<section><h2>Training</h2>{place}</section>\n"]


def _contents(sources: Sources) -> str:
    counts = {
        "evaluation": len(sources.evaluations),
        "training": len(sources.logs),
        "recorded episode": sources.num_recordings,
    }
    parts = [f"{n} {what}{'s' * (n != 1)}" for what, n in counts.items() if n]
    return f"From {', '.join(map(str, sources.folders))}: {', '.join(parts)}."


def _contents_list(sections: list[str]) -> str:
    """Number the sections and return links to them."""
    links = []
    for i, section in enumerate(sections):
        heading = re.search(r"<h2>(.*?)</h2>", section)
        if heading is not None:
            sections[i] = section.replace("<h2>", f'<h2 id="section-{i}">', 1)
            links.append(f'<li><a href="#section-{i}">{heading[1]}</a></li>')
    return f"<nav><ul>{''.join(links)}</ul></nav>\n" if len(links) > 1 else ""


def _embedded(value: object) -> str:
    """Return JSON that is safe inside a script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")
