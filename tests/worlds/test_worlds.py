"""Scenarios are sound, determined by their numbers, and the same in every form."""

import dataclasses
import math
import multiprocessing
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly import mostly

from navrl.worlds import (
    Corridor,
    Intersection,
    Office,
    Pedestrian,
    Scenario,
    ScenarioBatch,
    ScenarioDistribution,
    ScenarioPool,
    Suite,
    WeightedWorld,
    pedestrian_boxes,
)

WORLDS = {"corridor": Corridor(), "intersection": Intersection(), "office": Office()}
ROBOT_RADIUS = 0.178


def distribution(*kinds, **options) -> ScenarioDistribution:
    chosen = {kind: WeightedWorld(WORLDS[kind]) for kind in kinds or WORLDS}
    return ScenarioDistribution(chosen, **options)


def box_distance(points: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Distance of each point to the nearest axis-aligned box, zero inside."""
    gap = np.abs(points[:, None] - boxes[None, :, :2]) - boxes[None, :, 2:4]
    return np.linalg.norm(gap.clip(min=0), axis=-1).min(axis=1)


@pytest.mark.parametrize("kind", WORLDS)
@settings(max_examples=40, deadline=None)
@given(index=st.integers(0, 10**6))
def test_every_scenario_is_valid(kind, index):
    scenario = distribution(kind, num_dynamic=(2, 8)).sample("sound", 1, index)
    path, boxes = scenario.path, scenario.boxes
    assert scenario.kind == kind
    np.testing.assert_allclose(path[0], scenario.start[:2])
    np.testing.assert_allclose(path[-1], scenario.goal)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert step.max() <= 0.101
    dense = np.concatenate([path, (path[1:] + path[:-1]) / 2])
    assert box_distance(dense, boxes).min() > ROBOT_RADIUS + 0.02
    ahead = path[3] - path[0]
    assert abs(np.angle(np.exp(1j * (scenario.start[2] - np.arctan2(*ahead[::-1]))))) < 1e-6
    assert np.linalg.norm(scenario.goal - scenario.start[:2]) > 2.0


@pytest.mark.parametrize("kind", WORLDS)
@settings(max_examples=25, deadline=None)
@given(index=st.integers(0, 10**6))
def test_pedestrians_keep_distance_from_walls_and_start(kind, index):
    scenario = distribution(kind, num_dynamic=(3, 8)).sample("people", 1, index)
    for person in scenario.pedestrians:
        route = person.route
        if len(route) > 1:
            share = np.linspace(0, 1, 50)[:, None]
            route = np.concatenate(
                [a + share * (b - a) for a, b in zip(route, route[1:], strict=False)]
            )
        assert box_distance(route, scenario.boxes).min() > 0.1
        assert person.is_static or 0.5 <= person.speed <= 1.0
    now = pedestrian_boxes(ScenarioBatch.pack([scenario]), torch.zeros(1))[0]
    gap = (now[:, :2] - torch.from_numpy(scenario.start[:2])).norm(dim=-1)
    assert gap.min() >= 1.1
    first = scenario.pedestrians[0].route
    near = np.linalg.norm(first[:, None] - scenario.path[None], axis=-1).min()
    assert near < 0.3, "the first pedestrian walks the robot's own path"


def test_dimensions_equal_the_papers():
    for index in range(30):
        corridor = clear_size(distribution("corridor").sample("size", 0, index).boxes)
        assert 6.0 <= corridor.max() <= 8.0
        assert 2.0 <= corridor.min() <= 2.5
        office = clear_size(distribution("office").sample("size", 0, index).boxes)
        np.testing.assert_allclose(office, OUTER_OFFICE)


OUTER_OFFICE = 6.8  # m inside of walls 0.1 m thick, 7 m outside


def clear_size(boxes):
    """Free extent (x, y) between the outermost walls."""
    low = (boxes[:, :2] - boxes[:, 2:4]).min(0)
    return (boxes[:, :2] + boxes[:, 2:4]).max(0) - low - 0.2


def test_counts_follow_their_ranges():
    d = distribution(num_dynamic=(1, 3), num_static=(1, 2))
    people = [d.sample("count", 0, k).pedestrians for k in range(60)]
    assert {sum(not p.is_static for p in s) for s in people} == {1, 2, 3}
    assert {sum(p.is_static for p in s) for s in people} == {1, 2}
    for s in people:  # dynamic first
        assert sorted(s, key=lambda p: p.is_static) == list(s)


def test_scenario_does_not_depend_on_processes():
    suite = Suite("same", 3, 40, distribution())
    alone = suite.scenarios()
    assert [s.to_json() for s in suite.scenarios(num_workers=2)] == [s.to_json() for s in alone]
    code = (
        "from navrl.config import compose, instantiate\n"
        "from navrl.worlds import *\n"
        "d = ScenarioDistribution({'corridor': WeightedWorld(Corridor()), "
        "'intersection': WeightedWorld(Intersection()), 'office': WeightedWorld(Office())})\n"
        "print(Suite('same', 3, 40, d).hash())"
    )
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == suite.hash()


def test_hash_tolerates_only_the_last_bit():
    """Processors differ in an arctangent's last bit: one episode of twenty has another yaw."""
    scenario = distribution().sample("bits", 0, 1)

    def turned(yaw):
        return dataclasses.replace(scenario, start=np.array([*scenario.start[:2], yaw]))

    for other in np.nextafter(scenario.start[2], [-9.0, 9.0]):
        assert turned(other).to_json() != scenario.to_json()
        assert turned(other).fingerprint() == scenario.fingerprint()
    assert turned(scenario.start[2] + 2e-6).fingerprint() != scenario.fingerprint()
    assert turned(-0.0).fingerprint() == turned(0.0).fingerprint()


@pytest.mark.parametrize("core", mostly(["Prescott", "SkylakeX"], ["Prescott"]))
def test_scenarios_do_not_depend_on_blas_rounding(core):
    """An episode whose people differed when a vector's length was left to BLAS."""
    code = (
        "from navrl.config import compose, instantiate\n"
        "suite = instantiate(compose('evaluate', ['suite=density_office']).suite)\n"
        "suite.scenarios([517])"  # refused if it is not the frozen one
    )
    environment = {**os.environ, "OPENBLAS_CORETYPE": core}
    done = subprocess.run([sys.executable, "-c", code], env=environment)
    if done.returncode == -signal.SIGILL:
        pytest.skip(f"this processor lacks instructions of {core}")
    assert done.returncode == 0


def test_any_of_suite_seed_and_index_changes_the_scenario():
    d = distribution("corridor")
    base = d.sample("a", 0, 0)
    for other in (d.sample("b", 0, 0), d.sample("a", 1, 0), d.sample("a", 0, 1)):
        assert not np.array_equal(base.path, other.path)
        assert base.noise_seed != other.noise_seed


def test_json_round_trip_is_exact(tmp_path):
    scenario = distribution().sample("json", 0, 5)
    scenario.save(tmp_path / "one.json")
    again = Scenario.load(tmp_path / "one.json")
    assert again.to_json() == scenario.to_json()
    assert np.array_equal(again.path, scenario.path)
    with pytest.raises(ValueError, match="format"):
        Scenario.from_json("{}")


def test_motion_in_closed_form_equals_small_steps():
    rng = np.random.default_rng(0)
    for _ in range(10):
        route = rng.uniform(-3, 3, (6, 2))
        length = np.linalg.norm(np.diff(route, axis=0), axis=1).sum()
        person = Pedestrian(route, 0.7, rng.uniform(0, 2 * length))
        base = distribution("corridor").sample("move", 0, 0)
        scenario = Scenario(**{**vars(base), "pedestrians": (person,)})
        batch = ScenarioBatch.pack([scenario])
        position = walk(route, person.offset, 0.7, 9.5)
        got = pedestrian_boxes(batch, torch.tensor([9.5]))[0, 0, :2]
        np.testing.assert_allclose(got, position, atol=2e-3)


def walk(route, offset, speed, duration, step=1e-4):
    """Step along the route, turning round at its ends."""
    legs = np.linalg.norm(np.diff(route, axis=0), axis=1)
    total, along = legs.sum(), offset
    forward = along <= total
    along = along if forward else 2 * total - along
    for _ in range(round(duration / step)):
        along += speed * step * (1 if forward else -1)
        if along > total:
            along, forward = 2 * total - along, False
        elif along < 0:
            along, forward = -along, True
    ends = np.concatenate([[0], legs.cumsum()])
    return np.array([np.interp(along, ends, route[:, k]) for k in range(2)])


def test_level_limits_dynamic_pedestrians_only():
    batch = ScenarioBatch.pack(
        [distribution(num_dynamic=(8, 8)).sample("level", 0, k) for k in range(4)]
    )
    fewer = batch.with_num_dynamic(torch.tensor([0, 1, 5, 9]))
    dynamic = (fewer.ped_present & ~fewer.ped_static).sum(-1)
    assert dynamic.tolist() == [0, 1, 5, 8]
    assert torch.equal((fewer.ped_present & fewer.ped_static), batch.ped_present & batch.ped_static)


def test_pool_draws_are_reproducible_and_cached(tmp_path):
    suite = Suite("pool", 0, 12, distribution("corridor", num_dynamic=(8, 8)))
    first = ScenarioPool(suite, cache=tmp_path / "pool.npz", empty_share=0.5)
    second = ScenarioPool(suite, cache=tmp_path / "pool.npz", empty_share=0.5)
    assert second.batch.kinds == first.batch.kinds != ()
    draws = [
        pool.draw(torch.Generator().manual_seed(4), 200, max_dynamic=2) for pool in (first, second)
    ]
    for name, value in draws[0].tensors().items():
        assert torch.equal(value, draws[1].tensors()[name]), name
    dynamic = (draws[0].ped_present & ~draws[0].ped_static).sum(-1)
    assert set(dynamic.tolist()) == {0, 1, 2}
    empty = (~draws[0].ped_present.any(-1)).float().mean()
    assert 0.35 < empty < 0.65
    other = Suite("pool", 1, 12, suite.distribution)
    changed = ScenarioPool(other, cache=tmp_path / "pool.npz")
    assert not torch.equal(changed.batch.start, first.batch.start)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Corridor(length=(8, 6)), r"length=\[8, 6\]"),
        (lambda: Office(door=3.0), r"door=3.0"),
        (lambda: distribution("corridor", speed=(1.0, 0.5)), r"speed=\[1.0, 0.5\]"),
        (lambda: distribution("corridor", speed=(0.5,)), r"speed=\[0.5\]: must be two"),
        (lambda: distribution("corridor", speed=0.5), r"speed=0.5: must be two"),
        (lambda: distribution("corridor", speed=(0.5, 1.0, 2.0)), r"speed=.*: must be two"),
        (lambda: distribution("corridor", speed=(0.5, math.inf)), r"speed=.*: must be two finite"),
        (lambda: distribution("corridor", num_static=(0, math.inf)), r"num_static=.* two finite"),
        (lambda: distribution("corridor", num_dynamic=2), r"num_dynamic=2: must be two"),
        (lambda: distribution("corridor", half_size=0.2), r"half_size=0.2: must be two"),
        (lambda: distribution("corridor", half_size=(0.2, math.nan)), r"half_size=.*nan.*: must"),
        (lambda: distribution("corridor", keep_dynamic=0.5), r"keep_dynamic=0.5: must be an int"),
        (lambda: ScenarioDistribution({"x": None}), "weights"),
        (lambda: Suite("s", -1, 5, distribution()), "seed=-1"),
        (lambda: Suite("s", 0, 5, distribution()).scenarios([5]), "index 5"),
        (lambda: ScenarioBatch.pack([]), "at least one"),
        (lambda: Pedestrian(np.zeros((40, 2)), 1.0, 0.0), "route"),
    ],
)
def test_bad_arguments_are_named(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_pool_is_generated_again_after_a_change_in_a_subfolder(tmp_path, monkeypatch):
    monkeypatch.setattr("navrl.worlds.pool.__file__", str(tmp_path / "pool.py"))
    code = tmp_path / "rooms" / "flat.py"
    code.parent.mkdir()
    code.write_text("DOOR = 0.8\n")
    cache, suite = tmp_path / "pool.npz", Suite("s", 0, 2, distribution())
    ScenarioPool(suite, cache=cache)
    written = cache.stat().st_mtime_ns
    ScenarioPool(suite, cache=cache)
    assert cache.stat().st_mtime_ns == written
    code.write_text("DOOR = 0.9\n")
    ScenarioPool(suite, cache=cache)
    assert cache.stat().st_mtime_ns > written


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_a_pool_draws_the_same_on_each_device(device):
    pool = ScenarioPool(Suite("s", 0, 4, distribution()), empty_share=0.5)
    moved = pool.to(device)
    one, other = (
        p.draw(torch.Generator().manual_seed(3), 9, max_dynamic=2).tensors() for p in (pool, moved)
    )
    assert all(value.device.type == device for value in other.values())
    assert all(torch.equal(value, other[name].cpu()) for name, value in one.items())


def test_daemonic_process_generates_without_children(monkeypatch):
    """Vector environments start daemonic processes, and those may not have children."""
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    assert len(Suite("train", 0, 40, distribution("corridor")).scenarios(num_workers=2)) == 40


def test_batch_lists_its_kinds():
    scenarios = [
        dataclasses.replace(distribution("office").sample("test", 0, 0), kind=kind)
        for kind in ("maze", "attic")
    ]
    batch = ScenarioBatch.pack(scenarios)
    assert [batch.kind_of(row) for row in range(2)] == ["maze", "attic"]
    assert batch[torch.tensor([1])].to("cpu").kind_of(0) == "attic"
    assert ScenarioBatch.from_tensors(batch.tensors()).kind_of(0) == "other"
