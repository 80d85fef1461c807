"""Places from files: right values, refusals by name, paths, the same episodes each time."""

import copy
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from place_files import BARN, HALL, TRACKS, barn_world, place_folder, write

from navrl.config import compose
from navrl.jobs.suite_data import missing_data
from navrl.untrusted import DamagedFileError
from navrl.worlds import (
    PlaceDistribution,
    Scenario,
    ScenarioBatch,
    Suite,
    folder_hash,
    load_barn,
    load_places,
    load_scene,
    load_tracks,
)
from navrl.worlds.places.floor import make_floor
from navrl.worlds.places.tracks import window

SHARED = Path(__file__).parents[3] / "shared" / "data"


def shared(name):
    """Return a folder of real data; skip the test without it."""
    folder = SHARED / name
    if not folder.exists():
        folder = Path(__file__).parents[2].parent.parent / "shared" / "data" / name
    if not folder.exists():
        pytest.skip(f"needs {name} of the development data, ../shared/data")
    return folder


def test_scene_has_walls_segments_furniture_and_free_region(tmp_path):
    place = load_scene(write(tmp_path, "hall.json", HALL))
    assert place.walls[0].tolist() == [4.0, 0.05, 4.0, 0.05, 0.0]
    assert place.walls[4].tolist() == pytest.approx([4.0, 1.5, 1.55, 0.05, math.pi / 2])
    assert place.furniture_names == ("Table", "Table")
    assert place.heights[-2:].tolist() == [[0.7, 0.74], [0.0, 0.7]]
    assert place.free.contains([[1.0, 1.0], [4.0, 1.0], [9.0, 1.0]]).tolist() == [
        True,
        False,
        False,
    ]
    area = place.free.mask.sum() * place.free.cell**2
    assert area == pytest.approx(7.2 * 5.2 - 1.0 * 3.1, rel=0.03)


def test_bit_grid_is_the_free_region(tmp_path):
    grid = {"origin": [1.0, 2.0], "cell": 0.5, "shape": [2, 3], "bits": "a4"}  # 101 001
    scene = {key: value for key, value in HALL.items() if key != "free"}
    place = load_scene(write(tmp_path, "hall.json", {**scene, "reachable_r025": grid}))
    assert place.free.mask.T.tolist() == [[True, False, True], [False, False, True]]
    assert place.free.contains([[2.1, 2.6], [1.1, 2.6]]).tolist() == [True, False]


BROKEN = [
    (("format",), "navrl-scene-9", "format='navrl-scene-9'"),
    (("id",), "", "id=''"),
    (("wall_height",), -1, "wall_height=-1"),
    (("walls",), "no", "walls='no'"),
    (("walls", 1), [0, 6, 8, 5.9], "walls[1]=[0.0, 6.0, 8.0, 5.9]"),
    (("walls", 1), [0, 5, 8], "walls[1]=[0, 5, 8]"),
    (("walls", 0), [0, 0, 8, float("nan")], "walls[0]="),
    (("wall_segments", 0), [0, 0, 1, True], "wall_segments[0]="),
    (("furniture", 0), 3, "furniture[0]=3"),
    (("furniture", 1, "box"), [1, 1, 0, 1, 0], "furniture[1].box="),
    (("furniture", 1, "z"), [1, 0], "furniture[1].z=[1.0, 0.0]"),
    (("furniture", 1, "c"), 7, "furniture[1].c=7"),
    (("free", "outer"), [[0, 0], [1, 1]], "free.outer="),
    (("free", "holes"), [[[0, 0], [1, 1], ["a", 2]]], "free.holes[0][2]="),
]


@pytest.mark.parametrize(("keys", "value", "message"), BROKEN)
def test_malformed_scene_names_key_and_value(tmp_path, keys, value, message):
    scene = copy.deepcopy(HALL)
    part = scene
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = value
    with pytest.raises(DamagedFileError) as error:
        load_scene(write(tmp_path, "hall.json", scene))
    assert str(tmp_path / "hall.json") in str(error.value)
    assert message in str(error.value)
    assert "must be" in str(error.value)


def test_missing_key_of_a_scene_is_named(tmp_path):
    scene = {key: value for key, value in HALL.items() if key != "wall_height"}
    with pytest.raises(DamagedFileError, match="wall_height: is missing"):
        load_scene(write(tmp_path, "hall.json", scene))


def test_barn_world_has_cylinders_at_their_cells(tmp_path):
    worlds = {**BARN, "occ": [barn_world([(0, 0), (29, 63)]), barn_world([(3, 5)])]}
    first, second = load_barn(write(tmp_path, "barn.json", worlds))
    wanted = [[-0.075, 0.075, 0.075], [-4.425, 9.525, 0.075]]
    np.testing.assert_allclose(first.discs, wanted)
    assert (second.name, second.goal.tolist()) == ("barn_001", [-2.25, 8.0])


