"""Every policy that is shipped loads, drives and is documented."""

import json

import pytest
from nightly import mostly

from navrl import jobs
from navrl.config import compose
from navrl.policies import ZOO, load_bundle, zoo_names

LIMIT_BYTES = 2_100_000


def test_the_default_policy_is_shipped():
    names = zoo_names()
    for primary in ("evaluate", "play"):
        assert compose(primary).policy in names


@pytest.mark.parametrize("name", zoo_names())
def test_bundle_is_small_and_has_provenance(name):
    assert sum(file.stat().st_size for file in (ZOO / name).iterdir()) < LIMIT_BYTES
    card = (ZOO / name / "card.md").read_text()
    assert "navrl-train " in card and "commit " in card and "table1" in card
    assert 0 < json.loads((ZOO / name / "metrics.json").read_text())["success_rate"] <= 1


def test_the_papers_policy_has_the_papers_architecture():
    actor = load_bundle(ZOO / "paper").actor
    assert sum(weight.numel() for weight in actor.parameters()) == 147_948


@pytest.mark.parametrize("name", mostly(zoo_names(), ["paper"]))
def test_paper_policy_outperforms_pure_pursuit(name, tmp_path):
    changes = [f"policy={name}", "suite.num_episodes=24", "num_worlds=24", "progress_bar=false"]
    summary = jobs.run_evaluation(compose("evaluate", changes), tmp_path)
    assert summary["success_rate"] >= 0.5  # pure pursuit stays below 0.05 on this suite
    assert summary["errors"] == 0
