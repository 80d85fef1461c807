"""Social-navigation scenario cards: one small encounter each, named as the field names them.

A card fixes what a scene is about and draws the rest: sizes, speeds, and who comes when. People
know nothing of the robot, as everywhere here, so a card asks whether the robot gives way, not
whether people find it polite.

Reference:
    Francis et al., "Principles and Guidelines for Evaluating Social Robot Navigation Algorithms",
    2023 (arXiv 2306.16740), scenario cards; Pirk et al., "A Protocol for Validating Social
    Navigation Policies", 2022, for frontal approach, blind corner, doorway and intersection. Sizes
    and speeds are ours.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from navrl.worlds.layout import WALL_THICKNESS, Layout, wall
from navrl.worlds.planner import Grid, plan_path, start_pose
from navrl.worlds.scenario import Pedestrian, Scenario

_HALF = WALL_THICKNESS / 2
_CRUISE = 0.9  # m/s, what a robot is taken to make when people are timed to meet it
_BODY = (0.15, 0.15)  # m, half sizes of a pedestrian


@dataclass(frozen=True)
class Scene:
    """What a card draws.

    Args:
        layout: Walls, then furniture; start and goal.
        people: Those who walk, then those who stand.
        num_furniture: How many of the layout's boxes, the last ones, are furniture.
    """

    layout: Layout
    people: tuple[Pedestrian, ...]
    num_furniture: int = 0


def frontal_approach(generator: np.random.Generator) -> Scene:
    """Draw a hallway of 2.0 to 2.4 m in which somebody comes straight towards the robot."""
    layout = _hallway(generator, generator.uniform(2.0, 2.4))
    y = generator.uniform(-0.15, 0.15)
    ahead = (_end(layout), y)
    return Scene(layout, (_walker([ahead, (-ahead[0], y)], generator.uniform(0.6, 1.0)),))


def overtaking(generator: np.random.Generator) -> Scene:
    """Draw a hallway of 2.0 to 2.4 m in which somebody walks slowly ahead of the robot."""
    layout = _hallway(generator, generator.uniform(2.0, 2.4))
    y = generator.uniform(-0.3, 0.3)
    begin = layout.start[0] + generator.uniform(1.2, 1.8)
    return Scene(
        layout, (_walker([(begin, y), (_end(layout) + 0.2, y)], generator.uniform(0.2, 0.35)),)
    )


def narrow_hallway(generator: np.random.Generator) -> Scene:
    """Draw a hallway of 1.3 to 1.5 m in which somebody comes along one side."""
    width = generator.uniform(1.3, 1.5)
    layout = _hallway(generator, width)
    y = generator.choice([-1.0, 1.0]) * (width / 2 - 0.3)
    ahead = (_end(layout), y)
    return Scene(layout, (_walker([ahead, (-ahead[0], y)], generator.uniform(0.5, 0.8)),))


def crossing(generator: np.random.Generator) -> Scene:
    """Draw a room in which somebody crosses the robot's way at a right angle when it comes by."""
    layout = _room(4.0, 3.0, (-3.3, 0.0), (3.3, 0.0))
    x, side = generator.uniform(-1.0, 1.0), generator.choice([-1.0, 1.0])
    speed = generator.uniform(0.6, 1.0)
    route = np.array([(x, side * 2.6), (x, -side * 2.6)])
    meeting_s = (x - layout.start[0]) / _CRUISE + generator.uniform(-0.6, 0.6)
    return Scene(layout, (_timed(route, speed, 2.6, meeting_s),))


def blind_corner(generator: np.random.Generator) -> Scene:
    """Draw an L of hallways, 1.8 to 2.2 m wide, with somebody unseen behind the corner."""
    half, reach = generator.uniform(1.8, 2.2) / 2, 4.5
    inner, outer, end = half + _HALF, -half - _HALF, reach + _HALF
    boxes = [
        wall(outer, outer, end, outer),
        wall(outer, outer, outer, end),
        wall(inner, inner, end, inner),
        wall(inner, inner, inner, end),
        wall(end, outer, end, inner),
        wall(outer, end, inner, end),
    ]
    start, goal = np.array([reach - 0.7, 0.0]), np.array([0.0, reach - 0.7])
    if generator.random() < 0.5:
        start, goal = goal, start
    speed = generator.uniform(0.5, 0.8)
    aside = generator.uniform(-0.2, 0.2)
    corner = np.array([aside, aside])
    route = np.array([goal + corner * (goal == 0), corner, start + corner * (start == 0)])
    meeting_s = np.abs(start - goal).max() / _CRUISE + generator.uniform(-1.0, 1.0)
    person = _timed(route, speed, float(np.linalg.norm(corner - route[0])), meeting_s)
    layout = Layout(np.array(boxes), (outer, outer, end, end), start, goal)
    return Scene(layout, (person,))


def narrow_doorway(generator: np.random.Generator) -> Scene:
    """Draw a door of 0.9 to 1.0 m through which somebody comes when the robot gets there."""
    door = generator.uniform(0.9, 1.0)
    layout = _two_rooms(generator, door)
    speed = generator.uniform(0.4, 0.7)
    route = np.array([(3.0, generator.uniform(-1.0, 1.0)), (0.6, 0.0), (-0.6, 0.0)])
    route = np.vstack([route, (-3.0, generator.choice([-1.0, 1.0]) * 1.6)])
    to_door = float(np.linalg.norm(np.diff(route[:2], axis=0), axis=1).sum()) + 0.6
    meeting_s = np.linalg.norm(layout.start) / _CRUISE + generator.uniform(-0.5, 1.0)
    return Scene(layout, (_timed(route, speed, to_door, meeting_s),))


