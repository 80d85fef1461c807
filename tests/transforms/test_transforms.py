"""Every transform against the contract, and what each promises beyond it."""

import math

import pytest
import torch
from contract import TransformContract, assert_same, make_env
from lidar_envs import ROOM, RoomEnv, StrangersEnv
from tensordict import TensorDict
from torchrl.data import Bounded, LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, GymWrapper, TransformedEnv
from torchrl.envs.utils import check_env_specs

from navrl import keys
from navrl.ops import se2
from navrl.ops.pooling import min_pool
from navrl.ops.unicycle import advance_poses
from navrl.transforms import (
    TAGD,
    GoalPosition,
    ICPAlign,
    MinPool,
    Normalize,
    RangeHistory,
    ScanHistory,
    Waypoints,
    compose,
)

PAIRS = [[keys.POINTS, keys.RETURNS], [keys.PREVIOUS_POINTS, keys.PREVIOUS_RETURNS]]


def strangers_scan() -> list:
    """Pool the stranger's 90 beams to 30 points under nested keys, and keep the last scan."""
    return [
        MinPool(
            3, 2.5, in_keys=["laser"], out_keys=[["scan", "r"], ["scan", "xy"], ["scan", "hit"]]
        ),
        ScanHistory(
            in_keys=[["scan", "xy"], ["scan", "hit"]], out_keys=[["last", "xy"], ["last", "hit"]]
        ),
    ]


def strangers_icp(**options) -> ICPAlign:
    return ICPAlign(
        **options,
        in_keys=[["last", "xy"], ["last", "hit"], ["scan", "xy"], ["scan", "hit"]],
        out_keys=[["last", "aligned"], "motion", "ok", "matches"],
    )


class TestMinPool(TransformContract):
    def make(self, **kwargs):
        return MinPool(group_size=4, **kwargs)

    def in_foreign_env(self):
        return strangers_scan()[:1]

    def test_group_size_must_divide_the_beams(self):
        with pytest.raises(ValueError, match=r"'ranges'.*48 beams, group_size 7"):
            _ = make_env([MinPool(group_size=7)]).observation_spec

    def test_wrong_number_of_points_is_rejected(self):
        message = (
            r"num_points=16: must be 12 for group_size=4 and 48 beams; use a lidar of 64 beams"
        )
        with pytest.raises(ValueError, match=message):
            _ = make_env([MinPool(group_size=4, num_points=16)]).observation_spec
        assert make_env([MinPool(group_size=4, num_points=12)]).reset()["returns"].shape[1] == 12

    def test_transforms_accept_plain_tensors(self):
        pooled, points, returns = MinPool()(ranges=torch.full((2, 1440), 1.0))
        assert pooled.shape == (2, 180)
        assert points.shape == (2, 180, 2)
        assert returns.all()


FRONT = {  # the 36 beams of the RoomEnv's 48 that look ahead, clockwise
    "angle_min": math.radians(135.0),
    "angle_increment": -2.0 * math.pi / 48,
}
SEEN_KEYS = (keys.RANGES_POOLED, keys.POINTS, keys.RETURNS, keys.SEEN)


def front_scan(*more) -> list:
    """Pool three quarters of the circle into 20 bins, and keep the last scan."""
    return [MinPool(None, num_points=20, out_keys=SEEN_KEYS, **FRONT), *more]


class FrontEnv(RoomEnv):
    """The RoomEnv with a lidar that does not look back and turns clockwise."""

    def __init__(self, num_worlds: int = 4) -> None:
        super().__init__(num_worlds)
        spec = self.observation_spec.clone()
        spec["ranges"] = Bounded(0.0, 3.5, (num_worlds, 37))
        self.observation_spec = spec

    def _observe(self, done):
        beams = torch.arange(18, -19, -1) % self.num_beams
        seen = super()._observe(done)
        return seen.set("ranges", seen["ranges"][:, beams])


class TestMinPoolOfPartialScans(TestMinPool):
    def make(self, **kwargs):
        if "out_keys" in kwargs:
            return MinPool(None, num_points=12, **kwargs)
        return MinPool(None, num_points=20, out_keys=SEEN_KEYS, **kwargs)


