"""What navrl-play and navrl-evaluate keep of an episode is whole, rewards included."""

import pytest

from navrl.config import compose
from navrl.evaluation.recording import Recording
from navrl.jobs import record, run_evaluation

TINY = ["suite=smoke", "num_threads=1", "environment.time_limit_steps=8", "policy=pure_pursuit"]
TERMS = {"collision", "guidance", "proximity", "progress"}


def test_rewards_are_recorded(tmp_path):
    played = record(compose("play", [*TINY, "episode=1"]))
    kept = ["suite.num_episodes=3", "num_worlds=3", "recordings=all", "progress_bar=false"]
    run_evaluation(compose("evaluate", [*TINY, *kept]), tmp_path)
    evaluated = Recording.load(next(tmp_path.glob("recordings/*1.npz")))
    for recording in (played, evaluated):
        assert recording.reward_terms.keys() == TERMS
        assert all(len(term) == recording.num_steps for term in recording.reward_terms.values())
    for name, term in played.reward_terms.items():
        assert evaluated.reward_terms[name] == pytest.approx(term, abs=1e-3)
    assert sum(played.reward_terms["progress"]) > 1.0  # it drove on for a while


def test_additional_rewards_are_recorded_on_request():
    paper = record(compose("play", [*TINY, "reward=paper"]))
    assert paper.reward_terms.keys() == TERMS - {"progress"}
