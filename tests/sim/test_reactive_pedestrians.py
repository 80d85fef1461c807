"""Reactive pedestrians avoid the robot if they see it, walls and each other."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch
from scenes import pack, random_scene, scene, walker

from navrl.sim import (
    BatchedSimulator,
    Contact,
    DifferentialDrive,
    Lidar,
    OrcaPedestrians,
    SocialForcePedestrians,
)
from navrl.worlds import Pedestrian, ScenarioBatch


@pytest.fixture(params=["orca", "social_force"])
def kind(request):
    """Class of pedestrians."""
    if request.param == "social_force":
        return SocialForcePedestrians
    pytest.importorskip("pyrvo")
    return OrcaPedestrians


def play(kind, scenario, steps, simulator=BatchedSimulator, command=(0.0, 0.0), **options):
    model = kind(**options)
    lidar = Lidar(num_beams=8, noise="none")
    sim = simulator(1, DifferentialDrive(), lidar, pedestrians=model, max_pedestrians=4)
    sim.reset(torch.tensor([0]), pack(scenario))
    states = [sim.state()]
    states += [sim.step(torch.tensor([command])) for _ in range(steps)]
    return sim, states


def clearance(states):
    offset = torch.stack([s.pedestrians[0, :, :2] - s.pose[0, :2] for s in states])
    return offset.norm(dim=-1).nan_to_num(9.0).min().item()


ONCOMING = scene(pedestrians=[walker((3.0, 0.0), (-3.0, 0.0), speed=0.8)])


def test_pedestrian_walks_around_a_robot_that_it_sees(kind):
    _, states = play(kind, ONCOMING, 38)
    assert states[-1].contact.tolist() == [Contact.NONE]
    assert clearance(states) > 0.178 + 0.15
    assert states[-1].pedestrians[0, 0, 0] < -1.0  # it has passed


CROSSING, OVERTAKING = ((1.5, -2.5), (1.5, 2.5)), ((-2.0, 0.1), (5.0, 0.1))


@pytest.mark.parametrize("route", [CROSSING, OVERTAKING], ids=["crossing", "overtaking"])
def test_feet_do_not_hit_a_robot_that_drives(kind, route):
    for speed, offset in itertools.product((0.5, 0.8, 1.0), (0.0, 0.2, 0.4)):  # m/s, m of the gait
        person = dataclasses.replace(walker(*route, speed=speed, offset=offset), body="legs")
        _, states = play(kind, scene(pedestrians=[person]), 25, command=(0.5, 0.0))
        assert states[-1].contact.tolist() == [Contact.NONE]


def test_feet_of_tracked_pedestrians_do_not_count(kind):
    far = Pedestrian.tracked(np.array([90.0, 91.0]), np.array([[30.0, 0.0], [33.0, 0.0]]))
    far = dataclasses.replace(far, body="legs")
    near = [walker((3.0, 0.0), (-3.0, 0.0), speed=0.8)]
    least = [clearance(play(kind, scene(pedestrians=near + more), 38)[1]) for more in ([], [far])]
    assert least[0] == least[1]


def test_pedestrian_does_not_react_to_an_unseen_robot(kind):
    _, states = play(kind, ONCOMING, 30, sees_robot=False, sidestep=0.0)
    assert states[-1].contact.tolist() == [Contact.HIT_BY_PEDESTRIAN]


def test_pedestrian_is_pushed_less_from_behind():
    leaving = scene(pedestrians=[walker((0.6, 0.0), (6.0, 0.0), speed=0.6)])

    def advance(**options):
        _, states = play(SocialForcePedestrians, leaving, 5, sidestep=0.0, **options)
        return states[-1].pedestrians[0, 0, 0].item()

    alone = advance(sees_robot=False)
    pushed = advance(rear=1.0) - alone
    assert pushed > 0.02
    assert 0.0 < advance(rear=0.0) - alone < 0.5 * pushed  # at rest it looks nowhere


def test_wall_pushes_a_pedestrian_off():
    along = walker((-2.0, 0.3), (6.0, 0.3), speed=0.6)
    wall = [(2.0, 0.0, 5.0, 0.05, 0.0)]  # 0.1 m beside the pedestrian, whose route pulls it back
    alone = {"sees_robot": False, "sidestep": 0.0}
    _, beside = play(SocialForcePedestrians, scene(wall, pedestrians=[along]), 10, **alone)
    _, free = play(SocialForcePedestrians, scene(pedestrians=[along]), 10, **alone)
    y = [states[-1].pedestrians[0, 0, 1].item() for states in (beside, free)]
    assert y[1] == pytest.approx(0.3, abs=0.001)
    assert y[0] > 0.31


def test_pedestrians_avoid_each_other_and_walls(kind):
    people = [walker((3.0, 2.0), (-3.0, 2.0)), walker((-3.0, 2.0), (3.0, 2.0))]
    walls = [(0.0, 1.2, 3.0, 0.05, 0.0), (0.0, 3.0, 3.0, 0.05, 0.0)]
    _, states = play(kind, scene(walls, pedestrians=people), 40)
    places = torch.stack([s.pedestrians[0, :2, :2] for s in states])
    assert (places[:, 0] - places[:, 1]).norm(dim=-1).min() > 0.35
    assert places[..., 1].min() > 1.25 + 0.15 - 0.02
    assert places[..., 1].max() < 2.95 - 0.15 + 0.02


def test_pedestrian_turns_at_the_end_of_its_route(kind):
    _, states = play(kind, scene(pedestrians=[walker((2.0, 2.0), (2.0, 4.0))]), 60)
    y = torch.stack([s.pedestrians[0, 0, 1] for s in states])
    assert y.max() > 3.5
    assert y[y.argmax() :].min() < 2.5


def test_tracked_and_stationary_pedestrians_do_not_react(kind):
    track = Pedestrian.tracked(np.array([0.0, 4.0]), np.array([[2.0, -2.0], [2.0, 2.0]]))
    still = Pedestrian(np.array([[2.5, 1.0]]), 0.0, 0.0)
    _, states = play(kind, scene(pedestrians=[track, still, walker((4.0, 2.0), (1.0, -1.0))]), 10)
    assert states[-1].pedestrians[0, 0, :2].tolist() == pytest.approx([2.0, 0.0], abs=1e-5)
    assert states[-1].pedestrians[0, 1, :2].tolist() == pytest.approx([2.5, 1.0])


def test_both_simulators_have_the_same_reactive_pedestrians(kind):
    pytest.importorskip("pybullet")
    from navrl.sim import BulletSimulator

    person = dataclasses.replace(walker((3.0, 0.5), (-3.0, 0.0)), body="legs")
    scenario = scene([(0.0, 2.0, 3.0, 0.05, 0.0)], pedestrians=[person, walker((0, -3), (0, 3))])
    _, first = play(kind, scenario, 20, command=(0.3, 0.4))
    sim, second = play(kind, scenario, 20, BulletSimulator, command=(0.3, 0.4))
    sim.close()
    for a, b in zip(first, second, strict=True):
        torch.testing.assert_close(a.pedestrians, b.pedestrians, atol=1e-4, rtol=0, equal_nan=True)
        assert a.contact.tolist() == b.contact.tolist()


def test_reactive_pedestrians_continue_from_a_stored_state(kind):
    sim, _ = play(kind, ONCOMING, 12)
    state = sim.state_dict()
    wanted = [sim.step(torch.zeros(1, 2)).pedestrians for _ in range(10)]
    other = BatchedSimulator(
        1,
        DifferentialDrive(),
        Lidar(num_beams=8, noise="none"),
        pedestrians=kind(),
        max_pedestrians=4,
    )
    other.load_state_dict(state)
    for expected in wanted:
        got = other.step(torch.zeros(1, 2)).pedestrians
        assert torch.equal(got.nan_to_num(9.0), expected.nan_to_num(9.0))


def test_pedestrians_do_not_depend_on_the_other_worlds(kind):
    """The worlds of a batch have other numbers of pedestrians, walls and rounding positions."""
    generator = np.random.default_rng(5)
    scenes = [random_scene(generator, num_walkers=k) for k in (1, 4, 2, 3, 4)]
    lidar = Lidar(num_beams=8, noise="none")

    def states(chosen):
        sim = BatchedSimulator(
            len(chosen), DifferentialDrive(), lidar, pedestrians=kind(), max_pedestrians=6
        )
        sim.reset(torch.arange(len(chosen)), pack(*chosen))
        return torch.stack([sim.step(torch.zeros(len(chosen), 2)).pedestrians for _ in range(30)])

    together = states(scenes)
    for index, one in enumerate(scenes):
        alone = states([one])[:, 0]
        assert torch.equal(alone.nan_to_num(9.0), together[:, index].nan_to_num(9.0))


def test_values_out_of_range_raise():
    pytest.importorskip("pyrvo")
    with pytest.raises(ValueError, match=r"margin=-0\.1: must be >= 0"):
        OrcaPedestrians(margin=-0.1)
    with pytest.raises(ValueError, match="time_horizon=0"):
        OrcaPedestrians(time_horizon=0)


def test_values_of_social_forces_out_of_range_raise():
    with pytest.raises(ValueError, match=r"rear=1\.5: must be in \[0, 1\]"):
        SocialForcePedestrians(rear=1.5)
    with pytest.raises(ValueError, match="reach=0: must be positive"):
        SocialForcePedestrians(reach=0)
    with pytest.raises(ValueError, match=r"sidestep=2\.0: must be within"):
        SocialForcePedestrians(sidestep=2.0)


def test_acceleration_at_contact_and_at_one_reach():
    """Right in front of a wall: 25 m/s^2 at contact, 25 / e at a gap of ``reach``."""
    model, still = SocialForcePedestrians(rear=1.0), torch.zeros(1, 1, 2, dtype=torch.float64)
    at = torch.tensor([[[1.0, 0.0]]], dtype=torch.float64)
    for gap, wanted in ((0.0, 25.0), (0.08, 25.0 / np.e), (0.16, 25.0 / np.e**2)):
        radius = torch.full((1, 1), 1.0 - gap, dtype=torch.float64)
        push = model._push(at, still, torch.zeros_like(at), radius)
        assert push[0, 0].tolist() == pytest.approx([wanted, 0.0])


def test_share_of_episodes_has_reactive_pedestrians(kind):
    scenes = [dataclasses.replace(ONCOMING, noise_seed=seed) for seed in range(40)]
    model = kind(share=0.5)
    lidar = Lidar(num_beams=8, noise="none")
    sim = BatchedSimulator(40, DifferentialDrive(), lidar, pedestrians=model, max_pedestrians=4)
    sim.reset(torch.arange(40), ScenarioBatch.pack(scenes))
    for _ in range(20):
        state = sim.step(torch.zeros(40, 2))
    follows = state.contact == Contact.HIT_BY_PEDESTRIAN
    scripted = model.rows["walks"][:, 0].logical_not()
    assert torch.equal(follows, scripted)
    assert 10 <= int(follows.sum()) <= 30


def test_share_beyond_one_is_rejected(kind):
    with pytest.raises(ValueError, match=r"share=1\.5: must be in \[0, 1\]"):
        kind(share=1.5)
