"""Frozen suites are what they were, sweeps vary one thing alone, cards bring about encounters."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from nightly import mostly

from navrl.cli.suites import main
from navrl.config import CONF_DIR, compose, instantiate
from navrl.jobs.suites import check_frozen, freeze, frozen_suites
from navrl.worlds import (
    FrozenEpisodes,
    FrozenSuiteError,
    ScenarioBatch,
    frozen_names,
    pedestrian_boxes,
)

TABLE1_200 = "68952fdc25d4db1dbe50f1207f0410b1cd7949765eddc23ca66b25895e2c90f4"
VALIDATION = "68f873819c8d7558"
ROBOT_RADIUS = 0.178
CARDS = (
    *("frontal_approach", "overtaking", "crossing", "blind_corner", "narrow_doorway"),
    *("narrow_hallway", "obstructed_doorway", "circular_crossing"),
)


def suite(*overrides):
    return instantiate(compose("evaluate", list(overrides)).suite)


@pytest.fixture(scope="module")
def social():
    distribution = suite("suite=social").distribution
    return [distribution.sample("some", 0, index) for index in range(160)]


def test_published_scores_are_of_the_frozen_episodes():
    """The hashes in the results, which no change of the code may change."""
    assert suite("suite=table1_200").hash() == TABLE1_200
    assert suite("suite=validation").hash().startswith(VALIDATION)


@pytest.mark.parametrize("entry", frozen_suites(), ids=lambda entry: entry.suite.name)
def test_frozen_suites_are_reproduced(entry):
    scenarios = entry.suite.scenarios([0, 1, entry.suite.num_episodes - 1])  # checked as they come
    assert [scenario.seed for scenario in scenarios] == [entry.suite.seed] * 3


@pytest.mark.slow
@pytest.mark.parametrize("entry", frozen_suites(), ids=lambda entry: entry.suite.name)
def test_all_frozen_episodes_are_reproduced(entry):
    check_frozen(entry)


def test_every_frozen_suite_can_be_played():
    assert {entry.suite.name for entry in frozen_suites()} == set(frozen_names())
    files = {path.stem for path in (CONF_DIR / "suite").glob("*.yaml")}
    assert {"table1", "table1_200", "validation", "open_space", "social"} <= files


@pytest.mark.parametrize(
    "change",
    ["suite.seed=7", "suite.distribution.num_dynamic=[3,3]", "suite.distribution.speed=[0.7,0.7]"],
)
@pytest.mark.parametrize("indices", mostly([None, [3]], [[3]]), ids=["all", "one"])
def test_modified_episode_of_a_frozen_suite_is_rejected(change, indices):
    with pytest.raises(FrozenSuiteError, match=r"suite table1, version 1.*expected .*found ") as it:
        suite("suite=table1_200", change).scenarios(indices)
    assert "suite.version=null" in str(it.value)
    assert indices is None or "1 of 1 differ: [3]" in str(it.value)
    assert suite("suite=table1_200", change, "suite.version=null").scenarios([3])


def test_suite_error_names_both_hashes():
    changed = suite("suite=validation", "suite.seed=7")
    unchecked = suite("suite=validation", "suite.seed=7", "suite.version=null")
    with pytest.raises(FrozenSuiteError) as it:
        changed.scenarios()
    assert unchecked.hash() in str(it.value) and VALIDATION in str(it.value)


def test_single_altered_number_is_detected():
    scenarios = suite("suite=smoke").scenarios()
    frozen = FrozenEpisodes.of("mine", 1, scenarios)
    frozen.check(range(6), scenarios)
    moved = dataclasses.replace(scenarios[4], goal=scenarios[4].goal + 2e-6)  # m
    with pytest.raises(FrozenSuiteError, match=r"1 of 6 differ: \[4\]"):
        frozen.check(range(6), [*scenarios[:4], moved, scenarios[5]])
    with pytest.raises(FrozenSuiteError, match=r"1 of 2 differ: \[4\]"):
        frozen.check([2, 4], [scenarios[2], moved])


@pytest.mark.parametrize(
    "change, words",
    [
        ("suite.version=2", "expected version 1, found version 2"),
        ("suite.name=mine", "nothing is frozen under this name"),
        ("suite.num_episodes=1001", "has 1000 episodes, episode 1000 is not frozen"),
    ],
)
def test_unfrozen_suite_is_reported(change, words):
    with pytest.raises(FrozenSuiteError, match=words):
        suite("suite=table1", change).scenarios([0, suite("suite=table1", change).num_episodes - 1])


def test_frozen_episodes_are_never_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr("navrl.worlds.frozen.FROZEN", tmp_path)
    monkeypatch.setattr("navrl.jobs.suites.FROZEN", tmp_path)
    monkeypatch.setattr(FrozenEpisodes.save, "__defaults__", (tmp_path,))
    from navrl.worlds.frozen import frozen_episodes

    frozen_episodes.cache_clear()
    try:
        (entry,) = frozen_suites(["validation"])
        entry.suite.num_episodes = 3
        assert freeze(entry) is True
        assert freeze(entry) is False
        entry.suite.seed += 1
        with pytest.raises(FrozenSuiteError, match="suite validation, version 1"):
            freeze(entry)
        entry.suite.version = 2
        assert freeze(entry) is True
        assert json.loads((tmp_path / "validation.json").read_text())["version"] == 2
    finally:
        frozen_episodes.cache_clear()


@pytest.mark.parametrize(
    "words",
    [
        ["check", "--num-workers", "1", "smoke"],
        ["--num-workers", "1", "check", "smoke"],
        ["check", "smoke", "--num-workers", "1"],
    ],
)
def test_options_of_the_command_may_come_first(words, monkeypatch):
    calls = []
    monkeypatch.setattr("navrl.cli.suites.frozen_suites", lambda names: [tuple(names)])
    monkeypatch.setattr("navrl.cli.suites._act", lambda *call: calls.append(call) or 0)
    assert main(words) == 0 and calls == [("check", ("smoke",), 1)]


def test_command_lists_and_compares_suites(capsys):
    assert main(["list", "table1", "validation"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line.split()[:3] for line in shown] == [
        ["table1", "v1", "1000"],
        ["validation", "v1", "200"],
    ]
    assert VALIDATION in shown[1]
    assert main(["check", "nobody"]) == 2
    assert "nobody" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["table1", "open_space", "speed_office_0.2", "density_corridor_8"])
def test_frozen_suites_are_those_navrl_evaluate_plays(name):
    """They are composed all at once, without the rest of the configuration."""
    (entry,) = frozen_suites([name])
    assert entry.node == compose("evaluate", list(entry.overrides)).suite
    assert entry.name == entry.suite.name == name


def test_a_misspelt_suite_gets_the_nearest_name(capsys):
    assert main(["list", "validatoin"]) == 2
    assert (
        "names=['validatoin']: no such suite; did you mean validation?" in capsys.readouterr().err
    )


@pytest.mark.parametrize("kind", ["corridor", "intersection", "office"])
def test_the_speed_sweep_varies_the_speed_alone(kind):
    slow, fast = (
        suite(f"suite=speed_{kind}", f"suite.distribution.speed=[{v},{v}]").scenarios([5])[0]
        for v in (0.2, 1.0)
    )
    assert {p.speed for p in fast.pedestrians} == {1.0, 0.0}
    assert sorted(p.is_static for p in slow.pedestrians) == [False, False, True]
    as_fast = tuple(
        p if p.is_static else dataclasses.replace(p, speed=1.0) for p in slow.pedestrians
    )
    assert dataclasses.replace(slow, pedestrians=as_fast).to_json() == fast.to_json()


@pytest.mark.parametrize("kind", ["corridor", "intersection", "office"])
def test_density_sweep_only_adds_pedestrians(kind):
    levels = [
        suite(f"suite=density_{kind}", f"suite.distribution.keep_dynamic={n}").scenarios([5])[0]
        for n in (1, 2, 4, 6, 8)
    ]
    full = levels[-1]
    assert full.kind == kind
    for count, level in zip((1, 2, 4, 6, 8), levels, strict=True):
        assert sum(not p.is_static for p in level.pedestrians) == count
        assert {p.speed for p in level.pedestrians} == {0.6, 0.0}
        kept = (*full.pedestrians[:count], *full.pedestrians[8:])
        assert dataclasses.replace(full, pedestrians=kept).to_json() == level.to_json()


def test_every_suite_has_the_key_of_the_density_sweep():
    """Hydra composes the default suite with what ``-m suite=density_corridor,...`` overrides."""
    assert suite("suite.distribution.keep_dynamic=1").distribution.keep_dynamic == 1


def test_straight_suite_is_an_empty_straight_path():
    for scene in suite("suite=straight").scenarios():
        assert len(scene.boxes) == 0 and len(scene.pedestrians) == 0
        assert np.linalg.norm(scene.goal - scene.start[:2]) == pytest.approx(5.0)
        assert np.abs(scene.path[:, 1]).max() < 1e-6  # along the x axis


def test_open_space_is_table1_without_walls():
    bare, walled = (suite(f"suite={name}").scenarios([7])[0] for name in ("open_space", "table1"))
    assert len(bare.boxes) == 0 and len(walled.boxes) > 0
    assert dataclasses.replace(bare, boxes=walled.boxes).to_json() == walled.to_json()


@pytest.mark.parametrize("name, levels", [("speed", 5), ("density", 5)])
def test_one_word_sweep_plays_frozen_suites(name, levels):
    found = [e for e in frozen_suites() if e.suite.name.startswith(f"{name}_")]
    assert len(found) == 3 * levels
    assert {e.suite.num_episodes for e in found} == {1000}
    cfg = compose("evaluate", [f"sweep={name}"])
    assert cfg.policy == "paper"


def test_cards_are_played_in_turn(social):
    assert [scenario.kind for scenario in social[:16]] == [*CARDS, *CARDS]
    batch = ScenarioBatch.pack(social[:8])
    assert [batch.kind_of(row) for row in range(8)] == list(CARDS)


def clearance(points, boxes, half=0.0):
    gap = np.abs(points[:, None] - boxes[None, :, :2]) - boxes[None, :, 2:4] - half
    return np.linalg.norm(gap.clip(min=0), axis=-1).min()


def test_cards_are_valid(social):
    for one in social:
        assert clearance(one.path, one.boxes) > ROBOT_RADIUS + 0.02, one.kind
        now = pedestrian_boxes(ScenarioBatch.pack([one]), torch.zeros(1))[0]
        assert (now[:, :2] - torch.from_numpy(one.start[:2])).norm(dim=-1).min() > 1.0, one.kind
        for person in one.pedestrians:
            route = person.route
            if len(route) > 1:
                share = np.linspace(0, 1, 50)[:, None]
                legs = zip(route, route[1:], strict=False)
                route = np.concatenate([a + share * (b - a) for a, b in legs])
            assert clearance(route, one.boxes, 0.15) > 0.05, (one.kind, one.index)


def nearest_approach(one, pace):
    """Least gap m between the middle of a robot that keeps to its path and of anybody."""
    arc = np.concatenate([[0], np.linalg.norm(np.diff(one.path, axis=0), axis=1).cumsum()])
    times = np.arange(0.0, arc[-1] / pace, 0.1)
    robot = np.stack([np.interp(times * pace, arc, one.path[:, k]) for k in range(2)], axis=1)
    rows = ScenarioBatch.pack([one] * len(times))
    people = pedestrian_boxes(rows, torch.from_numpy(times))[..., :2].numpy()
    return np.linalg.norm(people - robot[:, None], axis=-1).min()


@pytest.mark.parametrize("kind", mostly(CARDS, list(CARDS)[:2]))
def test_path_followers_meet_a_pedestrian(social, kind):
    """Within 0.4 m of their middles, at some pace the card expects: it is no empty world."""
    mine = [one for one in social if one.kind == kind]
    met = [min(nearest_approach(one, pace) for pace in (0.7, 0.8, 0.9, 1.0)) < 0.4 for one in mine]
    assert np.mean(met) >= 0.8


def test_cards_alternate_between_mirror_images(social):
    starts = np.array([one.start[1] for one in social if one.kind == "narrow_doorway"])
    assert (starts[::2] > 0).all() and (starts[1::2] < 0).all()


def test_long_generation_shows_progress(monkeypatch, capsys):
    from navrl.worlds import suite as module

    monkeypatch.setattr(module, "_DELAY_S", 0.0)
    made = compose("evaluate", ["suite=smoke", "suite.num_episodes=3"]).suite
    silent, shown = (instantiate(made).scenarios(progress=shown) for shown in (False, True))
    assert [s.to_json() for s in silent] == [s.to_json() for s in shown]
    err = capsys.readouterr().err
    assert "3/3" in err and "scenario/s" in err
