"""What is drawn lies where it was."""

import dataclasses

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from navrl.viz.live import FRAME_PIXELS, LiveScene
from navrl.viz.scene import attention_scale, closest_step, draw_scene, scene_limits
from navrl.viz.style import BLACK, GREEN, ORANGE

BOTH = ("spatial", "temporal")
OPTIONAL = (
    *("points", "points_aligned", "tagd", "tagd_valid", "waypoints"),
    *("spatial_attention", "temporal_attention"),
)


def drawn(recording, step, attention=BOTH, **options):
    axes = Figure().subplots()
    draw_scene(axes, recording, step, attention, **options)
    return axes


def collections(axes, kind, weighted=True):
    found = [c for c in axes.collections if type(c) is kind]
    return [c for c in found if (c.get_array() is not None) == weighted]


def arrows(axes, color):
    """Start and vector of the arrows of a color, world."""
    wanted = tuple(int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    for quiver in axes.collections:
        if isinstance(quiver, Quiver) and np.allclose(quiver.get_facecolor()[0, :3], wanted):
            return quiver.XY, np.stack([quiver.U, quiver.V], axis=-1)
    return np.empty((0, 2)), np.empty((0, 2))


def distance_to_box(points, box):
    cx, cy, hx, hy, yaw = box
    offset = points - [cx, cy]
    local = offset @ np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    outside = np.maximum(np.abs(local) - [hx, hy], 0.0)
    return np.linalg.norm(outside, axis=-1)


@pytest.fixture(params=["start", "middle"])
def step(request, recording):
    return {"start": 0, "middle": recording.num_steps // 2}[request.param]


def test_lidar_points_lie_on_obstacle_surfaces(recording, step):
    (dots,) = [line for line in drawn(recording, step).lines if line.get_marker() == "."]
    points = np.stack(dots.get_data(), axis=-1)
    boxes = [*recording.walls, *recording.pedestrian_boxes[step]]
    boxes = [box for box in boxes if np.isfinite(box).all()]
    nearest = np.min([distance_to_box(points, box) for box in boxes], axis=0)
    assert dots.get_color() == BLACK
    assert len(points) > 50
    assert np.quantile(nearest, 0.95) < 0.12  # noise, and the pooled point is at its bin's center


def test_sectors_match_their_beams(recording, step):
    (sectors,) = collections(drawn(recording, step, ["spatial"]), PolyCollection)
    x, y, yaw = recording.pose[step]
    for i, path in enumerate(sectors.get_paths()):
        rim = path.vertices[1:-1] - [x, y]
        first, last = np.arctan2(*rim[0][::-1]), np.arctan2(*rim[-1][::-1])
        width = 2 * np.pi / 30
        assert np.cos(first - yaw - i * width) == pytest.approx(1.0, abs=1e-6)
        assert np.cos(last - yaw - (i + 1) * width) == pytest.approx(1.0, abs=1e-6)
        beams = recording.ranges[step].reshape(30, -1)[i]
        assert np.linalg.norm(rim, axis=-1)[:-1] == pytest.approx(beams, abs=1e-4)
    assert np.array_equal(sectors.get_array(), recording.spatial_attention[step])


def test_rays_end_at_the_descriptors(recording, step):
    (rays,) = collections(drawn(recording, step, ["temporal"]), LineCollection)
    x, y, yaw = recording.pose[step]
    forward, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    shown = dict(zip(rays.get_array().tolist(), rays.get_segments(), strict=True))
    weights = recording.temporal_attention[step]
    assert len(shown) == len(np.unique(weights))
    for weight, descriptor in zip(weights.tolist(), recording.tagd[step], strict=True):
        begin, end = shown[weight]
        assert begin == pytest.approx([x, y])
        if np.sum(weights == weight) == 1:
            assert end == pytest.approx(
                [x, y] + descriptor[2] * forward + descriptor[3] * left, abs=1e-4
            )


def test_descriptor_arrows_show_measured_motion_only(recording):
    step = recording.num_steps // 2
    valid = recording.tagd_valid[step].copy()
    valid[0] = [False, True]
    all_valid = recording.tagd_valid.copy()
    all_valid[step] = valid
    altered = dataclasses.replace(recording, tagd_valid=all_valid)
    start, vector = arrows(drawn(altered, step), GREEN)
    kept = recording.tagd[step][valid.all(axis=-1)]
    assert len(start) == len(kept)
    assert np.linalg.norm(vector, axis=-1) == pytest.approx(
        np.linalg.norm(kept[:, 2:] - kept[:, :2], axis=-1), abs=1e-5
    )
    assert np.linalg.norm(start - recording.pose[step, :2], axis=-1) == pytest.approx(
        np.linalg.norm(kept[:, :2], axis=-1), abs=1e-5
    )


def test_velocity_arrows_end_at_predicted_positions(recording):
    step = recording.num_steps // 2
    boxes, dt = recording.pedestrian_boxes, recording.time_step_s
    start, vector = arrows(drawn(recording, step), ORANGE)
    for begin, velocity in zip(start, vector, strict=True):
        k = np.nanargmin(np.linalg.norm(boxes[step, :, :2] - begin, axis=-1))
        expected = (boxes[step, k, :2] - boxes[step - 1, k, :2]) / dt
        assert velocity == pytest.approx(expected, abs=1e-5)
        assert 0.05 < np.linalg.norm(velocity) < 1.1
    assert len(start) > 0


def test_absent_people_are_not_drawn(recording):
    boxes = recording.pedestrian_boxes.copy()
    boxes[:, 0] = np.nan
    without = dataclasses.replace(recording, pedestrian_boxes=boxes)
    shown, left = (
        sum(len(drawing.get_paths()) for drawing in collections(axes, PolyCollection, False))
        for axes in (drawn(recording, 1), drawn(without, 1))
    )
    assert left == shown - 1


def test_no_attention_after_the_last_decision(recording):
    axes = drawn(recording, recording.num_steps)
    assert not collections(axes, PolyCollection)
    assert not collections(axes, LineCollection)


def test_unrecorded_data_is_omitted(recording):
    bare = dataclasses.replace(
        recording,
        points=None,
        points_aligned=None,
        tagd=None,
        tagd_valid=None,
        waypoints=None,
        spatial_attention=None,
        temporal_attention=None,
    )
    axes = drawn(bare, 1)
    assert not collections(axes, PolyCollection)
    (dots,) = [line for line in axes.lines if line.get_marker() == "."]
    assert len(dots.get_xdata()) > 500  # every beam that returned
    assert attention_scale(bare, "spatial") is None


def test_axes_are_metric_and_show_everything(recording):
    axes = drawn(recording, 0)
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x in m", "y in m")
    (left, right), (bottom, top) = scene_limits(recording)
    for points in (recording.path, recording.pose[:, :2], recording.walls[:, :2]):
        assert ((points > [left, bottom]) & (points < [right, top])).all()


def test_limits_of_large_maps_are_around_the_path(recording):
    walls = recording.walls.copy()
    walls[0, 0] = 100.0
    large = dataclasses.replace(recording, walls=walls)
    route = np.concatenate([recording.path, recording.pose[:, :2], [recording.goal]])
    right = scene_limits(large)[0][1]
    assert right == pytest.approx(route[:, 0].max() + 12.15)
    assert scene_limits(recording)[0][1] < right


def test_closest_step(recording):
    boxes = np.full_like(recording.pedestrian_boxes, np.nan)
    empty = dataclasses.replace(recording, pedestrian_boxes=boxes)
    assert closest_step(empty) == recording.num_steps // 2
    boxes = boxes.copy()
    boxes[:, 1] = [50.0, 0.0, 0.2, 0.2, 0.0]
    boxes[2, 1, :2] = recording.pose[2, :2]
    assert closest_step(dataclasses.replace(recording, pedestrian_boxes=boxes)) == 2


@pytest.mark.parametrize("step", [-1, 10_000])
def test_bad_step_is_named(recording, step):
    with pytest.raises(ValueError, match=f"step={step}"):
        draw_scene(Figure().subplots(), recording, step)


def test_bad_attention_is_named(recording):
    with pytest.raises(ValueError, match="'special'"):
        draw_scene(Figure().subplots(), recording, 0, ["special"])


def test_live_scene_draws_each_moment_at_one_size(recording):
    scene, frames = LiveScene(), []
    for steps in (0, 1, 5):
        series = {
            name: getattr(recording, name)[: steps + 1]
            for name in ("pose", "ranges", "pedestrian_boxes")
        }
        begun = dataclasses.replace(
            recording,
            **{**dict.fromkeys(OPTIONAL), **series},
            action=recording.action[:steps],
            requested=None,
            reward_terms={},
            outcome="running",
        )
        frames.append(scene.draw(begun))
    assert {frame.shape for frame in frames} == {(FRAME_PIXELS, FRAME_PIXELS, 3)}
    assert all(frame.dtype == np.uint8 for frame in frames)
    assert (frames[0] != frames[1]).any() and (frames[1] != frames[2]).any()