class TestPartialScans:
    def rollout(self, *steps):
        env = TransformedEnv(FrontEnv(), Compose(*steps))
        check_env_specs(env)
        env.set_seed(0)
        torch.manual_seed(0)
        return env.rollout(10, break_when_any_done=False)

    def test_partial_lidar_points_lie_on_walls(self):
        rollout = self.rollout(*front_scan(), MinPool(4, bearing="beam", out_keys=["r", "p", "h"],
                                                      **FRONT))  # fmt: skip
        points = se2.transform_points(rollout["pose"], rollout["p"])[rollout["h"]]
        off = (torch.tensor(ROOM) - points.abs()).abs().amin(-1)
        assert off.max() < 1e-4
        seen = rollout[keys.SEEN]
        assert seen[..., [0, 19]].all() and not seen[..., 9:11].any()
        assert not rollout[keys.RETURNS][~seen].any()
        assert (rollout[keys.RANGES_POOLED][~seen] == 3.5).all()

    def test_alignment_and_history_treat_blind_bins_as_unknown(self):
        in_keys = [
            keys.PREVIOUS_POINTS,
            keys.PREVIOUS_RETURNS,
            keys.POINTS,
            keys.RETURNS,
            keys.SEEN,
        ]
        align = ICPAlign(initialization="rotation_search", min_pairs=3, in_keys=in_keys)
        history = RangeHistory(2, None, in_keys=[keys.POINTS, keys.ICP_TRANSFORM, keys.SEEN])
        rollout = self.rollout(*front_scan(ScanHistory(), align, history))["next"]
        assert rollout[keys.RANGES_HISTORY].isfinite().all()

    def test_blind_bin_has_no_history(self):
        """After a turn the sector that was behind holds a wall, which did not appear."""
        seen = torch.arange(180) < 90  # the left half
        points = min_pool(torch.full((180,), 2.0), 1).points
        now = TensorDict({keys.POINTS: points, keys.SEEN: seen}, [])
        before = now.clone()
        before[keys.POINTS] = torch.where(seen[:, None], points, 1.75 * points)  # blind: at 3.5 m
        now[keys.ICP_TRANSFORM] = torch.tensor([0.0, 0.0, math.radians(40.0)])  # turned right
        history = RangeHistory(1, 1, in_keys=[keys.POINTS, keys.ICP_TRANSFORM, keys.SEEN])
        before = history._call(before)
        ranges = history._step(before, now)[keys.RANGES_HISTORY]
        torch.testing.assert_close(ranges[1], ranges[0])
        without = RangeHistory(1, 1)._step(before, now)[keys.RANGES_HISTORY]
        assert (without[1] - without[0]).abs().max() > 1.0  # "it was free there"


class TestStoredTransitions:
    """Which steps of a pipeline can run in a replay buffer."""

    IN_ENV = (MinPool(group_size=2), ScanHistory())
    IN_BUFFER = (ICPAlign(), TAGD(num_groups=8), Normalize(in_keys=[keys.TAGD], out_keys=["x"]))

    def buffer(self, rollout, *steps):
        buffer = ReplayBuffer(
            storage=LazyTensorStorage(len(rollout)), transform=Compose(*steps), batch_size=32
        )
        buffer.extend(rollout.set("row", torch.arange(len(rollout))))
        return buffer

    def rollout(self, *steps):
        env = make_env(steps)
        env.set_seed(0)
        torch.manual_seed(0)
        return env.rollout(20, break_when_any_done=False).reshape(-1)

    def test_alignment_and_descriptors_in_the_buffer_are_bit_equal(self):
        online = self.rollout(*self.IN_ENV, *self.IN_BUFFER)
        made = [key for step in self.IN_BUFFER for key in step.out_keys]
        stored = online.exclude(*made, *(("next", key) for key in made))
        sample = self.buffer(stored, *(step.clone() for step in self.IN_BUFFER)).sample()
        expected = online[sample["row"]]
        for part, whole in ((sample, expected), (sample["next"], expected["next"])):
            assert_same(part, whole, made)
        motion = sample[keys.TAGD][..., :2] - sample[keys.TAGD][..., 2:]
        assert motion.norm(dim=-1).mean() > 1e-3

    @pytest.mark.parametrize(
        ("steps", "message"),
        [
            ((MinPool(group_size=2), ScanHistory(), ICPAlign(), TAGD()),
             r"ScanHistory needs \['points_previous', 'returns_previous'\] at the root of stored"),
            ((Waypoints(),), r"Waypoints needs \['path_progress'\] at the root"),
            ((MinPool(group_size=2), RangeHistory(2, 2)), "RangeHistory needs .* at the root"),
        ],
    )  # fmt: skip
    def test_history_transforms_reject_raw_transitions(self, steps, message):
        raw = self.rollout().set(keys.ICP_TRANSFORM, torch.zeros(80, 3))
        raw["next", keys.ICP_TRANSFORM] = torch.zeros(80, 3)
        with pytest.raises(ValueError, match=message):
            self.buffer(raw, *(step.clone() for step in steps)).sample()


