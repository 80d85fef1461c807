"""A scene of iGibson, made by hand: furniture of the URDF, walls of the map."""

import math

import numpy as np
import pytest
from PIL import Image

from navrl.untrusted import DamagedFileError
from navrl.worlds import ClearanceMap, PlaceDistribution, load_igibson
from navrl.worlds.places.cells import boxes_of_cells

URDF = """<robot name="igsdf">
  <link name="world"/>
  <link bounding_box="1.2 0.8 0.5" category="bed" model="a" name="bed_3" room="bedroom_0"/>
  <link bounding_box="0.9 0.1 2.0" category="door" model="b" name="door_4"/>
  <link category="walls" model="Mini" name="walls"/>
  <joint name="j_bed_3" type="floating">
    <parent link="world"/><child link="bed_3"/>
    <origin rpy="0 0 1.5707963" xyz="1.0 -0.5 0.25"/>
  </joint>
</robot>"""


def mini(folder, urdf=URDF):
    """Write a room of 6 m by 4 m around the origin, in a map of 8 m by 8 m."""
    scene = folder / "Mini_0_int"
    for name in ("urdf", "layout"):
        (scene / name).mkdir(parents=True)
    (scene / "urdf" / "Mini_0_int_best.urdf").write_text(urdf)
    pixels = np.zeros((800, 800), np.uint8)
    pixels[200:600, 100:700] = 255  # rows are y, columns are x
    Image.fromarray(pixels).save(scene / "layout" / "floor_trav_no_obj_0.png")
    return scene


def test_furniture_and_walls_have_their_places(tmp_path):
    place = load_igibson(mini(tmp_path))
    assert place.furniture[0].tolist() == pytest.approx([1.0, -0.5, 0.6, 0.4, math.pi / 2])
    assert place.furniture_heights.tolist() == [[0.0, 0.5]]
    assert place.furniture_names == ("bed",)  # the door is open
    assert place.free.contains([[2.9, 1.9], [2.9, 2.1], [3.1, 0.0]]).tolist() == [
        True,
        False,
        False,
    ]
    grid = ClearanceMap(place.walls, np.zeros((0, 3)))
    distance = grid.distance(np.array([[2.5, 0.0], [0.0, 1.0], [3.1, 0.0]]))
    assert distance.tolist() == pytest.approx([0.5, 1.0, 0.0], abs=1e-6)


def test_episodes_are_drawn_in_a_scene_of_igibson(tmp_path):
    mini(tmp_path)
    scenario = PlaceDistribution(str(tmp_path), distance=(1.0, 8.0)).sample("x", 1, 0)
    assert scenario.kind == "Mini_0_int"
    assert (np.abs(scenario.path) <= [3.0, 2.0]).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("1.2 0.8 0.5", "1.2 0.8", "link bed_3 bounding_box='1.2 0.8': must be three finite"),
        ("1.2 0.8 0.5", "1.2 0 0.5", "bounding_box='1.2 0 0.5': must be three numbers > 0"),
        ("1.0 -0.5 0.25", "a b c", "joint bed_3 xyz='a b c'"),
        ('child link="bed_3"', 'child link="bed_9"', "link bed_3='bed': must be the child"),
        ("</robot>", "", "not XML"),
        ("<robot", '<!DOCTYPE a [<!ENTITY b "c">]><robot', "no document type"),
    ],
)
def test_malformed_urdf_names_key_and_value(tmp_path, old, new, message):
    with pytest.raises(DamagedFileError) as error:
        load_igibson(mini(tmp_path, URDF.replace(old, new)))
    assert message in str(error.value)
    assert "Mini_0_int_best.urdf" in str(error.value)


def test_map_without_traversable_cells_raises(tmp_path):
    scene = mini(tmp_path)
    Image.fromarray(np.zeros((800, 800), np.uint8)).save(
        scene / "layout" / "floor_trav_no_obj_0.png"
    )
    with pytest.raises(DamagedFileError, match="must have traversable cells"):
        load_igibson(scene)
    (scene / "layout" / "floor_trav_no_obj_0.png").write_text("no picture")
    with pytest.raises(DamagedFileError, match="must be a picture, one of PGM, PNG, BMP"):
        load_igibson(scene)


def test_boxes_cover_the_occupied_cells_only():
    occupied = np.random.default_rng(0).random((30, 20)) < 0.5
    boxes = boxes_of_cells(occupied, np.array([1.0, 2.0]), 0.1)
    covered = np.zeros_like(occupied)
    for cx, cy, hx, hy, _ in boxes:
        low = np.round((np.array([cx - hx, cy - hy]) - [1.0, 2.0]) / 0.1).astype(int)
        high = np.round((np.array([cx + hx, cy + hy]) - [1.0, 2.0]) / 0.1).astype(int)
        assert not covered[low[0] : high[0], low[1] : high[1]].any()
        covered[low[0] : high[0], low[1] : high[1]] = True
    assert (covered == occupied).all()
    assert len(boxes) < occupied.sum()
