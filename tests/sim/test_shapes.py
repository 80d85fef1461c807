"""Discs, heights, legs and tracks: known values, and the same on both simulators."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from scenes import pack, scene, walker

from navrl.ops.gait import foot_offset, step_length
from navrl.sim import BatchedSimulator, Contact, Delays, DifferentialDrive, Lidar
from navrl.worlds import Pedestrian, ScenarioBatch, pedestrian_states

SPINNING = Delays(scan_age_s=0.06, revolution_s=0.1)


def simulator(num_worlds=1, height=0.5, **options):
    lidar = Lidar(num_beams=360, noise="none", height=height)
    return BatchedSimulator(num_worlds, DifferentialDrive(), lidar, **options)


def furnished(discs=(), heights=(), **others):
    return dataclasses.replace(
        scene(**others),
        discs=np.array(discs, dtype=float).reshape(-1, 3),
        heights=np.array(heights, dtype=float).reshape(-1, 2),
    )


def drive(sim, batch, command, steps):
    sim.reset(torch.arange(len(batch)), batch)
    for _ in range(steps):
        sim.step(torch.tensor([command] * len(batch)))
    return sim.state()


def test_lidar_reads_the_surface_of_a_disc():
    sim = simulator()
    sim.reset(torch.arange(1), pack(furnished(discs=[(2.0, 0.0, 0.5)])))
    ranges = sim.ranges()[0].double()
    angle = torch.arange(360).double() * (2 * math.pi / 360)
    inside = 0.25 - (2.0 * angle.sin()) ** 2
    wanted = torch.where(
        (inside >= 0) & (angle.cos() > 0), 2.0 * angle.cos() - inside.clamp_min(0).sqrt(), 3.5
    )
    torch.testing.assert_close(ranges, wanted, atol=1e-6, rtol=0)
    assert int((ranges < 3.5).sum()) == 29  # asin(0.25) is 14.5 degrees to each side


def test_robot_stops_at_the_surface_of_a_disc():
    batch = pack(furnished(discs=[(1.0, 0.0, 0.3)]))
    state = drive(simulator(), batch, (1.0, 0.0), 5)
    assert state.contact.tolist() == [Contact.STATIC]
    assert 1.0 - 0.3 - 0.178 - 1e-6 <= state.pose[0, 0] <= 1.0 - 0.3 - 0.178 + 0.02


@pytest.mark.parametrize(
    ("span", "seen", "touched"),
    [
        ((0.0, 2.0), True, True),
        ((0.0, 0.2), False, True),
        ((0.2, 2.0), True, True),  # the lidar is at its bottom
        ((0.0, 0.21), True, True),
        ((0.7, 0.75), False, False),  # a table top, under which the robot passes
        ((0.45, 0.5), False, True),
    ],
)
def test_heights_determine_visibility_and_contact(span, seen, touched):
    box = furnished(boxes=[(1.0, 0.0, 0.1, 1.0, 0.3)], heights=[span])
    disc = furnished(discs=[(1.0, 0.0, 0.3)], heights=[span])
    sim = simulator(2, height=0.2)
    sim.reset(torch.arange(2), pack(box, disc))
    assert ((sim.ranges() < 3.5).any(-1) == seen).all()
    contact = drive(sim, pack(box, disc), (1.0, 0.0), 5).contact
    assert ((contact == Contact.STATIC) == touched).all()


def test_foot_is_planted_in_its_stance_and_continuous():
    phase = np.linspace(0.0, 4.0, 4001)
    offset = np.array([foot_offset(value, 0.7) for value in phase])
    place = offset + 0.7 * phase  # in the world
    planted = (phase + 0.6) % 2.0 < 1.2
    moves = np.diff(place)[planted[1:] & planted[:-1]]
    assert np.abs(moves).max() < 1e-9
    assert (np.diff(place) > -1e-9).all()
    assert np.abs(np.diff(place)).max() < 0.005
    assert place[-1] - place[0] == pytest.approx(4 * 0.7)


def test_lidar_sees_two_legs_and_the_hull_touches_the_body():
    person = Pedestrian(np.array([[1.0, 0.0]]), 0.0, 0.0, (0.2, 0.2), body="legs", leg_radius=0.06)
    sim = simulator()
    batch = pack(scene(pedestrians=[person], start=(0.0, 0.0, 0.0)))
    sim.reset(torch.arange(1), batch)
    ranges = sim.ranges()[0]
    assert ranges[0] == 3.5  # between the legs
    assert ranges[5:].min() == pytest.approx(math.hypot(1.0, 0.09) - 0.06, abs=1e-3)
    state = drive(sim, batch, (1.0, 0.0), 5)
    assert state.contact.tolist() == [Contact.PEDESTRIAN]
    assert state.pose[0, 0] == pytest.approx(1.0 - 0.2 - 0.178, abs=0.02)


def test_swinging_leg_touches_beyond_the_body():
    person = walker((0.0, -2.0), (0.0, 2.0), speed=1.0, offset=1.0, half_size=(0.1, 0.1))
    person = dataclasses.replace(person, body="legs")
    length = step_length(1.0)
    reach = max(foot_offset(value, length) for value in np.linspace(0, 2, 500)) + 0.07
    assert reach == pytest.approx(0.628 * length + 0.07, abs=1e-3)
    start = (0.0, reach + 0.178 - 0.05, 0.0)  # free of the body, not of its feet
    batch = pack(scene(pedestrians=[dataclasses.replace(person, offset=0.0)], start=start))
    state = drive(simulator(), batch, (0.0, 0.0), 15)
    assert state.contact.tolist() == [Contact.HIT_BY_PEDESTRIAN]
    assert float(state.pedestrians[0, 0, 1]) + 0.1 < start[1] - 0.178  # the leg was first


def test_tracked_pedestrian_appears_walks_and_leaves():
    times, places = np.array([0.5, 1.5, 2.0]), np.array([[1.0, 2.0], [1.0, 1.0], [1.0, 1.0]])
    batch = pack(scene(pedestrians=[Pedestrian.tracked(times, places)]))
    sim = simulator()
    sim.reset(torch.arange(1), batch)
    found = [sim.state().pedestrians[0, 0]]
    found += [sim.step(torch.zeros(1, 2)).pedestrians[0, 0] for _ in range(11)]
    found = torch.stack(found)
    present = ~found[:, 0].isnan()
    assert present.tolist() == [0.5 <= 0.2 * k + 1e-9 <= 2.0 + 1e-9 for k in range(12)]
    expected = [2.0 - min(0.2 * k - 0.5, 1.0) for k in range(3, 11)]
    assert found[present, 1].tolist() == pytest.approx(expected, abs=1e-6)
    assert torch.allclose(found[present, 4], torch.tensor(-math.pi / 2))  # heading is retained


def test_pedestrian_that_appears_at_the_robot_is_a_contact():
    track = Pedestrian.tracked(np.array([0.1, 5.0]), np.array([[0.2, 0.0], [0.2, 0.0]]))
    state = drive(simulator(), pack(scene(pedestrians=[track])), (0.0, 0.0), 1)
    assert state.contact.tolist() == [Contact.HIT_BY_PEDESTRIAN]
    assert float(state.time_s) == pytest.approx(0.1)


def mixed(index):
    """Boxes and discs at all heights, pedestrians of all bodies on routes and tracks."""
    generator = np.random.default_rng([8, index])
    places = generator.uniform(-4, 4, (40, 2))
    places = places[np.hypot(*places.T) > 1.0]
    half = len(places) // 2
    boxes = np.column_stack(
        [places[:half], generator.uniform(0.02, 0.3, (half, 2)), generator.uniform(-3, 3, half)]
    )
    discs = np.column_stack([places[half:], generator.uniform(0.03, 0.3, len(places) - half)])
    bottom = generator.uniform(0.0, 0.7, len(places)) * generator.integers(0, 2, len(places))
    heights = np.column_stack([bottom, bottom + generator.uniform(0.1, 1.0, len(places))])
    people = []
    for number, body in enumerate(("box", "disc", "legs", "legs", "disc")):
        route = np.cumsum(generator.uniform(-1.5, 1.5, (6, 2)), axis=0)
        radius = generator.uniform(0.1, 0.25)
        if number % 2:
            times = np.sort(generator.uniform(-1.0, 6.0, 6))
            person = Pedestrian.tracked(times, route, (radius, radius), body)
        else:
            person = walker(*route, speed=generator.uniform(0.3, 1.4), half_size=(radius, radius))
            person = dataclasses.replace(person, body=body)
        people.append(person)
    yaw = generator.uniform(-3, 3)
    return furnished(discs, heights, boxes=boxes, start=(0, 0, yaw), pedestrians=people)


@pytest.mark.parametrize("delays", [Delays(), SPINNING], ids=["now", "spinning"])
def test_simulators_agree_on_discs_heights_legs_and_tracks(delays):
    pytest.importorskip("pybullet")
    from navrl.sim import BulletSimulator

    count, lidar = 12, Lidar(num_beams=360, noise="none", height=0.3)
    batch = ScenarioBatch.pack([mixed(index) for index in range(count)])
    fast = BatchedSimulator(count, DifferentialDrive(), lidar, delays=delays)
    generator = torch.Generator().manual_seed(3)
    differing = contacts = 0
    with BulletSimulator(count, DifferentialDrive(), lidar, delays=delays) as checked:
        for sim in (fast, checked):
            sim.reset(torch.arange(count), batch)
        for _ in range(25):
            error = (fast.ranges() - checked.ranges()).abs()
            differing += int((error > 3e-3).sum())
            command = torch.rand(count, 2, generator=generator) * torch.tensor([1.0, 3.0])
            command = command - torch.tensor([0.0, 1.5])
            got, wanted = fast.step(command), checked.step(command)
            assert got.contact.tolist() == wanted.contact.tolist()
            for name in ("pose", "pedestrians", "time_s"):
                pair = getattr(got, name), getattr(wanted, name)
                torch.testing.assert_close(*pair, atol=1e-4, rtol=0, equal_nan=True)
        contacts = got.contact.bincount(minlength=4).tolist()
    assert differing <= 5e-3 * 25 * count * 360  # beams that graze the sides of a prism
    assert contacts[Contact.STATIC] >= 2
    assert contacts[Contact.PEDESTRIAN] + contacts[Contact.HIT_BY_PEDESTRIAN] >= 2


def test_grid_of_walls_changes_no_bit(monkeypatch):
    generator = np.random.default_rng(4)
    count = 900
    boxes = np.column_stack(
        [
            generator.uniform(-9, 9, (count, 2)),
            generator.uniform(0.02, 0.3, (count, 2)),
            generator.uniform(-3, 3, count),
        ]
    )
    boxes[:20, 2] = 2.0  # some that do not fit a cell
    boxes = boxes[np.hypot(boxes[:, 0], boxes[:, 1]) > 1.2]
    discs = np.column_stack([generator.uniform(2, 9, (60, 2)), generator.uniform(0.05, 0.2, 60)])
    scenes = [
        furnished(discs, boxes=boxes, start=(0, 0, 1.0)),
        furnished(boxes=boxes[::5], start=(0, 0, -2.0)),
        furnished(boxes=boxes[:40], start=(30.0, 30.0, 0.0)),  # too few, and outside
        furnished(discs, boxes=boxes[::3], start=(-40.0, 0.0, 0.0)),
    ]
    lidars = [
        Lidar(noise="none"),
        Lidar(num_beams=181, noise="none", angle_min=2.9, angle_increment=-0.0312),
        Lidar(num_beams=400, max_range=20.0, noise="none", mount=(0.1, 0.05, 2.0)),
    ]
    for lidar in lidars:
        for delays in (Delays(), SPINNING):
            outcomes = []
            for min_walls in (64, 10_000):
                monkeypatch.setattr("navrl.sim.obstacle_rows.MIN_WALLS", min_walls)
                sim = BatchedSimulator(4, DifferentialDrive(), lidar, delays=delays)
                sim.reset(torch.arange(4), pack(*scenes))
                draws = torch.Generator().manual_seed(0)
                seen = []
                for _ in range(30):
                    state = sim.step(torch.rand(4, 2, generator=draws) * torch.tensor([1.0, 0.5]))
                    seen += [sim.ranges(), state.pose, state.contact.float()]
                outcomes.append(seen)
            assert all(map(torch.equal, *outcomes))
            assert (outcomes[0][0] < lidar.max_range).any()
            assert (outcomes[0][-1] == Contact.STATIC).any()


def test_states_of_both_forms_agree():
    batch = ScenarioBatch.pack([mixed(index) for index in range(8)])
    sim = simulator(8)
    state = drive(sim, batch, (0.0, 0.0), 7)
    wanted = pedestrian_states(batch, state.time_s.double())
    got = sim.state_dict()["boxes"][:, : wanted.shape[1]]
    torch.testing.assert_close(got, wanted, atol=1e-6, rtol=0, equal_nan=True)
