"""Maps of map_server and Nav2: right cells, refusals by name, paths and places."""

import logging
import math
from types import SimpleNamespace as Message

import numpy as np
import pytest
from map_files import FREE, UNKNOWN, WALL, office, pgm, write_map
from place_files import TRACKS, write

from navrl.untrusted import DamagedFileError
from navrl.worlds import (
    OccupancyMap,
    PlaceDistribution,
    folder_hash,
    load_map,
    load_occupancy_map,
    load_places,
)
from navrl.worlds.planner import NoPathError

SHADES = np.array([[WALL, 89, 90, UNKNOWN], [206, FREE, 255, 100]], np.uint8)


def message(values, cell=0.1, origin=(-1.0, -2.0, 0.0), **changes):
    turn = Message(x=0.0, y=0.0, z=math.sin(origin[2] / 2), w=math.cos(origin[2] / 2))
    place = Message(position=Message(x=origin[0], y=origin[1], z=0.0), orientation=turn)
    width, height = values.shape
    info = {"width": width, "height": height, "resolution": cell, "origin": place}
    return Message(info=Message(**{**info, **changes}), data=values.T.ravel().tolist())


@pytest.mark.parametrize(
    ("changes", "rows"),
    [
        ({}, [[100, 100, -1, -1], [0, 0, 0, -1]]),
        ({"negate": 1}, [[0, -1, -1, 100], [100, 100, 100, -1]]),
        ({"negate": "true"}, [[0, -1, -1, 100], [100, 100, 100, -1]]),
        ({"mode": "scale"}, [[100, 100, 99, 0], [0, 0, 0, 91]]),
        ({"mode": "Raw"}, [[0, 89, 90, -1], [-1, -1, -1, 100]]),
        ({"mode": ...}, [[100, 100, -1, -1], [0, 0, 0, -1]]),
        ({"free_thresh": "19e-2"}, [[100, 100, -1, -1], [-1, 0, 0, -1]]),
    ],
)
def test_modes_and_thresholds_give_the_values_of_map_server(tmp_path, changes, rows):
    found = load_occupancy_map(write_map(tmp_path, SHADES, **changes))
    assert found.values.T[::-1].tolist() == rows


@pytest.mark.parametrize("content", [pgm(SHADES), pgm(SHADES, "P2"), pgm(SHADES, "P5", "# me\n")])
def test_pgm_is_read_as_binary_and_as_text(tmp_path, content):
    found = load_occupancy_map(write_map(tmp_path, content=content))
    assert found.values.shape == (4, 2) and found.values[0].tolist() == [0, 100]


def test_pictures_of_16_bits_and_other_maxima_are_scaled(tmp_path):
    wide = b"P5\n3 1\n65535\n" + np.array([0, 65000, 52685], ">u2").tobytes()
    found = load_occupancy_map(write_map(tmp_path, content=wide))
    assert found.values[:, 0].tolist() == [100, 0, -1]
    found = load_occupancy_map(write_map(tmp_path, content=b"P2 3 1 100  0 99 80"))
    assert found.values[:, 0].tolist() == [100, 0, -1]


def test_png_with_transparency(tmp_path):
    pixels = np.zeros((1, 4, 4), np.uint8)
    pixels[0, :, :3] = np.array([WALL, WALL, FREE, UNKNOWN])[:, None]
    pixels[0, :, 3] = [255, 0, 255, 255]
    scaled = load_occupancy_map(write_map(tmp_path, pixels, image="a.png", mode="scale"))
    assert scaled.values[:, 0].tolist() == [100, -1, 0, 0]
    # map_server averages the opacity into the shade in the mode trinary
    trinary = load_occupancy_map(write_map(tmp_path, pixels, image="a.png"))
    assert trinary.values[:, 0].tolist() == [100, 100, 0, 0]


