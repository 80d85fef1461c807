"""Section of the player or, without recordings, of commands that record episodes."""

from __future__ import annotations

import re
import shlex
from html import escape
from pathlib import Path

from navrl.viz.report.episodes import episode_data
from navrl.viz.report.sources import Sources


def player_section(sources: Sources, folder: str | None) -> str:
    """Return the player, or the commands that record episodes.

    Args:
        sources: Files of the report.
        folder: Folder of the evaluation whose episodes the commands record; ``None`` without any.
    """
    if sources.recordings:
        shown, total = len(sources.recordings), sources.num_recordings
        words = f" {shown} of {total} recorded episodes; failed first." if shown < total else ""
        player = Path(__file__).with_name("player.html").read_text(encoding="utf-8")
        return player.replace("<!-- left out -->", escape(words))
    if folder is None or sources.num_recordings:
        return ""
    commands = "\n".join(_commands(sources, Path(folder)))
    return (
        '<section id="player"><h2>Episodes</h2>\n'
        "<p>No episode was recorded. These commands play those of "
        f"{escape(Path(folder).name)} again, record the failed ones, and write this page with a "
        f"player; change the folder for other evaluations.</p>\n"
        f"<pre><code>{escape(commands)}</code></pre></section>\n"
    )


def player_episodes(sources: Sources) -> list[dict]:
    """Return the recorded episodes as data of the player."""
    rows = [place and place[0].episodes[place[1]] for place in sources.places()]
    return [
        episode_data(name, recording, row)
        for (name, recording), row in zip(sources.recordings, rows, strict=True)
    ]


def _commands(sources: Sources, folder: Path) -> list[str]:
    """Return commands that repeat an evaluation with its saved configuration."""
    recorded = str(folder.with_name(f"{folder.name}_recorded"))
    # quoted, since Hydra would parse = and , in a sweep's folders
    value = recorded if re.fullmatch(r"[\w./-]+", recorded) else f'"{recorded}"'
    play = ["navrl-evaluate", "--config-dir", str(folder), "--config-name", "config"]
    play += ["recordings=failures", f"hydra.run.dir={value}"]
    return [shlex.join(play), shlex.join(["navrl-report", *map(str, sources.folders), recorded])]