class TestScanHistory(TransformContract):
    is_memoryless = False
    state_keys = (keys.POINTS, keys.RETURNS)

    def before(self):
        return [MinPool(group_size=4)]

    def make(self, **kwargs):
        return ScanHistory(**kwargs)

    def in_foreign_env(self):
        return strangers_scan()

    def check_rollout(self, rollout):
        for now, previous in zip(*PAIRS, strict=True):
            torch.testing.assert_close(rollout["next", previous], rollout[now], rtol=0, atol=0)
        root = rollout[..., 0]
        torch.testing.assert_close(root[keys.PREVIOUS_POINTS], root[keys.POINTS])
        done = rollout["next", "done"][..., :-1, 0]
        after, before = rollout[..., 1:], rollout[..., :-1]
        torch.testing.assert_close(after[keys.PREVIOUS_POINTS][~done], before[keys.POINTS][~done])
        torch.testing.assert_close(after[keys.PREVIOUS_POINTS][done], after[keys.POINTS][done])

    def test_each_caller_has_its_own_history(self):
        """Two streams through one environment do not mix: nothing is kept in the transform."""
        env = make_env(self.steps())
        one, other = env.reset(), env.reset()
        for root in (one, other, one):
            root["action"] = torch.zeros(4, 2)
            following = env.step(root.clone())["next"]
            torch.testing.assert_close(following[keys.PREVIOUS_POINTS], root[keys.POINTS])


class TestICPAlign(TransformContract):
    tolerance = 1e-5

    def before(self):
        return [MinPool(group_size=1), ScanHistory()]

    def make(self, **kwargs):
        return ICPAlign(**kwargs)

    def in_foreign_env(self):
        return [*strangers_scan(), strangers_icp()]

    def test_aligned_points_follow_from_the_transform(self):
        rollout = self.rollout()
        expected = se2.transform_points(rollout[keys.ICP_TRANSFORM], rollout[keys.PREVIOUS_POINTS])
        torch.testing.assert_close(rollout[keys.ALIGNED_POINTS], expected)

    def test_history_follows_the_robot(self):
        steps = [MinPool(group_size=1), ScanHistory(), ICPAlign(metric="point_to_line")]
        env = TransformedEnv(RoomEnv(num_beams=180, done_rate=0.0), Compose(*steps))
        env.set_seed(0)
        rollout = env.rollout(20)
        moved = se2.relative(rollout["next", "pose"], rollout["pose"])
        error = (rollout["next", keys.ICP_TRANSFORM] - moved).abs()
        assert error.amax(-1).median() < 0.01

    def test_transform_at_reset_is_the_identity(self):
        root = make_env(self.steps()).reset()
        assert root[keys.ICP_TRANSFORM].abs().max() < 1e-6
        assert root[keys.ICP_CONVERGED].all()


class TestICPAlignRobust(TestICPAlign):
    def make(self, **kwargs):
        return ICPAlign(
            initialization="rotation_search", metric="point_to_line", gate=0.3, **kwargs
        )

    def in_foreign_env(self):
        return [*strangers_scan(), strangers_icp(initialization="rotation_search")]


