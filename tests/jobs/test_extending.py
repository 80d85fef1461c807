"""A bundle with the network of another one and further steps of its pipeline."""

import pytest

from navrl.cli.publish import main
from navrl.jobs.publishing import publish_extended
from navrl.policies import ZOO, load_bundle


def test_bundle_has_the_weights_and_the_added_steps(tmp_path):
    folder = publish_extended("paper", tmp_path / "late", ["motion_compensation"], about="Late.")
    bundle, paper = load_bundle(folder), load_bundle(ZOO / "paper")
    steps = bundle.config["transforms"]
    assert steps["motion_compensation"]["_target_"] == "navrl.transforms.MotionCompensation"
    assert steps["min_pool"]["out_keys"][1] == "points_measured"
    assert (
        steps.items()
        >= {k: v for k, v in paper.config["transforms"].items() if k != "min_pool"}.items()
    )
    for name, weight in paper.actor.state_dict().items():
        assert bundle.actor.state_dict()[name].equal(weight)
    card = (folder / "card.md").read_text()
    assert card.startswith("# late\n\nLate. The network of `paper` with the steps motion_comp")
    assert "navrl-train " in card and "Scores" not in card


def test_command_extends_a_bundle_and_names_errors(tmp_path, capsys):
    main(["paper", str(tmp_path / "late"), "--steps", "shield"])
    assert "policy=" in capsys.readouterr().out
    for words, message in (
        (["nothing", str(tmp_path / "x"), "--steps", "shield"], "policy=nothing: must be"),
        (["paper", str(tmp_path / "x"), "--steps", "no_step"], "no_step"),
        (["paper", str(tmp_path / "x"), "--half", "--steps", "shield"], "--half: must not"),
    ):
        with pytest.raises(SystemExit):
            main(words)
        assert message in capsys.readouterr().err