def test_malformed_barn_world_raises(tmp_path):
    for key, value in (("occ", ["zz"]), ("occ", []), ("pitch", 0), ("shape", [30]), ("goal", 1)):
        worlds = {**BARN, "occ": [barn_world([(1, 1)])], key: value}
        with pytest.raises(DamagedFileError, match=rf"barn\.json: {key}.*must be"):
            load_barn(write(tmp_path, "barn.json", worlds))
    with pytest.raises(ValueError, match="index=4: must be in 0 to 0"):
        load_barn(write(tmp_path, "ok.json", {**BARN, "occ": [barn_world([(1, 1)])]}), [4])


def test_tracks_are_sorted_by_id_and_time(tmp_path):
    first, second = load_tracks(write(tmp_path, "people.csv", TRACKS), body="disc")
    assert (first.route[0].tolist(), second.route[0].tolist()) == ([1.0, 2.0], [1.0, 4.0])
    assert first.speed == pytest.approx(0.8)
    part = window((first, second), 2.2, 1.0)
    assert part[0].times[0] == pytest.approx(-0.2)  # one sample before and one after
    assert part[0].times[-1] >= 1.0
    assert window((first, second), 50.0, 1.0) == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "line 1: header='a,b'"),
        ("t,id,x,y\n0,1,2\n", "line 2: row='0,1,2'"),
        ("t,id,x,y\n0,1,2,no\n", "line 2: y='no'"),
        ("t,id,x,y\n0,1.5,2,3\n", "line 2: id=1.5"),
        ("t,id,x,y\n0,1,2,nan\n", "line 2: y='nan'"),
        ("t,id,x,y\n0,1,2,3\n0,1,4,3\n", "id=1: must have one row at t=0"),
        ("t,id,x,y\n0,1,2,3\n0.1,1,9,3\n", "id=1: walks 70.0 m/s at t=0"),
        ("t,id,x,y\n0,1,2,3\n", "no pedestrian with two rows"),
    ],
)
def test_malformed_tracks_name_line_and_value(tmp_path, text, message):
    with pytest.raises(DamagedFileError) as error:
        load_tracks(write(tmp_path, "people.csv", text))
    assert message in str(error.value)
    assert "people.csv" in str(error.value)


def test_folder_with_lone_tracks_or_repeated_ids_raises(tmp_path):
    write(tmp_path, "hall.json", HALL)
    write(tmp_path, "other.csv", TRACKS)
    with pytest.raises(DamagedFileError, match=r"must lie beside a place other\.json"):
        load_places(tmp_path)
    (tmp_path / "other.csv").unlink()
    write(tmp_path, "second.json", HALL)
    with pytest.raises(DamagedFileError, match="id=hall: must be unique"):
        load_places(tmp_path)
    with pytest.raises(FileNotFoundError, match="no such folder"):
        load_places(tmp_path / "absent")


def test_hash_of_a_folder_changes_with_its_files(tmp_path):
    first = folder_hash(place_folder(tmp_path))
    assert folder_hash(tmp_path) == first
    write(tmp_path, "hall.csv", TRACKS + "9.0,1,6.0,2.0\n")
    assert folder_hash(tmp_path) != first
    with pytest.raises(ValueError, match="sha256=0: the files of"):
        PlaceDistribution(str(tmp_path), sha256="0")


def test_episodes_of_places_are_reproducible_and_clear(tmp_path):
    folder = str(place_folder(tmp_path))
    options = {"num_walkers": (1, 2), "distance": (2.0, 8.0)}
    suites = [Suite("mine", 3, 9, PlaceDistribution(folder, **options)) for _ in range(2)]
    first, second = (suite.scenarios() for suite in suites)
    assert [s.to_json() for s in first] == [s.to_json() for s in second]
    assert [s.kind for s in first[:4]] == ["barn_000", "barn_001", "hall", "barn_000"]
    grids = [suites[0].distribution.map_of(k) for k in range(3)]
    for index, scenario in enumerate(first):
        distance = grids[index % 3].distance(scenario.path)
        assert distance.min() >= 0.178
        assert Scenario.from_json(scenario.to_json()).to_json() == scenario.to_json()
    hall = first[2]
    assert '"format":"navrl-scenario-2"' in hall.to_json()
    assert {person.body for person in hall.pedestrians} == {"legs"}
    batch = ScenarioBatch.pack(first)
    assert batch.kind_of(2) == "hall"
    assert int(batch.num_furniture[2]) == 2
    assert not bool(batch.box_is_disc[2].any())
    assert int(batch.box_is_disc[0].sum()) == 2


