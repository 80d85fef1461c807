"""What is written for rerun, read back with rerun: where it was, when, and in its color."""

import dataclasses
import sys

import numpy as np
import pages
import pytest
from matplotlib.colors import to_rgba

from navrl.sim import Lidar, bullet_scene
from navrl.viz import pictures, rerun_log, save_rrd
from navrl.viz.scene import attention_scale
from navrl.viz.style import BLACK, GREEN, SPATIAL_COLORS, TEMPORAL_COLORS

NEEDS_RERUN = "needs the extra rerun"


class Written:
    """The columns of a file, by entity and component; lists stay lists."""

    def __init__(self, file):
        chunk = pytest.importorskip("rerun.chunk", reason=NEEDS_RERUN)
        (self.store,) = chunk.RrdReader(file).recordings()
        self.moving, self.still = {}, {}
        for piece in chunk.RrdReader(file).stream():
            columns = piece.to_record_batch().to_pydict()
            columns = {name.split(":")[-1]: column for name, column in columns.items()}
            kept = self.still if piece.is_static else self.moving
            kept.setdefault(piece.entity_path, {}).update(columns)

    def rows(self, entity, component):
        return [np.array(row) for row in self.moving[entity][component]]

    def only(self, entity, component):
        return np.array(self.still[entity][component][0])


@pytest.fixture(scope="module")
def written(recording, tmp_path_factory):
    pytest.importorskip("rerun", reason=NEEDS_RERUN)
    return Written(save_rrd(recording, tmp_path_factory.mktemp("rerun") / "deep" / "episode.rrd"))


def world(pose, points):
    """Robot frame to world, by complex numbers."""
    z = (points[:, 0] + 1j * points[:, 1]) * np.exp(1j * pose[2]) + pose[0] + 1j * pose[1]
    return np.stack([z.real, z.imag], axis=-1)


def rgba(packed):
    """Rerun's 0xRRGGBBAA as shares."""
    return (np.asarray(packed)[:, None] >> np.array([24, 16, 8, 0]) & 255) / 255


def yaw_of(quaternions):
    assert np.allclose(quaternions[:, :2], 0.0)
    return 2 * np.arctan2(quaternions[:, 2], quaternions[:, 3])


def same_angle(a, b):
    return np.allclose(np.exp(1j * a), np.exp(1j * b), atol=1e-5)


def test_heights_equal_the_simulators():
    for name in ("WALL_HEIGHT", "PEDESTRIAN_HEIGHT", "ROBOT_HEIGHT"):
        assert getattr(rerun_log, name) == getattr(bullet_scene, name)
    assert Lidar().height == rerun_log.SCAN_HEIGHT


def test_both_timelines_have_one_row_per_step(written, recording):
    steps = recording.num_steps
    assert {"/world/robot", "/world/way", "/world/pedestrians"} <= set(written.moving)
    for entity, columns in written.moving.items():
        count = steps + 1 if entity.startswith("/world/") else steps
        assert columns["step"] == list(range(count)), entity
        seconds = [time.total_seconds() for time in columns["time"]]
        assert np.allclose(seconds, np.arange(count) * recording.time_step_s, atol=1e-9), entity


def test_walls_path_and_goal_are_static(written, recording):
    walls = recording.walls
    assert np.allclose(written.only("/world/walls", "centers")[:, :2], walls[:, :2], atol=1e-5)
    half = written.only("/world/walls", "half_sizes")
    assert np.allclose(half[:, :2], walls[:, 2:4]) and np.allclose(half[:, 2], 0.6)
    assert np.allclose(written.only("/world/walls", "centers")[:, 2], 0.6)  # on the floor
    assert same_angle(yaw_of(written.only("/world/walls", "quaternions")), walls[:, 4])
    (path,) = written.only("/world/path", "strips")
    assert np.allclose(path[:, :2], recording.path, atol=1e-5)
    (goal,) = written.only("/world/goal", "centers")
    assert np.allclose(goal[:2], recording.goal, atol=1e-5)
    assert np.allclose(written.only("/world/goal", "radii"), recording.goal_radius)


def test_pedestrians_are_boxes_where_they_were(written, recording):
    boxes = recording.pedestrian_boxes
    assert np.isfinite(boxes).any(), "the episode has nobody in it"
    for t, centers in enumerate(written.rows("/world/pedestrians", "centers")):
        there = boxes[t][np.isfinite(boxes[t, :, 0])]
        assert np.allclose(centers[:, :2], there[:, :2], atol=1e-5)
        assert np.allclose(centers[:, 2], 0.5)
        half = written.rows("/world/pedestrians", "half_sizes")[t]
        assert np.allclose(half, np.insert(there[:, 2:4], 2, 0.5, axis=1))
        yaw = yaw_of(written.rows("/world/pedestrians", "quaternions")[t])
        assert same_angle(yaw, there[:, 4])


def test_robot_and_its_trajectory_are_logged(written, recording):
    pose = recording.pose
    place = np.concatenate(written.rows("/world/robot", "translation"))
    assert np.allclose(place[:, :2], pose[:, :2], atol=1e-5) and np.allclose(place[:, 2], 0.0)
    assert same_angle(
        yaw_of(np.concatenate(written.rows("/world/robot", "quaternion"))), pose[:, 2]
    )
    assert np.allclose(written.only("/world/robot/body", "radii"), recording.robot_radius)
    ((x, y, z),) = written.only("/world/robot/heading", "vectors")
    assert x > recording.robot_radius and (y, z) == (0.0, 0.0)  # out of the hull, straight ahead
    for t, (strip,) in enumerate(written.rows("/world/way", "strips")):
        assert np.allclose(strip[:, :2], pose[: t + 1, :2], atol=1e-5)