class TestICPAlignWithOdometry(TestICPAlign):
    """A prior from poses, the quality, and alignment on a full range."""

    OUT_KEYS = (
        keys.ALIGNED_POINTS,
        keys.ICP_TRANSFORM,
        keys.ICP_CONVERGED,
        keys.ICP_INLIERS,
        keys.ICP_QUALITY,
    )

    def before(self):
        full = [keys.POINTS_FULL, keys.RETURNS_FULL]
        past = [keys.PREVIOUS_POINTS_FULL, keys.PREVIOUS_RETURNS_FULL]
        return [
            MinPool(group_size=1, max_range=2.5),
            MinPool(group_size=1, out_keys=["ranges_full", *full]),
            ScanHistory(),
            ScanHistory(in_keys=[*full, keys.POSE], out_keys=[*past, keys.PREVIOUS_POSE]),
        ]

    def make(self, **kwargs):
        kwargs.setdefault("out_keys", self.OUT_KEYS)
        return ICPAlign(prior="pose", full_range=True, converged="quality", **kwargs)

    def in_foreign_env(self):
        return [*strangers_scan(), strangers_icp()]

    def test_transform_at_reset_is_the_identity(self):
        root = make_env(self.steps()).reset()
        assert root[keys.ICP_TRANSFORM].abs().max() < 1e-6

    def test_velocity_gives_the_prior_of_a_step(self):
        velocity = torch.tensor([[0.5, 0.8]])
        transform = ICPAlign(prior="velocity", time_step_s=0.2)._motion(velocity)
        after = advance_poses(torch.zeros(1, 3, dtype=torch.float64), velocity.double(), 0.2)
        torch.testing.assert_close(transform, se2.inverse(after))

    def test_quality_threshold_decides_convergence(self):
        rollout = self.rollout()
        share, rms, _, _ = rollout[keys.ICP_QUALITY].unbind(-1)
        is_good = (share >= 0.8) & (rms <= 0.035)
        converged = rollout[keys.ICP_CONVERGED].squeeze(-1)
        assert not (converged & ~is_good).any()
        assert 0.1 < converged.float().mean() < 0.9  # large steps, few beams
        strict = ICPAlign(converged="quality", max_rms=1e-9)
        assert not strict(rollout.select(*strict.in_keys))[keys.ICP_CONVERGED].all()

    @pytest.mark.parametrize(
        "option",
        [{"prior": "gps"}, {"converged": "yes"}, {"min_eigenvalue": 2.0}, {"max_rms": 0.0}],
    )
    def test_bad_option_is_named(self, option):
        ((name, value),) = option.items()
        with pytest.raises(ValueError, match=f"{name}={value!r}: must be"):
            ICPAlign(**option)


class TestNoAlignment(TransformContract):
    def before(self):
        return [MinPool(group_size=4), ScanHistory()]

    def make(self, **kwargs):
        return ICPAlign(method="none", **kwargs)

    def in_foreign_env(self):
        return [*strangers_scan(), strangers_icp(method="none")]

    def test_alignment_none_is_the_identity(self):
        rollout = self.rollout()
        assert_same(
            rollout.select(keys.ALIGNED_POINTS).rename_key_(
                keys.ALIGNED_POINTS, keys.PREVIOUS_POINTS
            ),
            rollout,
            [keys.PREVIOUS_POINTS],
        )
        assert (rollout[keys.ICP_TRANSFORM] == 0).all()
        assert not rollout[keys.ICP_CONVERGED].any()


class TestTAGD(TransformContract):
    def before(self):
        return [MinPool(group_size=2), ScanHistory(), ICPAlign()]

    def make(self, **kwargs):
        return TAGD(num_groups=8, **kwargs)

    def in_foreign_env(self):
        in_keys = [["scan", "xy"], ["scan", "hit"], ["last", "aligned"], ["last", "hit"]]
        tagd = TAGD(max_range=2.5, in_keys=in_keys, out_keys=[["tagd", "c"], ["tagd", "real"]])
        return [*strangers_scan(), strangers_icp(), tagd]

    def test_alignment_uses_scans_in_their_roles(self):
        now, before = torch.tensor([[1.0, 0.0]]), torch.tensor([[1.1, 0.05]])
        real = torch.tensor([True])
        tagd, valid = TAGD()(points=now, returns=real, points_aligned=before, returns_previous=real)
        torch.testing.assert_close(tagd[0], torch.tensor([1.1, 0.05, 1.0, 0.0]))
        assert valid[0].all()
        assert not valid[1:].any()


