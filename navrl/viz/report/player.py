"""The player's place in the page; without recordings, the commands that make them."""

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
        sources: What there is.
        folder: Of the evaluation whose episodes the commands record; ``None`` without any.
    """
    if sources.recordings:
        shown, total = len(sources.recordings), sources.num_recordings
        words = f" {shown} of {total} recorded episodes; lost ones first." if shown < total else ""
        player = Path(__file__).with_name("player.html").read_text(encoding="utf-8")
        return player.replace("<!-- left out -->", escape(words))
    if folder is None or sources.num_recordings:
        return ""
    commands = "\n".join(_commands(sources, Path(folder)))
    return (
        '<section id="player"><h2>Episodes</h2>\n'
        "<p>No episode was recorded, so none can be looked at here. These commands play those of "
        f"{escape(Path(folder).name)} again, keep the lost ones, and make this page with a player; "
        f"the other evaluations go the same way.</p>\n"
        f"<pre><code>{escape(commands)}</code></pre></section>\n"
    )


def player_episodes(sources: Sources) -> list[dict]:
    """Return the recorded episodes as the player's numbers."""
    rows = [place and place[0].episodes[place[1]] for place in sources.places()]
    return [
        episode_data(name, recording, row)
        for (name, recording), row in zip(sources.recordings, rows, strict=True)
    ]


def _commands(sources: Sources, folder: Path) -> list[str]:
    """Return what plays the same again, from the configuration that the evaluation left."""
    recorded = str(folder.with_name(f"{folder.name}_recorded"))
    # Hydra would read the = and , of a sweep's folders as its own
    value = recorded if re.fullmatch(r"[\w./-]+", recorded) else f'"{recorded}"'
    play = ["navrl-evaluate", "--config-dir", str(folder), "--config-name", "config"]
    play += ["recordings=failures", f"hydra.run.dir={value}"]
    return [shlex.join(play), shlex.join(["navrl-report", *map(str, sources.folders), recorded])]
