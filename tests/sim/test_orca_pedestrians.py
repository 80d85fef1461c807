"""ORCA pedestrians avoid the robot if they see it, walls and each other."""

import dataclasses

import numpy as np
import pytest
import torch
from scenes import pack, scene, walker

from navrl.sim import BatchedSimulator, Contact, DifferentialDrive, Lidar, OrcaPedestrians
from navrl.worlds import Pedestrian, ScenarioBatch

pytest.importorskip("pyrvo")


def play(scenario, steps, simulator=BatchedSimulator, command=(0.0, 0.0), **options):
    model = OrcaPedestrians(**options)
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


def test_pedestrian_walks_around_a_robot_that_it_sees():
    _, states = play(ONCOMING, 30)
    assert states[-1].contact.tolist() == [Contact.NONE]
    assert clearance(states) > 0.178 + 0.15
    assert states[-1].pedestrians[0, 0, 0] < -1.0  # it has passed


def test_pedestrian_does_not_react_to_an_unseen_robot():
    _, states = play(ONCOMING, 30, sees_robot=False)
    assert states[-1].contact.tolist() == [Contact.HIT_BY_PEDESTRIAN]


def test_pedestrians_avoid_each_other_and_walls():
    people = [walker((3.0, 2.0), (-3.0, 2.0)), walker((-3.0, 2.0), (3.0, 2.0))]
    walls = [(0.0, 1.2, 3.0, 0.05, 0.0), (0.0, 3.0, 3.0, 0.05, 0.0)]
    _, states = play(scene(walls, pedestrians=people), 40)
    places = torch.stack([s.pedestrians[0, :2, :2] for s in states])
    assert (places[:, 0] - places[:, 1]).norm(dim=-1).min() > 0.35
    assert places[..., 1].min() > 1.25 + 0.15 - 0.02
    assert places[..., 1].max() < 2.95 - 0.15 + 0.02


def test_pedestrian_turns_at_the_end_of_its_route():
    _, states = play(scene(pedestrians=[walker((2.0, 2.0), (2.0, 4.0))]), 60)
    y = torch.stack([s.pedestrians[0, 0, 1] for s in states])
    assert y.max() > 3.5
    assert y[y.argmax() :].min() < 2.5


def test_tracked_and_stationary_pedestrians_do_not_react():
    track = Pedestrian.tracked(np.array([0.0, 4.0]), np.array([[2.0, -2.0], [2.0, 2.0]]))
    still = Pedestrian(np.array([[2.5, 1.0]]), 0.0, 0.0)
    _, states = play(scene(pedestrians=[track, still, walker((4.0, 2.0), (1.0, -1.0))]), 10)
    assert states[-1].pedestrians[0, 0, :2].tolist() == pytest.approx([2.0, 0.0], abs=1e-5)
    assert states[-1].pedestrians[0, 1, :2].tolist() == pytest.approx([2.5, 1.0])


def test_both_simulators_have_the_same_orca_pedestrians():
    pytest.importorskip("pybullet")
    from navrl.sim import BulletSimulator

    person = dataclasses.replace(walker((3.0, 0.5), (-3.0, 0.0)), body="legs")
    scenario = scene([(0.0, 2.0, 3.0, 0.05, 0.0)], pedestrians=[person, walker((0, -3), (0, 3))])
    _, first = play(scenario, 20, command=(0.3, 0.4))
    sim, second = play(scenario, 20, BulletSimulator, command=(0.3, 0.4))
    sim.close()
    for a, b in zip(first, second, strict=True):
        torch.testing.assert_close(a.pedestrians, b.pedestrians, atol=1e-4, rtol=0, equal_nan=True)
        assert a.contact.tolist() == b.contact.tolist()


def test_orca_pedestrians_continue_from_a_stored_state():
    sim, _ = play(ONCOMING, 12)
    state = sim.state_dict()
    wanted = [sim.step(torch.zeros(1, 2)).pedestrians for _ in range(10)]
    other = BatchedSimulator(
        1,
        DifferentialDrive(),
        Lidar(num_beams=8, noise="none"),
        pedestrians=OrcaPedestrians(),
        max_pedestrians=4,
    )
    other.load_state_dict(state)
    for expected in wanted:
        got = other.step(torch.zeros(1, 2)).pedestrians
        assert torch.equal(got.nan_to_num(9.0), expected.nan_to_num(9.0))


def test_values_out_of_range_raise():
    with pytest.raises(ValueError, match=r"margin=-0\.1: must be >= 0"):
        OrcaPedestrians(margin=-0.1)
    with pytest.raises(ValueError, match="time_horizon=0"):
        OrcaPedestrians(time_horizon=0)


def test_share_of_episodes_reacts_and_the_others_follow_their_routes():
    scenes = [dataclasses.replace(ONCOMING, noise_seed=seed) for seed in range(40)]
    model = OrcaPedestrians(share=0.5)
    lidar = Lidar(num_beams=8, noise="none")
    sim = BatchedSimulator(40, DifferentialDrive(), lidar, pedestrians=model, max_pedestrians=4)
    sim.reset(torch.arange(40), ScenarioBatch.pack(scenes))
    for _ in range(20):
        state = sim.step(torch.zeros(40, 2))
    follows = state.contact == Contact.HIT_BY_PEDESTRIAN
    scripted = model.rows["walks"][:, 0].logical_not()
    assert torch.equal(follows, scripted)
    assert 10 <= int(follows.sum()) <= 30


def test_share_beyond_one_is_rejected():
    with pytest.raises(ValueError, match=r"share=1\.5: must be in \[0, 1\]"):
        OrcaPedestrians(share=1.5)