class TestWaypoints(TransformContract):
    is_memoryless = False
    state_keys = (keys.PATH_PROGRESS,)

    def make(self, **kwargs):
        return Waypoints(**kwargs)

    def in_foreign_env(self):
        return [
            Waypoints(
                3, 0.5, in_keys=["odometry", "route"], out_keys=[["ahead", "xy"], ["ahead", "arc"]]
            )
        ]

    def check_rollout(self, rollout):
        progress = rollout[keys.PATH_PROGRESS]
        following = rollout["next", keys.PATH_PROGRESS]
        assert (following >= progress).all()
        assert (following <= progress + 1.0 + 1e-5).all()
        done = rollout["next", "done"][..., :-1, :]
        torch.testing.assert_close(progress[..., 1:, :][~done], following[..., :-1, :][~done])
        world = se2.transform_points(rollout[keys.POSE], rollout[keys.WAYPOINTS])
        gap = world.diff(dim=-2).norm(dim=-1)
        assert (gap <= 0.3 + 1e-5).all()

    def test_projection_restarts_at_reset(self):
        env = make_env([Waypoints()])
        root = env.reset()
        root[keys.PATH_PROGRESS] = torch.full((4, 1), 100.0)
        mask = torch.tensor([[True], [True], [False], [False]])
        after = env.reset(root.clone().set("_reset", mask))[keys.PATH_PROGRESS]
        assert (after[:2] < 10.0).all()
        assert (after[2:] == 100.0).all()

    def test_step_without_progress_is_explained(self):
        env = make_env([Waypoints()])
        root = env.reset().exclude(keys.PATH_PROGRESS)
        root["action"] = torch.zeros(4, 2)
        with pytest.raises(ValueError, match="path_progress"):
            env.step(root)

    @pytest.mark.parametrize(("include_closest", "first"), [(False, 0.3), (True, 0.0)])
    def test_waypoints_on_a_straight_path(self, include_closest, first):
        path = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
        pose = torch.tensor([0.4, 0.5, math.pi / 2])  # looking along y, path to its right and below
        waypoints, progress = Waypoints(include_closest=include_closest)(pose=pose, path=path)
        ahead = torch.clamp(0.4 + first + 0.3 * torch.arange(5), max=1.0)  # then the goal, repeated
        expected = torch.stack([torch.full((5,), -0.5), 0.4 - ahead], dim=-1)
        torch.testing.assert_close(waypoints, expected)
        torch.testing.assert_close(progress, torch.tensor([0.4]))


@pytest.mark.parametrize("make", [Waypoints, GoalPosition])
def test_maps_far_from_the_origin_keep_precision(make):
    """The same place in UTM coordinates: float32 would know them to half a meter."""
    generator = torch.Generator().manual_seed(1)
    path = torch.rand(4, 20, 2, generator=generator, dtype=torch.float64).cumsum(1)
    pose = torch.rand(4, 3, generator=generator, dtype=torch.float64)
    shift = torch.tensor([5e5, 5.6e6, 0.0], dtype=torch.float64)
    near = make()(TensorDict({"pose": pose, "path": path}, [4]))
    far = make()(TensorDict({"pose": pose + shift, "path": path + shift[:2]}, [4]))
    single = make()(TensorDict({"pose": pose.float(), "path": path.float()}, [4]))
    for key in make().out_keys:
        assert far[key].dtype == torch.float32
        torch.testing.assert_close(far[key], near[key], atol=1e-5, rtol=0)
        torch.testing.assert_close(single[key], near[key], atol=1e-5, rtol=0)


class TestGoalPosition(TransformContract):
    def make(self, **kwargs):
        return GoalPosition(**kwargs)

    def in_foreign_env(self):
        return [GoalPosition(in_keys=["odometry", "route"], out_keys=[["ahead", "goal"]])]

    def test_goal_position_matches_a_manual_example(self):
        path = torch.tensor([[0.0, 0.0], [5.0, 0.0], [5.0, 3.0], [5.0, 3.0]])
        goal = GoalPosition()(pose=torch.tensor([4.0, 1.0, math.pi / 2]), path=path)
        torch.testing.assert_close(goal, torch.tensor([2.0, -1.0]))


