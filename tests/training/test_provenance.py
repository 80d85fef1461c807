"""A policy's card tells every command that made it."""

import sys

from navrl import __version__
from navrl.factory.training import _card
from navrl.training.provenance import record_command, recorded_commands


def test_the_card_lists_the_commands_in_order(tmp_path, monkeypatch):
    assert recorded_commands(tmp_path) == ""
    assert "not recorded" in _card({}, "")
    for words in (["/x/navrl-train", "seed=3", "a=b c"], ["/x/navrl-train", "resume=run"]):
        monkeypatch.setattr(sys, "argv", words)
        record_command(tmp_path)
    first, second = recorded_commands(tmp_path).splitlines()
    assert first.startswith("navrl-train seed=3 'a=b c'  # ") and __version__ in first
    assert second.startswith("navrl-train resume=run  # ")
    card = _card({"success_rate": 0.5}, recorded_commands(tmp_path))
    assert card.index(first) < card.index(second) and "| success_rate | 0.5 |" in card
