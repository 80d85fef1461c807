"""Procedural flats and halls, episodes in them, and mixtures of distributions."""

import math

import numpy as np
import pytest

from navrl.config import compose, instantiate
from navrl.worlds import (
    ClearanceMap,
    Flat,
    GeneratedPlaces,
    Hall,
    MixedDistribution,
    ScenarioBatch,
    Suite,
    WeightedDistribution,
)
from navrl.worlds.rooms.furniture import block, chair, plate_on_legs
from navrl.worlds.rooms.placing import Furnisher


def floor_map(place, height=0.5, clearance=0.228):
    """Return the map of what a robot of a height touches."""
    bottom, count = place.heights[:, 0], len(place.boxes)
    touched = bottom < height
    return ClearanceMap(place.boxes[touched[:count]], place.discs[touched[count:]], clearance)


def test_table_is_four_legs_and_a_plate_above_the_robot():
    table = plate_on_legs("table", 0.8, 1.2, 0.74, 0.02)
    assert table.boxes[:4, :2].tolist() == [
        [-0.38, -0.58],
        [-0.38, 0.58],
        [0.38, -0.58],
        [0.38, 0.58],
    ]
    assert table.boxes[4].tolist() == [0.0, 0.0, 0.4, 0.6, 0.0]
    assert table.heights[0].tolist() == [0.0, 0.7]
    assert table.heights[4].tolist() == [0.7, 0.74]
    desk = plate_on_legs("desk", 0.8, 1.2, 0.74, 0.02, is_open=False)
    assert desk.boxes[5].tolist() == [-0.38, 0.0, 0.02, 0.6, 0.0]


def test_chair_has_a_backrest_at_its_rear():
    piece = chair(0.4, 0.45, 0.02).at(1.0, 2.0, math.pi / 2)
    assert piece.boxes[-1] == pytest.approx([1.0, 1.82, 0.02, 0.2, math.pi / 2])
    assert piece.heights[-1].tolist() == [0.45, 0.9]


def test_pieces_do_not_overlap_and_stay_in_their_room():
    floor = Furnisher(np.random.default_rng(0))
    room = np.array([0.0, 0.0, 3.0, 3.0])
    assert floor.put(block("box", 1.0, 1.0, 0.5), 0.5, 0.5, 0.0, room)
    assert not floor.put(block("box", 1.0, 1.0, 0.5), 1.4, 0.5, 0.0, room)
    assert not floor.put(block("box", 1.0, 1.0, 0.5), 2.6, 2.0, 0.0, room)
    assert not floor.put(block("box", 1.0, 1.0, 0.5), 2.4, 2.4, 0.785, room)  # turned, 1.41 m wide
    assert floor.put(block("box", 1.0, 1.0, 0.5), 1.6, 0.5, 0.0, room)
    assert len(floor.place("x").furniture) == 2


@pytest.mark.parametrize("seed", range(12))
def test_empty_flat_is_one_region_through_its_doors(seed):
    place = Flat(density=(0, 0), tables=(0, 0), clutter=(0, 0)).place(
        np.random.default_rng(seed), "flat"
    )
    grid = floor_map(place)
    inside = np.bincount(grid.regions[grid.clearance >= 0.228])
    inside[[0, grid.regions[0, 0]]] = 0
    assert (inside > 0).sum() == 1


def test_doors_have_the_chosen_width():
    flat = Flat(length=(6, 6), width=(4, 4), room_area=13, door=(0.8, 0.8))
    walls = flat.place(np.random.default_rng(1), "flat").walls
    inner = walls[4:6]  # the two parts of the wall that divides the flat
    ends = sorted([inner[0, 1] + inner[0, 3], inner[1, 1] - inner[1, 3]])
    assert len(walls) == 6
    assert ends[1] - ends[0] == pytest.approx(0.8)


def test_furniture_leaves_the_doorways_open(monkeypatch):
    doors, divide = [], Flat._wall_with_door

    def recorded(*arguments):
        doors.append(divide(*arguments))
        return doors[-1]

    monkeypatch.setattr(Flat, "_wall_with_door", recorded)
    for seed in range(10):
        doors.clear()
        flat = Flat(length=(10, 14), density=(2, 2), tables=(2, 2), clutter=(4, 4))
        place = flat.place(np.random.default_rng(seed), "flat")
        assert len(place.furniture) > 20
        assert doors
        assert floor_map(place, height=2.0).distance(np.array(doors)).min() >= 0.36 - 1e-9


