"""Interface of scenario cards, and episodes from a set of cards."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from navrl.worlds.layout import Layout
from navrl.worlds.pedestrians import simplify
from navrl.worlds.planner import Grid, plan, resample, start_pose
from navrl.worlds.scenario import Pedestrian, Scenario

ROBOT_PACE = (0.7, 1.0)  # m/s, assumed mean speed of the robot up to the encounter


class Card(Protocol):
    """Interface of an encounter; the class attribute ``kind`` names it."""

    kind: str

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw walls, start and goal."""
        ...

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrians to meet on ``path [P, 2]``, moving ones first."""
        ...


class CardSet:
    """Distribution that cycles through the cards, so that all are equally frequent.

    Every other episode of a card is mirrored left to right.

    Args:
        cards: Card by name; ``None`` removes one.
        half_size: Half sides of every pedestrian's cuboid, m.
        body: Body of every pedestrian, see :class:`navrl.worlds.Pedestrian`.

    Raises:
        ValueError: If there is no card, or a size is not positive; when an episode is drawn, if the
            body does not exist or needs two equal sizes.

    Reference:
        Francis et al., "Principles and Guidelines for Evaluating Social Robot Navigation
        Algorithms", 2023: the cards' names and intent. Sizes, speeds and timing are ours, and the
        pedestrians are non-reactive, as in the paper's worlds.
    """

    def __init__(
        self,
        cards: Mapping[str, Card | None],
        half_size: Sequence[float] = (0.15, 0.15),
        body: str = "box",
    ) -> None:
        self.cards = [card for card in cards.values() if card is not None]
        if not self.cards:
            raise ValueError("cards={}: must have at least one")
        if len(half_size) != 2 or not min(half_size) > 0:
            raise ValueError(f"half_size={list(half_size)}: must be two lengths > 0 m")
        self.half_size, self.body = tuple(half_size), body

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return scenario ``index``; the same arguments always give the same one."""
        entropy = [seed, zlib.crc32(suite.encode()), index]
        generator = np.random.default_rng(np.random.SeedSequence(entropy))
        turn, number = divmod(index, len(self.cards))
        card = self.cards[number]
        layout = card.layout(generator)
        path, _ = plan(Grid(layout.boxes, layout.extent, layout.start), layout.start, layout.goal)
        people = card.people(generator, path)
        mirror = np.array([1.0, -1.0 if turn % 2 else 1.0])
        return Scenario(
            suite=suite,
            seed=seed,
            index=index,
            kind=card.kind,
            boxes=layout.boxes * [*mirror, 1.0, 1.0, 1.0],
            start=start_pose(path * mirror),
            goal=path[-1] * mirror,
            path=path * mirror,
            pedestrians=tuple(
                replace(p, route=p.route * mirror, half_size=self.half_size, body=self.body)
                for p in people
            ),
            noise_seed=int(generator.integers(2**32)),
        )


def meeting(
    generator: np.random.Generator, route: np.ndarray, speed: float, path: np.ndarray, at: float
) -> Pedestrian:
    """Return a pedestrian that reaches a point of the path at the same time as the robot.

    Args:
        generator: Draws the assumed speed of the robot.
        route: ``[R, 2]`` m, walked in this direction at the meeting, back and forth otherwise.
        speed: Speed of the pedestrian, m/s.
        path: ``[P, 2]`` m, path of the robot.
        at: Fraction of the path before the meeting point, in [0, 1].
    """
    here = path[round(at * (len(path) - 1))]
    driven = at * _length(path) / generator.uniform(*ROBOT_PACE)
    dense = resample(route, 0.02)
    nearest = int(np.linalg.norm(dense - here, axis=-1).argmin())
    length = _length(route)
    walked = nearest / (len(dense) - 1) * length
    offset = (walked - speed * driven) % (2 * length)
    return Pedestrian(simplify(route), float(speed), float(offset))


def _length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
