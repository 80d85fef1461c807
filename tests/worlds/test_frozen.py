"""Frozen suites are what they were, and say so if not."""

import hashlib
import re

import numpy as np
import pytest

from navrl.build.suites import check_suites, suite_names
from navrl.cli.sweeps import SUITE_SWEEPS, expand_suites
from navrl.config import compose, instantiate
from navrl.worlds import FrozenSuite, SuiteMismatchError, check_frozen
from navrl.worlds.frozen import read_lock, write_lock


def suite(name, *overrides):
    return instantiate(compose("evaluate", [f"suite={name}", *overrides]).suite)


@pytest.fixture(scope="module")
def table1_200():
    frozen = suite("table1_200")
    return frozen, frozen.scenarios()


def test_every_suite_of_conf_is_frozen():
    assert set(read_lock()) == set(suite_names())
    for name, frozen in read_lock().items():
        own = suite(name)
        assert (own.name, own.num_episodes) == (name, frozen.episodes)
        assert re.fullmatch("[0-9a-f]{64}", frozen.sha256)


def test_the_first_episodes_ever_published_are_still_the_same(table1_200):
    digest, version = check_frozen(*table1_200)
    assert digest == "35c34ce28921d09a524d35743076c183f89677f3d5efe06cc19315349ac5719e"
    assert version == 1


def test_the_hash_is_of_the_scenarios_json(table1_200):
    frozen, scenarios = table1_200
    text = "".join(s.to_json() + "\n" for s in scenarios)
    assert check_frozen(frozen, scenarios)[0] == hashlib.sha256(text.encode()).hexdigest()


def test_a_changed_episode_is_an_error_that_names_both_hashes(table1_200):
    frozen, scenarios = table1_200
    other = suite("table1_200", "suite.seed=2025").scenarios([7])
    changed = [*scenarios[:7], *other, *scenarios[8:]]
    message = f"suite=table1_200: .*expected hash 35c34ce28921.*found {frozen.hash(changed)}"
    with pytest.raises(SuiteMismatchError, match=message):
        check_frozen(frozen, changed)


def test_a_suite_of_ones_own_is_not_checked(table1_200):
    frozen, scenarios = table1_200
    assert check_frozen(frozen, scenarios[:9])[1] is None  # other number of episodes
    frozen = suite("table1_200", "suite.name=mine", "suite.seed=3", "suite.num_episodes=2")
    assert check_frozen(frozen, frozen.scenarios())[1] is None


def test_points_of_a_sweep_differ_in_nothing_else():
    few = "suite.num_episodes=12"
    base = suite("table1", few).scenarios()
    for name in {name for names in SUITE_SWEEPS.values() for name in names}:
        for one, other in zip(base, suite(name, few).scenarios(), strict=True):
            assert np.array_equal(one.boxes, other.boxes), name
            assert np.array_equal(one.path, other.path), name
            walking = [p for p in other.pedestrians if not p.is_static]
            assert np.array_equal(one.pedestrians[0].route, walking[0].route), name
            if name.startswith("speed_"):
                assert {p.speed for p in walking} == {float(name.partition("_")[2])}
                assert len(walking) == 2
            elif name.startswith("density_"):
                assert {p.speed for p in walking} == {0.6}
                assert len(walking) == int(name.partition("_")[2])


def test_a_word_stands_for_a_sweeps_suites():
    assert expand_suites(["speed_sweep"])[0] == "speed_0.2"
    both = expand_suites(["density_sweep", "speed_sweep", "validation"])
    assert both.count("table1") == 1 and both[-1] == "validation"
    assert set(both) <= set(suite_names())


def test_open_space_is_table1_without_walls():
    base, opened = (suite(n, "suite.num_episodes=5") for n in ("table1", "open_space"))
    for one, other in zip(base.scenarios(), opened.scenarios(), strict=True):
        assert len(one.boxes) and not len(other.boxes)
        assert np.array_equal(one.path, other.path)
        assert one.pedestrians[0].offset == other.pedestrians[0].offset


def test_the_lock_is_written_with_a_version_for_each_change(tmp_path, monkeypatch):
    lock = tmp_path / "lock.yaml"
    monkeypatch.setattr("navrl.build.suites.read_lock", lambda: read_lock(lock))
    monkeypatch.setattr("navrl.build.suites.write_lock", lambda found: write_lock(found, lock))
    cfg = compose("suites", ["suites=[validation]", "write=true", "num_threads=1"])
    (first,) = check_suites(cfg)
    (again,) = check_suites(cfg)
    assert (first.status, again.status, again.found.version) == ("new", "frozen", 1)
    assert again.found == read_lock()["validation"]
    write_lock({"validation": FrozenSuite(1, 200, "other")}, lock)
    (changed,) = check_suites(cfg)
    assert (changed.status, changed.found.version) == ("changed", 2)
    assert read_lock(lock)["validation"].version == 2