def test_hall_has_posts_groups_and_single_pieces():
    hall = Hall(posts=(8, 8), groups=(3, 3), clutter=(9, 9))
    place = hall.place(np.random.default_rng(3), "hall")
    assert len(place.discs) + place.furniture_names.count("post") >= 4
    assert {"box", "chair", "post"} <= set(place.furniture_names)
    assert len(place.walls) == 4


def test_episodes_of_a_place_share_it_and_the_next_has_another():
    places = GeneratedPlaces(Flat(), episodes_per_place=3, num_walkers=(1, 2), body=("box", "legs"))
    episodes = Suite("mine", 3, 8, places).scenarios()
    same = [np.array_equal(a.boxes, episodes[0].boxes) for a in episodes]
    assert same == [True] * 3 + [False] * 5
    assert {len(s.pedestrians) for s in episodes} == {1, 2}
    assert {p.body for s in episodes for p in s.pedestrians} == {"box", "legs"}
    again = GeneratedPlaces(Flat(), episodes_per_place=3, num_walkers=(1, 2), body=("box", "legs"))
    assert again.sample("mine", 3, 7).to_json() == episodes[7].to_json()
    assert again.sample("other", 3, 7).to_json() != episodes[7].to_json()


def test_paths_are_clear_and_walkers_meet_them():
    places = GeneratedPlaces(Hall(), num_walkers=(4, 4), meeting=1.0)
    for index in range(4):
        scenario = places.sample("mine", 0, index)
        place = places.make_place(places.key_of("mine", 0, index))
        assert floor_map(place).distance(scenario.path).min() >= 0.178
        for person in scenario.pedestrians:
            ends = person.route[:, None] - scenario.path[None]
            assert np.linalg.norm(ends, axis=-1).min() < 0.3


def test_stationary_pedestrians_leave_a_passage():
    places = GeneratedPlaces(Hall(), num_standing=(3, 3))
    standing = 0
    for index in range(8):
        scenario = places.sample("mine", 0, index)
        grid = floor_map(places.make_place(places.key_of("mine", 0, index)))
        for person in scenario.pedestrians:
            assert person.is_static
            assert grid.distance(person.route).min() > 0.55
            assert np.linalg.norm(person.route[0] - scenario.goal) >= 1.2
            standing += 1
    assert standing > 12


def test_mixture_has_the_shares_of_its_weights():
    parts = {
        "halls": WeightedDistribution(GeneratedPlaces(Hall(posts=(0, 0))), 3.0),
        "flats": WeightedDistribution(GeneratedPlaces(Flat())),
        "none": None,
    }
    mixture = MixedDistribution(parts)
    kinds = [mixture.sample("mine", 1, index).kind for index in range(60)]
    assert 36 <= kinds.count("hall") <= 54
    assert kinds.count("furnished") == 60 - kinds.count("hall")


def test_varied_training_has_five_kinds_of_worlds_in_equal_parts():
    cfg = compose("train", ["scenario=varied"])
    suite = Suite("mine", 0, 60, instantiate(cfg.scenario))
    kinds = [scenario.kind for scenario in suite.scenarios()]
    counts = {kind: kinds.count(kind) for kind in kinds}
    assert counts.keys() == {"corridor", "intersection", "office", "furnished", "hall"}
    assert min(counts.values()) >= 5
    assert ScenarioBatch.pack(suite.scenarios(range(8))).boxes.shape[1] > 20


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Flat(door=(0.7, 2.2)), r"door=\[0.7, 2.2\]: must be <= 1.9"),
        (lambda: Flat(length=(0, 3)), r"length=\[0, 3\]: must be 0 < low <= high"),
        (lambda: Flat(clutter=(3, 1)), r"clutter=\[3, 1\]: must be 0 <= low <= high"),
        (lambda: Hall(posts=(-1, 1)), r"posts=\[-1, 1\]: must be 0 <= low <= high"),
        (lambda: GeneratedPlaces(Hall(), episodes_per_place=0), "episodes_per_place=0"),
        (lambda: GeneratedPlaces(Hall(), meeting=1.5), r"meeting=1.5: must be in \[0, 1\]"),
        (lambda: GeneratedPlaces(Hall(), num_standing=(2, 1)), r"num_standing=\[2, 1\]"),
        (lambda: GeneratedPlaces(Hall(), body=("box", "robot")), "body='robot'"),
        (lambda: GeneratedPlaces(Hall(), body=()), "body=''"),
        (lambda: MixedDistribution({"a": None}), "weights must be >= 0 and not all 0"),
    ],
)
def test_wrong_values_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
