"""Wherever the lidar is mounted, everything that reads a scan gets the robot frame."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from nightly import mostly

from navrl import factory, keys
from navrl.config import compose, instantiate
from navrl.deploy import PolicyRunner
from navrl.envs.rewards import Proximity
from navrl.evaluation.recorder import record_episode
from navrl.evaluation.recording import Recording
from navrl.ops import se2
from navrl.ops.distance import point_box_distance
from navrl.sim import Lidar
from navrl.transforms import MinPool
from navrl.transforms import compose as chain
from navrl.viz.rerun_log import save_rrd
from navrl.viz.scene import draw_scene

MOUNTS = {
    "backwards": "[0.0, 0.0, 3.14159265]",
    "turned": "[0.0, 0.0, 0.5]",
    "in front": "[0.15, 0.0, 0.0]",
    "on a corner": "[0.1, -0.12, -2.0]",
}
PIPELINES = ["paper", "robust", "navrl_best", "liang"]
SIMULATORS = ["batched", "bullet"]


def make(mount="[0.0, 0.0, 0.0]", transforms="paper", simulator="batched", worlds=4):
    overrides = [f"lidar.mount={mount}", f"transforms={transforms}", "lidar.noise=none"]
    cfg = compose("evaluate", [*overrides, f"simulator={simulator}", "suite=smoke"])
    env = factory.make_navigation_env(cfg, worlds, privileged=True)
    env.set_scenarios(batch(cfg, worlds))
    return factory.make_env(env, instantiate(cfg.transforms)), cfg


def batch(cfg, worlds):
    from navrl.worlds import ScenarioBatch

    return ScenarioBatch.pack(instantiate(cfg.suite).scenarios(range(worlds)))


def drive(env, steps=6):
    """Drive on arcs and return the rollout ``[N, T]``."""
    actions = iter(torch.linspace(-0.6, 0.6, steps))

    def policy(tensordict):
        action = torch.full((*tensordict.batch_size, 2), 0.2)
        action[..., 1] = next(actions)
        return tensordict.set("action", action)

    with torch.no_grad():
        return env.rollout(steps, policy, break_when_any_done=False)


@pytest.mark.parametrize("transforms", PIPELINES)
@pytest.mark.parametrize("yaw", mostly([3.14159265, -math.pi / 2, math.pi / 90], [math.pi / 90]))
def test_mount_rotated_by_whole_bins_keeps_observations(transforms, yaw):
    plain, _ = make(transforms=transforms)
    turned, _ = make(f"[0.0, 0.0, {yaw}]", transforms)
    expected, got = drive(plain), drive(turned)
    names = {*expected.keys()} - {"ranges", "next", "action", "reward_terms", keys.ICP_INLIERS}
    assert {keys.POINTS, keys.WAYPOINTS} <= names or transforms == "liang"
    for name in names:
        for ours, other in ((got, expected), (got["next"], expected["next"])):
            same = torch.isclose(
                ours[name].double(), other[name].double(), atol=2e-3, rtol=0, equal_nan=True
            )
            assert same.double().mean() > 0.995, name  # beams that graze an edge see either side


@pytest.mark.parametrize("simulator", SIMULATORS)
@pytest.mark.parametrize("mount", mostly(MOUNTS.values(), [list(MOUNTS.values())[-1]]), ids=MOUNTS)
def test_points_lie_on_obstacle_surfaces(mount, simulator):
    env, cfg = make(mount, simulator=simulator)
    cfg.transforms.min_pool.bearing = "beam"
    exact, _ = factory.make_env(env.base_env, instantiate(cfg.transforms)), cfg
    rollout = drive(exact)["next"]
    walls = batch(cfg, 4).boxes
    for row in range(4):
        for step in range(rollout.shape[1]):
            seen = rollout[row, step]
            points = se2.transform_points(seen["pose"], seen[keys.POINTS][seen[keys.RETURNS]])
            boxes = torch.cat([walls[row], seen[keys.PEDESTRIAN_BOXES]]).float()
            distance = point_box_distance(points, boxes.expand(len(points), -1, -1)).amin(-1)
            assert distance.quantile(0.99) < 2e-3
            assert len(points) > 20
    exact.close()


@pytest.mark.parametrize("mount", mostly(MOUNTS.values(), [list(MOUNTS.values())[-1]]), ids=MOUNTS)
def test_both_simulators_give_the_same_points(mount):
    pytest.importorskip("pybullet")
    results = []
    for simulator in SIMULATORS:
        env, _ = make(mount, simulator=simulator)
        results.append(drive(env, 3)["next"])
        env.close()
    differs = (results[0][keys.POINTS] - results[1][keys.POINTS]).abs().amax(-1) > 2e-3
    assert differs.float().mean() < 5e-3


@pytest.mark.parametrize("mount", MOUNTS.values(), ids=MOUNTS)
def test_proximity_is_measured_from_the_robot(mount):
    lidar = Lidar(noise="none", mount=torch.tensor(eval(mount)).tolist())
    hit = torch.tensor([0.5, 0.2])  # m, robot frame
    offset = se2.transform_points(se2.inverse(torch.tensor(lidar.mount)), hit[None])[0]
    beam = round(math.atan2(offset[1], offset[0]) * 1440 / (2 * math.pi)) % 1440
    ranges = torch.full((1, 1440), 3.5)
    ranges[0, beam] = offset.norm()
    torch.testing.assert_close(lidar.nearest(ranges), hit.norm()[None], atol=2e-3, rtol=0)
    torch.testing.assert_close(lidar.points(ranges)[0, beam], hit, atol=2e-3, rtol=0)
    assert Proximity().measured_from == "lidar"


@pytest.fixture(scope="module", params=MOUNTS.values(), ids=MOUNTS)
def recording(request):
    overrides = [f"lidar.mount={request.param}", "policy=pure_pursuit", "suite=smoke"]
    cfg = compose("evaluate", [*overrides, "lidar.noise=none", "num_worlds=1"])
    player = factory.make_evaluated_policy(cfg)
    return record_episode(player.env, player.policy, instantiate(cfg.suite).scenarios([0])[0])


def test_pictures_draw_the_scan_on_the_walls(recording, tmp_path):
    """With the pooled points and without: then the raw beams are drawn."""
    bare = dataclasses.replace(recording, points=None)
    boxes = torch.tensor(np.concatenate([recording.walls, recording.pedestrian_boxes[1]]))
    for shown, bound in ((recording, 0.12), (bare, 2e-3)):
        axes = Figure().subplots()
        draw_scene(axes, shown, 1)
        (dots,) = [line for line in axes.lines if line.get_marker() == "."]
        points = torch.tensor(np.stack(dots.get_data(), axis=-1))
        gap = point_box_distance(points, boxes.expand(len(points), -1, -1)).amin(-1)
        assert gap.quantile(0.95) < bound
    file = tmp_path / "episode.npz"
    bare.save(file)
    assert np.array_equal(Recording.load(file).lidar_mount, recording.lidar_mount)
    pytest.importorskip("rerun")
    assert save_rrd(bare, tmp_path / "episode.rrd").is_file()


def test_attention_is_drawn_on_its_sectors_of_the_robot_frame(recording):
    weights = np.full((recording.num_steps, 30), 1 / 30)
    weights[:, 7] = 0.5  # the sector from 84 to 96 degrees to the left
    attended = dataclasses.replace(recording, spatial_attention=weights)
    axes = Figure().subplots()
    draw_scene(axes, attended, 1, ["spatial"])
    (sectors,) = [
        c for c in axes.collections if type(c) is PolyCollection and c.get_array() is not None
    ]
    x, y, yaw = recording.pose[1]
    rim = sectors.get_paths()[7].vertices[1:-1] - [x, y]
    bearing = np.mod(np.arctan2(rim[:, 1], rim[:, 0]) - yaw, 2 * np.pi)
    assert (np.abs(np.degrees(bearing) - 90.0) < 6.3).all()


def test_pooling_for_another_mount_is_rejected():
    env, cfg = make("[0.0, 0.0, 0.5]")
    message = (
        r"lidar.mount=\[0.0, 0.0, 0.5\]: must be the mount of MinPool, which is \[0.0, 0.0, 0.0\]"
    )
    with pytest.raises(ValueError, match=message):
        factory.make_env(env.base_env, chain(min_pool=MinPool()))
    cfg = compose("evaluate", ["policy=paper", "+change.lidar.mount=[0.0, 0.0, 0.5]"])
    with pytest.raises(ValueError, match=message):
        factory.make_evaluated_policy(cfg)
    lidar, robot = Lidar(mount=(0.0, 0.0, 0.5)), instantiate(cfg.robot)
    with pytest.raises(ValueError, match=message):
        PolicyRunner(MinPool(), None, lidar, robot)


@pytest.mark.parametrize("increment", mostly([0.25, -0.25], [-0.25]))
def test_lidar_of_270_degrees_pools_to_the_same_bins(increment):
    """What it sees is what a full circle of the same bearings sees; behind, there is no return."""
    first = math.radians(-135.0 if increment > 0 else 135.0)
    words = ["lidar.noise=none", "scenario=office", "pool_size=8", "num_worlds=4", "num_threads=1"]
    partial = [
        "lidar.num_beams=1081",
        f"lidar.angle_min={first}",
        f"lidar.angle_increment={math.radians(increment)}",
    ]
    observed = []
    for overrides in (words, [*words, *partial]):
        cfg = compose("train", overrides)
        env = factory.make_env(
            factory.make_navigation_env(cfg, 4, factory.make_pool(cfg), 0),
            instantiate(cfg.transforms),
        )
        observed.append(env.reset())
    full, part = observed
    bins = 360.0 / 180 * torch.arange(180)
    seen = (bins + 2.0 < 133.0) | (bins > 227.0)
    for key in ("ranges_pooled", "returns"):
        torch.testing.assert_close(part[key][:, seen], full[key][:, seen], atol=2e-3, rtol=0)
    behind = (bins > 139.0) & (bins < 221.0)
    assert not part["returns"][:, behind].any() and full["returns"][:, behind].any()


def test_pooling_for_other_beam_angles_is_rejected():
    cfg = compose("train", ["transforms.min_pool.angle_min=0.5", "pool_size=8", "num_threads=1"])
    env = factory.make_navigation_env(cfg, 1, factory.make_pool(cfg), 0)
    with pytest.raises(ValueError, match=r"lidar.angle_min=0.0: must be the angle_min of MinPool"):
        factory.make_env(env, instantiate(cfg.transforms))


def test_bins_with_returns_of_an_off_center_scanner_are_seen():
    """A scanner 0.3 m ahead with 180 degrees sees the robot's sides by its nearest returns."""
    pool = MinPool(
        group_size=None,
        num_points=36,
        angle_min=-math.pi / 2,
        angle_increment=math.pi / 180,
        mount=(-0.3, 0.0, 0.0),
        out_keys=[keys.RANGES_POOLED, keys.POINTS, keys.RETURNS, "seen"],
    )
    *_, returns, seen = pool(torch.full((181,), 0.2))
    assert returns.any() and not (returns & ~seen).any()
    covered = pool.layout(181).seen()
    assert (returns & ~covered).any() and (seen | ~covered).all()
    *_, returns, seen = pool(torch.full((181,), 3.5))
    assert not returns.any() and torch.equal(seen, covered)