def test_starts_and_goals_have_the_goal_clearance(tmp_path):
    places = PlaceDistribution(str(place_folder(tmp_path)), goal_clearance=0.5)
    for index in range(2, 26, 3):  # in the hall, which has no start of its own
        scenario = places.sample("mine", 3, index)
        ends = np.stack([scenario.start[:2], scenario.goal])
        assert places.map_of(2).distance(ends).min() >= 0.5 - 1e-6


def test_routes_of_walkers_keep_their_own_clearance(tmp_path):
    """The robot fits through gaps and under tables where a pedestrian does not."""
    gap = [[4.9, 0.1, 5.1, 2.75], [4.9, 3.25, 5.1, 5.9]]  # 0.5 m
    table = {"c": "Table", "box": [2.5, 3.0, 0.6, 1.5, 0.3], "z": [0.72, 0.75]}
    scene = {**HALL, "walls": HALL["walls"] + gap, "furniture": [table]}
    write(tmp_path, "hall.json", {k: scene[k] for k in scene.keys() - {"free", "wall_segments"}})
    grid = None
    for clearance in (None, 0.34):
        options = {"num_walkers": (2, 2), "distance": (1.0, 15.0), "walker_clearance": clearance}
        places = PlaceDistribution(str(tmp_path), **options)
        grid = (
            grid
            or make_floor(
                places.places[0], height=1.8, clearance=0.3, comfort=0.6, cell_clearance=0.3
            ).grid
        )
        people = [p for index in range(12) for p in places.sample("mine", 0, index).pedestrians]
        routes = [np.linspace(a, b, 50) for p in people for a, b in pairwise(p.route)]
        least = grid.distance(np.concatenate(routes)).min()
        assert least < 0.05 if clearance is None else least > 0.34 - 0.04, least  # cells of 5 cm
    with pytest.raises(ValueError, match=r"walker_clearance=0\.0: must be"):
        PlaceDistribution(str(tmp_path), walker_clearance=0.0)
    narrow = PlaceDistribution(str(tmp_path), num_walkers=(1, 1), walker_clearance=3.5, comfort=1)
    with pytest.raises(ValueError, match=r"in place hall .*: walker_clearance=3\.5: no route of a"):
        narrow.sample("mine", 0, 0)


def test_goal_clearance_beyond_the_map_is_rejected(tmp_path):
    folder = str(place_folder(tmp_path))
    with pytest.raises(ValueError, match=r"goal_clearance=0\.7: must be <= comfort=0\.6"):
        PlaceDistribution(folder, goal_clearance=0.7)


def test_episodes_do_not_depend_on_the_number_of_processes(tmp_path):
    suite = Suite("mine", 3, 33, PlaceDistribution(str(place_folder(tmp_path))))
    assert suite.hash(suite.scenarios(num_workers=2)) == suite.hash()


def test_touchable_obstacles_leave_out_table_tops(tmp_path):
    place_folder(tmp_path)
    scenario = PlaceDistribution(str(tmp_path)).sample("x", 1, 2)
    batch = ScenarioBatch.pack([scenario]).touchable(0.5)
    assert int(batch.num_boxes) == len(scenario.boxes) - 1
    assert int(batch.num_furniture) == 1
    assert batch.boxes[0, int(batch.num_boxes) - 1].tolist() == scenario.boxes[-1].tolist()


def test_real_homes_are_read_and_planned_in():
    folder = shared("scenes/homes_dev")
    distribution = PlaceDistribution(str(folder))
    assert len(distribution.places) == 8
    for index, place in enumerate(distribution.places):
        scenario = distribution.sample("homes", 1, index)
        assert scenario.kind == place.name
        assert place.free.contains(scenario.path).mean() > 0.9


def test_real_recording_and_barn_are_read():
    people = load_tracks(shared("crowds") / "ucy_zara01.csv", smooth=True)
    assert len(people) == 148
    assert max(person.speed for person in people) < 3.0
    assert len(load_barn(shared("barn") / "barn300.json")) == 300


def test_file_as_the_folder_of_places_is_named(tmp_path):
    file = tmp_path / "office.yaml"
    file.write_text("image: office.pgm")
    cfg = compose("evaluate", ["suite=places", f"data={file}"])
    with pytest.raises(ValueError, match=r"data=.*office.yaml: must be a folder of files"):
        missing_data(cfg)
    with pytest.raises(FileNotFoundError, match=r"must be a folder, is a file"):
        load_places(file)