def test_the_scan_shows_spatial_attention(written, recording):
    weights, points = recording.spatial_attention, recording.points
    scale, each = attention_scale(recording, "spatial"), points.shape[1] // weights.shape[1]
    colors = written.rows("/world/scan", "colors")
    for t, positions in enumerate(written.rows("/world/scan", "positions")):
        hit = np.linalg.norm(points[t], axis=-1) < recording.max_range - 1e-3
        expected = world(recording.pose[t], points[t][hit])
        assert len(expected) > 50 or t
        assert np.allclose(positions[:, :2], expected, atol=1e-4)
        assert np.allclose(positions[:, 2], Lidar().height)
        if t < recording.num_steps:
            share = np.clip(scale(np.repeat(weights[t], each)[hit]), 0, 1)
            assert np.allclose(rgba(colors[t]), SPATIAL_COLORS(0.25 + 0.75 * share), atol=5e-3)
    assert np.allclose(rgba(colors[-1]), to_rgba(BLACK))  # nothing was decided at the end


def test_descriptors_show_temporal_attention(written, recording):
    scale, count = attention_scale(recording, "temporal"), 0
    colors = written.rows("/world/tagd", "colors")
    vectors = written.rows("/world/tagd", "vectors")
    for t, origins in enumerate(written.rows("/world/tagd", "origins")):
        real = recording.tagd_valid[t].all(axis=-1)
        count += real.sum()
        assert len(origins) == len(vectors[t]) == len(colors[t]) == real.sum()
        if not real.any():
            continue
        before, now = np.split(recording.tagd[t][real], 2, axis=-1)
        assert np.allclose(origins[:, :2], world(recording.pose[t], before), atol=1e-4)
        ends = world(recording.pose[t], now)
        assert np.allclose((origins + vectors[t])[:, :2], ends, atol=1e-4)
        if t < recording.num_steps:
            share = np.clip(scale(recording.temporal_attention[t][real]), 0, 1)
            assert np.allclose(rgba(colors[t]), TEMPORAL_COLORS(0.25 + 0.75 * share), atol=5e-3)
        else:
            assert np.allclose(rgba(colors[t]), to_rgba(GREEN), atol=5e-3)
    assert count > 10


def test_commands_and_rewards_are_curves(written, recording):
    curves = {"/commands/v": recording.action[:, 0], "/commands/w": recording.action[:, 1]}
    curves |= {f"/rewards/{name}": term for name, term in recording.reward_terms.items()}
    assert len(curves) > 3
    for entity, values in curves.items():
        assert np.allclose(np.ravel(written.rows(entity, "scalars")), values, atol=1e-6), entity
    assert written.still["/__properties/episode"]["outcome"] == [[recording.outcome]]


def test_unrecorded_data_is_omitted(recording, tmp_path):
    pytest.importorskip("rerun", reason=NEEDS_RERUN)
    names = ("points", "points_aligned", "tagd", "tagd_valid")
    names += ("spatial_attention", "temporal_attention")
    alone = np.full_like(recording.pedestrian_boxes, np.nan)
    bare = dataclasses.replace(recording, **dict.fromkeys(names), pedestrian_boxes=alone)
    written = Written(save_rrd(bare, tmp_path / "bare.rrd"))
    assert "/world/tagd" not in written.moving
    assert [len(row) for row in written.rows("/world/pedestrians", "centers")] == [0] * len(alone)
    beams = recording.ranges.shape[1]
    hit = recording.ranges[3] < recording.max_range - 1e-3
    angle = 2 * np.pi * np.flatnonzero(hit) / beams
    local = recording.ranges[3][hit][:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    positions = written.rows("/world/scan", "positions")[3]
    assert np.allclose(positions[:, :2], world(recording.pose[3], local), atol=1e-4)
    assert np.allclose(rgba(written.rows("/world/scan", "colors")[3]), to_rgba(BLACK))


def test_picture_is_one_file_per_recording(recording, tmp_path):
    pytest.importorskip("rerun", reason=NEEDS_RERUN)
    for name in ("four/a/episode.npz", "four/b/episode.npz"):
        (tmp_path / name).parent.mkdir(parents=True)
        recording.save(tmp_path / name)
    (single,) = pictures.rerun([tmp_path / "four" / "a"], tmp_path / "single.v2")
    assert single == tmp_path / "single.v2.rrd"
    both = pictures.rerun([tmp_path / "four"], tmp_path / "both")
    assert both == [tmp_path / "both" / name / "episode.rrd" for name in "ab"]
    stores = [Written(file).store for file in both]
    assert stores[0].recording_id != stores[1].recording_id  # one viewer shows both
    names = [Written(file).only("/__properties", "name") for file in both]
    assert [str(*name) for name in names] == ["a/episode", "b/episode"]


def test_write_error_states_its_cause(recording, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"\.rrd"):
        save_rrd(recording, tmp_path / "episode.gif")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ImportError, match=r"needs rerun; pip install -e '\.\[rerun\]'"):
        save_rrd(recording, tmp_path / "episode.rrd")


def test_command_error_is_one_line(recording, tmp_path, monkeypatch, capsys):
    recording.save(tmp_path / "episode.npz")
    monkeypatch.setitem(sys.modules, "rerun", None)
    words = f"source={tmp_path / 'episode.npz'}", f"hydra.run.dir={tmp_path / 'run'}"
    with pytest.raises(SystemExit) as exit_:
        pages.run("navrl-plot picture=rerun", *words)
    (line,) = capsys.readouterr().err.splitlines()
    assert exit_.value.code == 2
    assert line == "navrl: a .rrd file needs rerun; pip install -e '.[rerun]' in a clone of navrl"
