"""Evaluation: episodes, their outcomes and statistics."""

from navrl.evaluation.rollout import EpisodeRecord, evaluate

__all__ = ["EpisodeRecord", "evaluate"]