def test_unknown_shade_that_counts_as_free_is_reported(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        load_occupancy_map(write_map(tmp_path))
        assert not caplog.messages
        load_occupancy_map(write_map(tmp_path, free_thresh=0.25))
    assert "free_thresh=0.25: 44 % of the cells count as free" in caplog.text


BROKEN = [
    ({"image": ...}, "image: is missing"),
    ({"image": "none.png"}, "image='none.png': must be a file that exists"),
    ({"image": "/home/me/office.pgm"}, "image='/home/me/office.pgm': must be in the folder of"),
    ({"image": "../office.pgm"}, "image='../office.pgm': must be in the folder of office.yaml"),
    ({"resolution": 0}, "resolution=0: must be a number in 0.001 to 10"),
    ({"resolution": "abc"}, "resolution='abc': must be"),
    ({"origin": [0, 0]}, "origin=[0, 0]: must be 3 numbers"),
    ({"origin": "[0, 0, nan]"}, "origin=[0, 0, nan]: must be 3 numbers"),
    ({"origin": [0, 0, 90]}, "origin=[0.0, 0.0, 90.0]: yaw=90: must be in rad"),
    ({"negate": 2}, "negate=2: must be 0 or 1"),
    ({"mode": "gray"}, "mode='gray': must be one of trinary, scale, raw"),
    ({"occupied_thresh": 1.5}, "occupied_thresh=1.5: must be a number in 0 to 1"),
    ({"free_thresh": 0.7}, "free_thresh=0.7: must be < occupied_thresh=0.65"),
    ({"free_thresh": ...}, "free_thresh: is missing"),
    ({"content": b"P5\n3 2\n255\nab"}, "office.pgm: damaged picture"),
    ({"content": b"P2 2 1 255 0 300"}, "office.pgm: damaged picture"),
    ({"content": b"GIF89a"}, "office.pgm: must be a picture, one of PGM, PNG, BMP"),
    ({"content": b"P2 20000 1 255 0"}, "office.pgm: size=[20000, 1]: must be at most 10000"),
    ({"content": pgm(np.zeros((2, 2), np.uint8))}, "image='office.pgm': data: must have a free"),
    ({"content": pgm(np.full((2, 2), FREE, np.uint8))}, "image: must have an occupied cell"),
]


@pytest.mark.parametrize(("changes", "text"), BROKEN)
def test_malformed_map_names_file_key_and_value(tmp_path, changes, text):
    image = changes.get("image")
    file = write_map(tmp_path, **{**changes, "image": "office.pgm"})
    if image is not None:
        line = "" if image is ... else f"image: {image}"
        file.write_text(file.read_text().replace("image: office.pgm", line))
    with pytest.raises(DamagedFileError) as error:
        load_map(file)
    assert text in str(error.value) and str(tmp_path) in str(error.value)


def test_yaml_of_something_else_raises(tmp_path):
    write(tmp_path, "params.yaml", "navrl: {policy: paper}")
    with pytest.raises(DamagedFileError, match=r"params.yaml: image: is missing"):
        load_places(tmp_path)


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.0])
def test_walls_and_region_follow_the_pose_of_the_origin(tmp_path, yaw):
    found = load_occupancy_map(write_map(tmp_path, origin=[-1.0, -2.0, yaw]))
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])

    def at(*points):  # from the lower left corner of the picture, m
        return np.array(points) @ turn.T + [-1.0, -2.0]

    grid = found.clearance_map()
    # to the walls of the first room; the unknown side of the second room is an edge too
    distance = grid.distance(at((2.0, 3.0), (3.5, 3.0), (6.9, 3.5)))
    assert distance.tolist() == pytest.approx([1.0, 0.5, 0.2], abs=1e-9)
    assert len(found.walls) < 20 and (found.walls[:, 4] == yaw).all()
    inside = found.region().contains(at((2.0, 3.0), (4.1, 1.7), (4.1, 3.0), (0.5, 0.5), (9, 9)))
    assert inside.tolist() == [True, True, False, False, False]
    path = found.path(at((2.0, 4.0))[0], at((6.0, 4.0))[0])
    assert path[[0, -1]] == pytest.approx(at((2.0, 4.0), (6.0, 4.0)))
    door = (path - [-1.0, -2.0]) @ turn  # back to the picture's frame
    assert door[:, 1].min() < 2.0 and grid.distance(path).min() >= 0.23


def test_message_and_file_give_the_same_map(tmp_path):
    file = load_occupancy_map(write_map(tmp_path, origin=[-1.0, -2.0, 0.3]))
    given = OccupancyMap.from_message(message(file.values, origin=(-1.0, -2.0, 0.3)))
    assert np.array_equal(given.values, file.values)
    assert given.walls == pytest.approx(file.walls)


@pytest.mark.parametrize(
    ("values", "changes", "text"),
    [
        ([[0, 100]], {"width": 3}, "width=3, height=2: must be > 0, and data"),
        ([[0, 100]], {"resolution": 0.0}, "resolution=0.0: must be in 0.001 to 10 m"),
        ([[0, 101]], {}, "data: has 101, each must be -1 or in 0 to 100"),
        ([[0, -2]], {}, "data: has -2"),
        ([[50, 100]], {}, "data: must have a free cell"),
        ([[0, 100]], {"origin": (math.nan, 0.0, 0.0)}, r"origin=\[nan, 0.0, 0.0\]: must be three"),
    ],
)
def test_malformed_message_names_the_field(values, changes, text):
    values = np.array(values)
    place = {"origin": changes.pop("origin")} if "origin" in changes else {}
    with pytest.raises(ValueError, match=text):
        OccupancyMap.from_message(message(values, **place, **changes))


