"""The page: what was found, in sentences, tables and figures, with all it needs inside it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import navrl
from navrl.evaluation.comparison import ComparisonTable, compare
from navrl.evaluation.stored import Evaluation
from navrl.viz.report.episodes import episode_data
from navrl.viz.report.html_tables import comparison_table, measures_table, seeds_table
from navrl.viz.report.sources import Sources, find_sources

_SIGNIFICANT = 0.05


def write_report(
    folders: Iterable[str | Path],
    file: str | Path,
    reference: str = "paper",
    num_episodes: int = 12,
) -> Path:
    """Gather runs, evaluations and recorded episodes into one HTML page that needs no network.

    Args:
        folders: Everything below them counts.
        file: ``.html``; missing folders are made.
        reference: The policy that the others are compared with.
        num_episodes: Recorded episodes to put in, lost ones first; each takes some 300 kB.

    Returns:
        The file.

    Raises:
        ImportError: If plotly is not installed.
        ValueError: If a folder does not exist or there is nothing to report, or the suffix is not
            ``.html``.
    """
    file = Path(file)
    if file.suffix != ".html":
        raise ValueError(f"file={file}: must end in .html")
    if num_episodes < 0:
        raise ValueError(f"num_episodes={num_episodes}: must be at least 0")
    _need_plotly()
    sources = find_sources(folders, num_episodes)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(_page(sources, reference), encoding="utf-8")
    return file


def _need_plotly() -> None:
    try:
        import plotly  # noqa: F401
    except ImportError as error:
        raise ImportError("a report needs plotly: pip install 'navrl[report]'") from error


def _page(sources: Sources, reference: str) -> str:
    from plotly.offline import get_plotlyjs

    figures = _Figures()
    sections = [*_evaluation_sections(sources.evaluations, reference, figures)]
    sections += [*_training_section(sources.logs, figures), *_player_section(sources)]
    episodes = [episode_data(name, recording) for name, recording in sources.recordings]
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
<script type="application/json" id="episodes">{_embedded(episodes)}</script>
<script>
{_asset("page.js")}</script>
<script>
{_asset("player.js")}</script>
</body>
</html>
"""


class _Figures:
    """Figures by the name of the place they go to."""

    def __init__(self) -> None:
        self.by_name: dict[str, dict] = {}

    def place(self, figure: object, title: str, caption: str = "") -> str:
        """Keep a plotly figure and return the HTML it will appear in; nothing for ``None``."""
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
    evaluations: Sequence[Evaluation], reference: str, figures: _Figures
) -> list[str]:
    from navrl.viz.report import charts

    if not evaluations:
        return []
    sections = [
        _evaluation(table, evaluations, figures) for table in compare(evaluations, reference)
    ]
    chart = figures.place(charts.rates_chart(evaluations), "Over speed and number of pedestrians")
    return [*sections, f"<section><h2>Harder episodes</h2>{chart}</section>\n" if chart else ""]


def _evaluation(
    table: ComparisonTable, evaluations: Sequence[Evaluation], figures: _Figures
) -> str:
    from navrl.viz.report import charts

    places = [
        figures.place(charts.success_chart(table), "Success", "Lines: 95 % Wilson intervals."),
        figures.place(charts.outcome_chart(table, evaluations), "How episodes ended"),
        figures.place(charts.world_chart(table, evaluations), "Success by kind of world"),
        figures.place(
            charts.episode_chart(table, evaluations),
            "Each episode",
            "A column is the same episode for every policy.",
        ),
    ]
    played = max(row.episodes for row in table.rows)
    heading = f"{table.suite} in {table.simulator}, {played:,} episodes ({table.suite_hash[:8]})"
    return (
        f'<section class="evaluation"><h2>{escape(heading)}</h2>\n'
        f'<p class="verdict">{escape(_verdict(table))}</p>\n'
        f"{comparison_table(table)}{seeds_table(table)}{measures_table(table, evaluations)}"
        f"<p>Episodes' hash: <code>{escape(table.suite_hash)}</code></p>\n"
        f"{''.join(places)}</section>\n"
    )


def _verdict(table: ComparisonTable) -> str:
    """Say who is best, by how much, and which differences may be chance."""
    fair = [row for row in table.rows if not row.cheats]
    if not fair:
        return "Every controller here reads the true state: these are ceilings, not rivals."
    best = fair[0]
    low, high = (f"{100 * bound:.1f}" for bound in best.intervals["success"])
    text = (
        f"{best.policy} succeeds in {100 * best.rates['success']:.1f} % [{low}, {high}] "
        f"of {best.episodes:,} episodes"
    )
    if len(fair) > 1:
        ahead = 100 * (best.rates["success"] - fair[1].rates["success"])
        text += f", {ahead:.1f} points more than the next, {fair[1].policy}"
    compared = [row for row in table.rows if row.p_value is not None]
    if not compared:
        return text + "."
    unsure = [row.policy for row in compared if row.p_value >= _SIGNIFICANT]
    chance = (
        f"Every difference to {table.reference} is significant (p < {_SIGNIFICANT})."
        if not unsure
        else f"Differences to {table.reference} that may be chance (p ≥ {_SIGNIFICANT}): "
        f"{', '.join(unsure)}."
    )
    return f"{text}. {chance}"


# --- trainings and episodes ----------------------------------------------------------------------


def _training_section(logs: Sequence[Path], figures: _Figures) -> list[str]:
    from navrl.viz.report import charts

    if not logs:
        return []
    caption = "Runs NAME_seed_K share a colour. Click a name to hide it."
    place = figures.place(charts.curves_chart(logs), "Learning curves", caption)
    return [f"<section><h2>Training</h2>{place}</section>\n"]


def _player_section(sources: Sources) -> list[str]:
    if not sources.recordings:
        return []
    shown, total = len(sources.recordings), sources.num_recordings
    left_out = f" {shown} of {total} recorded episodes; lost ones first." if shown < total else ""
    return [_asset("player.html").replace("<!-- left out -->", escape(left_out))]


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
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _asset(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")
