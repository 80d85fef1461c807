"""Scenario cards hold what they promise, whatever is drawn."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from navrl.worlds import CARDS, KINDS, Scenario, ScenarioBatch, SocialCards, pedestrian_boxes

ROBOT_RADIUS = 0.178


def gap(points, boxes):
    """Distance of each point to the nearest axis-aligned box, zero inside."""
    outside = np.abs(points[:, None] - boxes[None, :, :2]) - boxes[None, :, 2:4]
    return np.linalg.norm(outside.clip(min=0), axis=-1).min(axis=1)


def dense(line):
    share = np.linspace(0, 1, 60)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in zip(line, line[1:], strict=False)])


@pytest.mark.parametrize("card", CARDS)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_every_scene_is_sound(card, seed):
    scenario = SocialCards([card]).sample("sound", seed, 0)
    assert scenario.kind == card and card in KINDS
    assert gap(scenario.path, scenario.boxes).min() > ROBOT_RADIUS + 0.02
    assert 5.0 < np.linalg.norm(np.diff(scenario.path, axis=0), axis=1).sum() < 9.5
    walls = scenario.boxes[: len(scenario.boxes) - scenario.num_furniture]
    for person in scenario.pedestrians:
        assert person.is_static or gap(dense(person.route), walls).min() > 0.1
    now = pedestrian_boxes(ScenarioBatch.pack([scenario]), torch.zeros(1))[0]
    start = torch.from_numpy(scenario.start[:2])
    assert (now[:, :2] - start).norm(dim=-1).min() >= 1.1, "nobody begins beside the robot"
    assert Scenario.from_json(scenario.to_json()).to_json() == scenario.to_json()


def nearest_approach(scenario, speed=0.9):
    """Least distance to a person of a robot that drives its path at a steady speed."""
    arc = np.r_[0, np.linalg.norm(np.diff(scenario.path, axis=0), axis=1).cumsum()]
    times = np.arange(0, arc[-1] / speed, 0.1)
    robot = np.stack([np.interp(times * speed, arc, scenario.path[:, k]) for k in (0, 1)], axis=1)
    batch = ScenarioBatch.pack([scenario])[torch.zeros(len(times), dtype=torch.int64)]
    people = pedestrian_boxes(batch, torch.from_numpy(times))[..., :2].numpy()
    return np.linalg.norm(people - robot[:, None], axis=-1).min()


@pytest.mark.parametrize("card", CARDS)
def test_somebody_is_met(card):
    met = [nearest_approach(SocialCards([card]).sample("met", 0, k)) for k in range(20)]
    assert np.median(met) < 0.75, met


def test_cards_come_in_turn_and_each_draw_differs():
    cards = SocialCards()
    drawn = [cards.sample("turn", 0, k) for k in range(16)]
    assert [s.kind for s in drawn] == [*CARDS, *CARDS]
    assert all(a.noise_seed != b.noise_seed for a, b in zip(drawn[:8], drawn[8:], strict=True))


def test_only_the_obstructed_doorway_has_furniture():
    drawn = [SocialCards().sample("furniture", 0, k) for k in range(8)]
    assert {s.kind for s in drawn if s.num_furniture} == {"obstructed_doorway"}
    batch = ScenarioBatch.pack(drawn)
    assert batch.num_furniture.tolist() == [s.num_furniture for s in drawn]
    assert '"num_furniture"' not in drawn[0].to_json()  # older scenarios keep their hash


def test_unknown_cards_are_named():
    with pytest.raises(ValueError, match="waltz"):
        SocialCards(["crossing", "waltz"])