class TestThreeScans(TransformContract):
    """A history of a history, as the three scans of conf/transforms/liang.yaml."""

    is_memoryless = False
    state_keys = ("previous",)

    def before(self):
        return [
            MinPool(group_size=4),
            ScanHistory(in_keys=[keys.RANGES_POOLED], out_keys=["previous"]),
        ]

    def make(self, **kwargs):
        return ScanHistory(**{"in_keys": ["previous"], "out_keys": ["earlier"], **kwargs})

    def in_foreign_env(self):
        older = ScanHistory(in_keys=[["last", "xy"]], out_keys=[["older", "xy"]])
        return [*strangers_scan(), older]

    def check_rollout(self, rollout):
        assert torch.equal(rollout["next", "earlier"], rollout["previous"])
        now, later = rollout[..., :-1], rollout[..., 1:]
        ended = now["next", "done"].squeeze(-1)
        scan = keys.RANGES_POOLED
        assert torch.equal(later["next", "earlier"][~ended], now[scan][~ended])  # two steps back
        assert torch.equal(later["earlier"][ended], later[scan][ended])  # there is no past


class TestRangeHistory(TransformContract):
    is_memoryless = False
    state_keys = (keys.POINTS, keys.POINTS_HISTORY)
    tolerance = 1e-5

    def before(self):
        return [MinPool(group_size=1), ScanHistory(), ICPAlign(metric="point_to_line")]

    def make(self, **kwargs):
        return RangeHistory(**{"num_scans": 2, "group_size": 1, **kwargs})

    def in_foreign_env(self):
        history = RangeHistory(
            2,
            group_size=3,
            max_range=2.5,
            in_keys=[["scan", "xy"], "motion"],
            out_keys=[["past", "xy"], ["past", "r"]],
        )
        return [*strangers_scan(), strangers_icp(), history]

    def check_rollout(self, rollout):
        points, past, ranges = keys.POINTS, keys.POINTS_HISTORY, keys.RANGES_HISTORY
        moved = rollout["next", keys.ICP_TRANSFORM]
        latest = se2.transform_points(moved, rollout[points])
        torch.testing.assert_close(rollout["next", past][..., 0, :, :], latest)
        older = se2.transform_points(moved, rollout[past][..., 0, :, :])
        torch.testing.assert_close(rollout["next", past][..., 1, :, :], older)
        ended = rollout["next", "done"][..., :-1, 0]
        fresh = rollout[..., 1:][ended]  # there is no past
        assert torch.equal(fresh[past][:, 0], fresh[points])
        assert torch.equal(fresh[past][:, 1], fresh[points])
        torch.testing.assert_close(fresh[ranges], fresh[ranges][:, :1].expand(-1, 3, -1))
        now = rollout[keys.RANGES_POOLED]
        torch.testing.assert_close(rollout[ranges][..., 0, :], now)

    def test_static_points_remain_aligned(self):
        env = TransformedEnv(
            RoomEnv(num_beams=180, done_rate=0.0), Compose(*self.before(), self.make())
        )
        env.set_seed(0)
        ranges = env.rollout(20)["next", keys.RANGES_HISTORY]
        unmoved = (ranges[..., 1:, :] - ranges[..., :1, :]).abs().median()
        raw = (ranges[:, 1:, 0] - ranges[:, :-1, 0]).abs().median()
        assert unmoved < 0.01 < 3 * unmoved + 0.02 < raw + 0.02


class TestNormalize(TransformContract):
    in_keys = (keys.POINTS, keys.RANGES)
    out_keys = ("spatial", "distance")

    def before(self):
        return [MinPool(group_size=4)]

    def make(self, **kwargs):
        return Normalize(3.5, **{"in_keys": self.in_keys, "out_keys": self.out_keys, **kwargs})

    def in_foreign_env(self):
        return [
            *strangers_scan(),
            Normalize(2.5, in_keys=[["scan", "xy"]], out_keys=[["network", "spatial"]]),
        ]

    def test_bounds_are_scaled(self):
        env = make_env(self.steps())
        assert env.observation_spec["spatial"].space.high.max() == 1.0
        assert self.rollout()["spatial"].abs().max() <= 1.0


