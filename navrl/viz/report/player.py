"""The player's place in the page; without recordings, the commands that make them."""

from __future__ import annotations

import shlex
from html import escape
from pathlib import Path

from navrl.evaluation.stored import Evaluation
from navrl.viz.report.episodes import episode_data
from navrl.viz.report.sources import Sources

_SIMULATORS = {"BatchedSimulator": "batched", "BulletSimulator": "bullet"}  # in conf/simulator


def player_section(sources: Sources) -> str:
    """Return the player; the commands that record episodes if only evaluations are there."""
    if sources.recordings:
        shown, total = len(sources.recordings), sources.num_recordings
        words = f" {shown} of {total} recorded episodes; lost ones first." if shown < total else ""
        player = Path(__file__).with_name("player.html").read_text(encoding="utf-8")
        return player.replace("<!-- left out -->", escape(words))
    if not sources.evaluations or sources.num_recordings:
        return ""
    commands = "\n".join(_commands(sources))
    return (
        '<section id="player"><h2>Episodes</h2>\n'
        "<p>No episode was recorded, so none can be looked at here. These commands play the "
        "episodes again, keep those that were lost, and make this page with a player; another "
        f"policy goes the same way.</p>\n<pre><code>{escape(commands)}</code></pre></section>\n"
    )


def player_episodes(sources: Sources) -> list[dict]:
    """Return the recorded episodes as the player's numbers."""
    rows = [place and place[0].episodes[place[1]] for place in sources.places()]
    return [
        episode_data(name, recording, row)
        for (name, recording), row in zip(sources.recordings, rows, strict=True)
    ]


def _commands(sources: Sources) -> list[str]:
    evaluation = sources.evaluations[0]
    folder = f"outputs/evaluate/recorded_{evaluation.summary['policy']}"
    folders = [*map(str, sources.folders), folder]
    return [
        shlex.join(["navrl-evaluate", *_overrides(evaluation), f"hydra.run.dir={folder}"]),
        shlex.join(["navrl-report", *folders]),
    ]


def _overrides(evaluation: Evaluation) -> list[str]:
    """Return what plays the same episodes; ``suite`` is that of the name, cut to as many."""
    summary = evaluation.summary
    simulator = str(summary["simulator"])
    changes = summary.get("change") or {}
    return [
        f"policy={summary['policy']}",
        f"suite={summary['suite']}",
        f"suite.num_episodes={summary['episodes']}",
        f"simulator={_SIMULATORS.get(simulator, simulator)}",
        *(f"+change.{key}={value}" for key, value in changes.items()),
        "recordings=failures",
    ]
