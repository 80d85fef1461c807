"""Trained policies outside of a simulator: on a robot, in a node, behind another planner."""

from navrl.deploy.runner import PolicyRunner

__all__ = ["PolicyRunner"]