class TestCompose:
    def test_normalize_scales_each_component(self):
        normalize = Normalize(scale=[0.5, 2.0], in_keys=["velocity"], out_keys=["scaled"])
        assert normalize(velocity=torch.tensor([[1.0, 1.0]])).tolist() == [[2.0, 0.5]]
        with pytest.raises(ValueError, match=r"scale=\[0.5, 2.0\]: must be one number for each"):
            normalize(velocity=torch.ones(1, 3))
        with pytest.raises(ValueError, match=r"scale=\[1.0, 0.0\]: must be positive"):
            Normalize(scale=[1.0, 0.0])

    def test_compose_keeps_order_and_drops_null(self):
        chain = compose(pool=MinPool(), history=None, last=Normalize())
        assert [type(step) for step in chain] == [MinPool, Normalize]

    def test_added_steps_of_the_scan_follow_the_pooling(self):
        steps = {name: ScanHistory(["a"], ["b"]) for name in ("clean", "min_pool", "icp_align")}
        added = {
            name: ScanHistory(["a"], ["b"]) for name in ("pose_history", "motion_compensation")
        }
        chain = list(compose(**steps, **added))
        wanted = ["clean", "min_pool", "motion_compensation", "pose_history", "icp_align"]
        every = steps | added
        assert [id(step) for step in chain] == [id(every[name]) for name in wanted]
        assert list(compose(**added)) == list(added.values())

    def test_compose_names_objects_that_are_no_transform(self):
        with pytest.raises(ValueError, match=r"transforms\.pool=42: must be"):
            compose(pool=42)

    def test_whole_pipeline_in_one_env(self):
        env = TransformedEnv(
            RoomEnv(num_beams=1440),
            compose(
                min_pool=MinPool(),
                scan_history=ScanHistory(),
                icp_align=ICPAlign(),
                tagd=TAGD(),
                waypoints=Waypoints(),
                normalize=Normalize(),
            ),
        )
        following = env.rollout(3)["next"]
        assert following[keys.SPATIAL_INPUT].shape[-2:] == (180, 2)
        assert following[keys.TEMPORAL_INPUT].shape[-2:] == (30, 4)
        assert following[keys.WAYPOINTS_SCALED].shape[-2:] == (5, 2)

    def test_foreign_vector_environment_is_supported(self):
        env = GymWrapper(StrangersEnv(), device="cpu")
        env = TransformedEnv(env, Compose(*strangers_scan(), strangers_icp()))
        assert env.rollout(5)["next", "ok"].any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MinPool(0), "group_size.*0"),
        (lambda: MinPool(max_range=-1.0), "max_range.*-1"),
        (lambda: MinPool(bearing="edge"), "bearing.*'edge'"),
        (lambda: MinPool(out_keys=["points"]), "out_keys=.*: must be 3 keys.*optionally seen"),
        (lambda: ScanHistory(in_keys=["a"], out_keys=["b", "c"]), "out_keys"),
        (lambda: RangeHistory(num_scans=0), "num_scans=0"),
        (lambda: RangeHistory(max_range=0.0), "max_range=0.0"),
        (lambda: RangeHistory(in_keys=["points"]), "must be two each"),
        (lambda: ICPAlign(method="odometry"), "method.*odometry"),
        (lambda: ICPAlign(gate=0.0), "gate.*0.0"),
        (lambda: ICPAlign(metric="plane"), "metric.*'plane'"),
        (lambda: ICPAlign(min_pairs=1), "min_pairs.*1"),
        (lambda: ICPAlign(search_range=4.0), "search_range.*4.0"),
        (lambda: TAGD(num_groups=0), "num_groups.*0"),
        (lambda: TAGD(group_radius=-0.1), "group_radius.*-0.1"),
        (lambda: TAGD(empty_previous="nan"), "empty_previous.*'nan'"),
        (lambda: Waypoints(num_waypoints=0), "num_waypoints.*0"),
        (lambda: Waypoints(spacing=0.0), "spacing.*0.0"),
        (lambda: Waypoints(ahead=0.0), "ahead.*0.0"),
        (lambda: Waypoints(in_keys=["pose"]), "in_keys=.*: must be 2 keys"),
        (lambda: Normalize(scale=0.0), "scale.*0.0"),
        (lambda: Normalize(in_keys=["a", "b"], out_keys=["c"]), "out_keys=.*: must be 2 keys"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_unrelated_entries_are_unchanged():
    data = TensorDict({"ranges": torch.rand(3, 16), "mine": torch.ones(3)}, [3])
    assert (MinPool(group_size=2)(data)["mine"] == 1).all()