def obstructed_doorway(generator: np.random.Generator) -> Scene:
    """Draw a door of 1.6 m, half closed by somebody who stands in it, with a cabinet behind it."""
    layout = _two_rooms(generator, 1.6)
    side = generator.choice([-1.0, 1.0])
    cabinet = [1.5, -side * generator.uniform(0.5, 0.8), 0.25, 0.35, 0.0]
    stands = np.array([[generator.uniform(-0.2, 0.2), side * 0.5]])
    passes = [(2.6, side * 2.3), (2.6, -side * 2.3)]
    people = (
        _walker(passes, generator.uniform(0.3, 0.6), generator.uniform(0.0, 4.0)),
        Pedestrian(stands, 0.0, 0.0, _BODY),
    )
    boxes = np.vstack([layout.boxes, cabinet])
    return Scene(Layout(boxes, layout.extent, layout.start, layout.goal), people, 1)


def circular_crossing(generator: np.random.Generator) -> Scene:
    """Draw a circle of 6 m across: the robot and three to five people all go to the other side."""
    radius, count = 3.0, int(generator.integers(3, 6))
    turn = generator.uniform(-0.25, 0.25, size=count)
    angles = 2 * np.pi * (np.arange(1, count + 1)) / (count + 1) + turn
    people = []
    for angle in angles:
        place = radius * np.array([np.cos(angle), np.sin(angle)])
        aim = -place + generator.uniform(-0.4, 0.4, size=2)
        people.append(_walker([place, aim], generator.uniform(0.5, 0.9)))
    layout = _room(4.0, 4.0, (radius, 0.0), (-radius, 0.0))
    return Scene(layout, tuple(people))


CARDS: dict[str, Callable[[np.random.Generator], Scene]] = {
    card.__name__: card
    for card in (
        frontal_approach,
        overtaking,
        crossing,
        blind_corner,
        narrow_doorway,
        narrow_hallway,
        obstructed_doorway,
        circular_crossing,
    )
}
"""Every card by name, which is the kind of its scenarios."""


class SocialCards:
    """Draw scenarios from cards in turn, each as often as every other.

    Args:
        cards: Names of :data:`CARDS`; all of them if ``None``.

    Raises:
        ValueError: If a name is unknown, or there is none.
    """

    def __init__(self, cards: Sequence[str] | None = None) -> None:
        self.cards = tuple(CARDS if cards is None else cards)
        unknown = sorted(set(self.cards) - CARDS.keys())
        if unknown or not self.cards:
            raise ValueError(f"cards={list(self.cards)}: need some of {list(CARDS)}")

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return scenario ``index``; the same arguments always give the same one."""
        entropy = [seed, zlib.crc32(suite.encode()), index]
        generator = np.random.default_rng(np.random.SeedSequence(entropy))
        kind = self.cards[index % len(self.cards)]
        scene = CARDS[kind](generator)
        layout = scene.layout
        grid = Grid(layout.boxes, layout.extent, layout.start)
        path, _ = plan_path(grid, layout.start, layout.goal)
        return Scenario(
            suite=suite,
            seed=seed,
            index=index,
            kind=kind,
            boxes=layout.boxes,
            start=start_pose(path),
            goal=path[-1].copy(),
            path=path,
            pedestrians=scene.people,
            noise_seed=int(generator.integers(2**32)),
            num_furniture=scene.num_furniture,
        )


def _hallway(generator: np.random.Generator, width: float) -> Layout:
    """Return a straight hallway of 8 to 9 m along x, to be driven from left to right."""
    half_length = generator.uniform(8.0, 9.0) / 2
    x, aside = half_length - 0.7, generator.uniform(-0.1, 0.1)
    return _room(half_length, width / 2, (-x, aside), (x, -aside))


def _end(layout: Layout) -> float:
    """Return the x m at which somebody may turn at a hallway's end."""
    return layout.extent[2] - 0.5


def _room(
    half_x: float, half_y: float, start: tuple[float, float], goal: tuple[float, float]
) -> Layout:
    """Return a closed room; half sizes are clear."""
    x, y = half_x + _HALF, half_y + _HALF
    boxes = [wall(-x, -y, x, -y), wall(-x, y, x, y), wall(-x, -y, -x, y), wall(x, -y, x, y)]
    return Layout(np.array(boxes), (-x, -y, x, y), np.array(start), np.array(goal))


def _two_rooms(generator: np.random.Generator, door: float) -> Layout:
    """Return two rooms side by side with a door at the origin, to be driven from left to right."""
    start = (-3.3, generator.uniform(-1.0, 1.0))
    goal = (3.3, generator.uniform(-1.0, 1.0))
    room = _room(4.0, 3.0, start, goal)
    edge = door / 2 + _HALF
    sides = [wall(0.0, edge, 0.0, 3.0), wall(0.0, -3.0, 0.0, -edge)]
    return Layout(np.vstack([room.boxes, sides]), room.extent, room.start, room.goal)


def _walker(
    route: Sequence[tuple[float, float]] | np.ndarray, speed: float, offset: float = 0.0
) -> Pedestrian:
    return Pedestrian(np.array(route, dtype=float), float(speed), float(offset), _BODY)


def _timed(route: np.ndarray, speed: float, distance: float, meeting_s: float) -> Pedestrian:
    """Return somebody who has walked ``distance`` m of the route ``meeting_s`` s after the start.

    Who is too slow for it begins on the way there, who is too fast on the way back from behind.
    """
    length = float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
    return _walker(route, speed, (distance - speed * meeting_s) % (2 * length))