def test_values_of_slam_between_free_and_occupied_are_unknown():
    values = np.array([[0, 25, 26, 64, 65, 100, -1]])
    found = OccupancyMap.from_message(message(values))
    assert found.free[0].tolist() == [True] * 2 + [False] * 5
    assert found.occupied[0].tolist() == [False] * 4 + [True] * 2 + [False]


@pytest.mark.parametrize(
    ("goal", "text"),
    [
        ((3.1, 1.0), r"goal=\[3.10, 1.00\]: must not be in an obstacle"),
        ((-0.7, 1.0), r"goal=\[-0.70, 1.00\]: must not be in an unknown part of the map"),
        ((20.0, 1.0), r"goal=\[20.00, 1.00\]: must be inside the map"),
        ((math.nan, 1.0), r"goal=\[nan, 1.00\]: must be inside the map"),
        ((2.85, 1.0), "must be at least 0.23 m from obstacles and unknown cells, is 0.1"),
    ],
)
def test_unreachable_goal_raises_with_the_reason(tmp_path, goal, text):
    found = load_occupancy_map(write_map(tmp_path))
    with pytest.raises(NoPathError, match=text):
        found.path([1.0, 1.0], goal)


def test_narrow_door_needs_a_smaller_clearance(tmp_path):
    pixels = office()
    pixels[38:44, 40:42] = WALL  # leaves 0.4 m
    found = load_occupancy_map(write_map(tmp_path, pixels))
    with pytest.raises(NoPathError, match=r"must be reachable from \[1.00, 1.00\] with 0.23 m"):
        found.path([1.0, 1.0], [5.0, 1.0])
    assert len(found.path([1.0, 1.0], [5.0, 1.0], clearance=0.12)) > 40


def test_path_of_a_robot_at_a_wall_begins_beside_it(tmp_path):
    found = load_occupancy_map(write_map(tmp_path))
    path = found.path([0.05, 1.0], [1.0, 1.0])  # 5 cm from the wall
    assert path[0] == pytest.approx([0.25, 1.0], abs=0.05)
    with pytest.raises(NoPathError, match="start="):
        found.path([-0.4, 1.0], [1.0, 1.0])


def test_outside_of_a_drawn_building_is_not_its_region(tmp_path):
    drawn = np.where(office() == UNKNOWN, FREE, office()).astype(np.uint8)
    drawn[20:30, 71:74] = WALL
    drawn = np.pad(drawn, ((30, 0), (0, 30)), constant_values=FREE)
    region = load_map(write_map(tmp_path, drawn)).free
    assert region.contains([[1.0, 1.0], [5.0, 1.0], [-0.7, 1.0]]).tolist() == [True, True, False]
    field = np.full((40, 40), FREE, np.uint8)
    field[20, 20] = WALL
    assert load_map(write_map(tmp_path, field)).free.contains([[-0.5, -1.0]]).all()


def test_map_is_a_place_of_a_folder(tmp_path):
    write_map(tmp_path)
    write(tmp_path, "office.csv", TRACKS)
    place = load_places(tmp_path)[0]
    assert place.name == "office" and len(place.people) == 2
    before = folder_hash(tmp_path)
    (tmp_path / "notes.png").write_text("no part of the map")
    assert folder_hash(tmp_path) == before
    write_map(tmp_path, office()[::-1])
    assert folder_hash(tmp_path) != before


def test_episodes_in_a_map_keep_away_from_unknown_cells(tmp_path):
    write_map(tmp_path)
    places = PlaceDistribution(str(tmp_path), distance=(2.0, 8.0))
    found = load_occupancy_map(tmp_path / "office.yaml")
    edges = found.clearance_map(clearance=0.228)
    assert np.array_equal(places.map_of(0).clearance, edges.clearance)
    for index in range(8):
        scenario = places.sample("places", 1, index)
        assert scenario.kind == "office" and np.array_equal(scenario.boxes, found.walls)
        assert edges.distance(scenario.path).min() >= 0.228
        ends = scenario.path[[0, -1]]
        assert found.region().contains(ends).all() and edges.distance(ends).min() >= 0.25
    again = PlaceDistribution(str(tmp_path), distance=(2.0, 8.0)).sample("places", 1, 7)
    assert again.fingerprint() == scenario.fingerprint()
