"""Each metric on trajectories whose numbers are known by hand."""

import numpy as np
import pytest
from trajectories import along, standing, trajectory

from navrl.envs import Outcome
from navrl.evaluation import metrics
from navrl.evaluation.metrics import METRICS, measure
from navrl.sim import Contact

HIT = {"outcome": Outcome.COLLISION_PEDESTRIAN, "contact": Contact.PEDESTRIAN}
HIT_BY_PEDESTRIAN = {"outcome": Outcome.COLLISION_PEDESTRIAN, "contact": Contact.HIT_BY_PEDESTRIAN}
STATIC = {"outcome": Outcome.COLLISION_STATIC, "contact": Contact.STATIC}
LATE = {"outcome": Outcome.TIMEOUT}
WALL, SHELF = (2.0, 0.0, 0.1, 1.0, 0.0), (1.0, 0.5, 0.1, 0.1, 0.0)


def value(metric, *positions, **options):
    (found,) = metric(trajectory(*positions, **options))
    return found


ENDINGS = ("success", "timeout", "collision", "moved_into_pedestrian", "hit_by_pedestrian")
ENDINGS = (*ENDINGS, "collision_wall", "collision_furniture")


@pytest.mark.parametrize(
    ("options", "holds"),
    [
        ({}, {"success"}),
        (LATE, {"timeout"}),
        (HIT, {"collision", "moved_into_pedestrian"}),
        (HIT_BY_PEDESTRIAN, {"collision", "hit_by_pedestrian"}),
        (STATIC, {"collision", "collision_wall"}),  # the shelf is farther
        ({**STATIC, "boxes": [SHELF, WALL], "furniture": 1}, {"collision", "collision_furniture"}),
        ({**STATIC, "boxes": []}, {"collision", "collision_wall"}),
    ],
)
def test_outcome_and_at_fault_party(options, holds):
    options = {"boxes": [WALL, SHELF], "furniture": 1, **options}
    # stops 0.1 m before the wall, or where the last box of the list stands
    found = measure(trajectory(*along(0.0, 0.9, 1.7), **options))
    assert {name for name in ENDINGS if found[name][0]} == holds


def test_time_to_goal_is_of_successes_only():
    assert value(metrics.time_to_goal, *along(0, 0.1, 0.2)) == pytest.approx(0.4)
    assert np.isnan(value(metrics.time_to_goal, *along(0, 0.1, 0.2), **LATE))
    assert value(metrics.duration, *along(0, 0.1, 0.2), **LATE) == pytest.approx(0.4)


def test_path_length_is_the_driven_distance():
    corner = [(0.0, 0.0), (0.3, 0.0), (0.3, 0.4), (0.3, 0.4)]
    assert value(metrics.path_length, *corner) == pytest.approx(0.7)
    back = along(0.0, 0.2, 0.0)
    assert value(metrics.path_length, *back) == pytest.approx(0.4)


def test_detours_and_failures_reduce_spl():
    detour = [(0.0, 0.0), (0.3, 0.0), (0.3, 0.4)]  # 0.7 m instead of 0.5 m
    straight = [(0.0, 0.0), (0.3, 0.4)]
    assert value(metrics.spl, *detour, path=straight) == pytest.approx(0.5 / 0.7)
    assert value(metrics.spl, *detour, path=straight, **HIT) == 0.0
    # stopping short of the goal, within its radius, earns nothing extra
    assert value(metrics.spl, *along(0.0, 0.4), path=along(0.0, 0.5)) == 1.0


def test_waiting_reduces_stl():
    slow = along(0.0, 0.1, 0.1, 0.2)  # 0.6 s for what takes 0.2 s at 1 m/s
    assert value(metrics.stl, *slow) == pytest.approx(1 / 3)
    assert value(metrics.stl, *slow, **LATE) == 0.0
    assert value(metrics.stl, *along(0.0, 0.3)) == 1.0


def test_stalled_time_counts_slow_steps():
    # 0.05 m/s is 0.01 m a step
    assert value(metrics.stalled_time, *along(0, 0.1, 0.105, 0.105, 0.135)) == pytest.approx(0.4)


def test_time_without_progress_counts_reversing_and_turning():
    # forward, back, forward over the same stretch, forward, aside
    drive = [(0.0, 0.0), (0.2, 0.0), (0.1, 0.0), (0.2, 0.0), (0.4, 0.0), (0.4, 0.2)]
    found = value(metrics.time_without_progress, *drive, path=along(0.0, 2.0), **LATE)
    assert found == pytest.approx(3 * 0.2)
    corner = [(0.0, 0.0), (0.2, 0.0), (0.2, 0.2)]  # away from the goal, but along the path
    path = [(0.0, 0.0), (0.2, 0.0), (0.2, 0.4), (-3.0, 0.4)]
    assert value(metrics.time_without_progress, *corner, path=path, **LATE) == 0.0


def test_one_millimeter_per_step_is_the_minimum_progress():
    drive = along(0.0, 0.2, 0.2008, 0.2016, 0.2028, 0.204)  # twice 0.8 mm, twice 1.2 mm
    found = value(metrics.time_without_progress, *drive, path=along(0.0, 2.0), **LATE)
    assert found == pytest.approx(2 * 0.2)


SPEEDS = along(0.0, 0.1, 0.3, 0.4, 0.4)  # 0.5, 1.0, 0.5, 0 m/s


def test_speeds_accelerations_and_jerks_are_exact():
    found = {m.name: float(m.function(trajectory(*SPEEDS))[0]) for m in METRICS}
    assert found["mean_speed_mps"] == pytest.approx(0.5)
    assert found["max_speed_mps"] == pytest.approx(1.0)
    # +2.5, -2.5, -2.5 m/s^2; -25, 0 m/s^3
    assert found["mean_acceleration_mps2"] == pytest.approx(2.5)
    assert found["max_acceleration_mps2"] == pytest.approx(2.5)
    assert found["mean_jerk_mps3"] == pytest.approx(12.5)
    assert found["max_jerk_mps3"] == pytest.approx(25.0)


def test_contact_within_a_step_is_no_deceleration():
    found = measure(trajectory(*along(0.0, 0.2, 0.4, 0.45), **STATIC))
    assert found["mean_speed_mps"] == pytest.approx(1.0)
    assert found["max_acceleration_mps2"] == pytest.approx(0.0, abs=1e-9)
    assert found["stalled_time_s"] == 0.0
    assert found["path_length_m"] == pytest.approx(0.45)


def test_short_episodes_have_undefined_metrics():
    found = measure(trajectory(*along(0.0, 0.1), **STATIC))
    for name in ("mean_speed_mps", "max_acceleration_mps2", "mean_jerk_mps3"):
        assert np.isnan(found[name]), name


def test_heading_changes_accumulate_across_pi():
    yaw = [3.0, -3.0, -2.5, -3.0]
    expected = (2 * np.pi - 6.0) + 0.5 + 0.5
    assert value(metrics.cumulative_heading_change, *along(0, 0, 0, 0), yaw=yaw) == (
        pytest.approx(expected)
    )


def test_distances_to_people_are_between_surfaces():
    # 1.0, 0.6, 1.0 m off the nearer of two people, less radius 0.2 and half side 0.1
    drive = {"people": [[standing(1.0, y)] for y in (0.0,)] + [[standing(9.0, 0.0)]]}
    drive = {"people": [series * 3 for series in drive["people"]]}
    xs = along(0.0, 0.4, 0.0)
    assert value(metrics.min_pedestrian_distance, *xs, **drive) == pytest.approx(0.3)
    assert value(metrics.mean_pedestrian_distance, *xs, **drive) == pytest.approx(1.7 / 3)
    assert value(metrics.beyond_intimate, *xs, **drive) == pytest.approx(2 / 3)
    assert value(metrics.beyond_personal, *xs, **drive) == 0.0
    far = {"people": [[standing(3.0, 0.0)] * 3]}
    assert value(metrics.beyond_personal, *xs, **far) == 1.0
    assert value(metrics.min_pedestrian_distance, *xs, **{**far, **HIT_BY_PEDESTRIAN}) == 0.0


@pytest.mark.parametrize(
    ("function", "limit"), [(metrics.beyond_intimate, 0.45), (metrics.beyond_personal, 1.2)]
)
def test_personal_space_has_halls_distances(function, limit):
    # one person, the surfaces a millimeter within and beyond the limit: radius 0.2, half side 0.1
    for gap, expected in ((limit - 1e-3, 0.0), (limit + 1e-3, 1.0)):
        people = [[standing(0.3 + gap, 0.0)] * 2]
        assert value(function, *along(0.0, 0.0), people=people) == expected


def test_distance_without_pedestrians_is_infinite():
    alone = measure(trajectory(*along(0.0, 0.1)))
    assert alone["min_pedestrian_distance_m"] == np.inf
    assert alone["mean_pedestrian_distance_m"] == np.inf
    assert alone["min_time_to_collision_s"] == np.inf
    assert alone["beyond_0.45m_share"] == 1.0


def test_time_to_collision_on_a_collision_course():
    # closing at 1.0 + 0.5 m/s from 3.0 m; bodies reach 0.2 + 0.1 m
    walker = [standing(3.1, 0.0), standing(3.0, 0.0)]
    found = value(metrics.min_time_to_collision, *along(-0.2, 0.0), people=[walker], **LATE)
    assert found == pytest.approx((3.0 - 0.3) / 1.5)


def test_passing_pedestrians_are_not_on_a_collision_course():
    aside = [standing(3.1, 0.4), standing(3.0, 0.4)]  # passes at 0.4 m, bodies reach 0.3 m
    parting = [standing(3.0, 0.0), standing(3.3, 0.0)]
    grazing = [standing(3.1, 0.2), standing(3.0, 0.2)]  # 3.0 - sqrt(0.3^2 - 0.2^2) m to go
    for walker, expected in (
        (aside, np.inf),
        (parting, np.inf),
        (grazing, (3.0 - 0.05**0.5) / 1.5),
    ):
        found = value(metrics.min_time_to_collision, *along(-0.2, 0.0), people=[walker], **LATE)
        assert found == pytest.approx(expected)


@pytest.mark.parametrize("before", [0.15, 0.2, 0.3])
def test_overlapping_discs_have_zero_time_to_collision(before):
    """A cuboid's disc may overlap the hull without a contact, even while the two part."""
    walker = [standing(before, 0.0), standing(0.29, 0.0)]  # bodies reach 0.3 m
    assert value(metrics.min_time_to_collision, *along(0.0, 0.0), people=[walker], **LATE) == 0.0
    clear = [standing(before, 0.0), standing(0.31, 0.0)]
    found = value(metrics.min_time_to_collision, *along(0.0, 0.0), people=[clear], **LATE)
    assert found == np.inf


def test_a_contact_ends_the_time_to_collision():
    people = [[standing(1.0, 0.0)] * 2]
    assert value(metrics.min_time_to_collision, *along(0.5, 0.7), people=people, **HIT) == 0.0


def test_padding_does_not_change_metrics():
    rng = np.random.default_rng(0)
    drive = rng.uniform(0, 0.2, (14, 2)).cumsum(axis=0)
    walker = np.column_stack([rng.uniform(0, 3, (14, 2)), np.full((14, 3), 0.1)])
    alone, padded = (trajectory(*drive, people=[walker], padding=p) for p in (0, 40))
    for name, found in measure(alone).items():
        assert np.array_equal(found, measure(padded)[name], equal_nan=True), name


def test_every_metric_has_a_docstring():
    for metric in METRICS:
        text = metric.function.__doc__
        assert "Reference:" in text and text.startswith("Return ``[E]``"), metric.name
        if metric.unit != "1":
            assert f" {metric.unit}" in text, metric.name


def test_latency_matches_a_manual_calculation():
    found = metrics.controller_latency([0.001, 0.002, 0.003, 0.010])
    assert found["mean_ms"] == pytest.approx(4.0)
    assert found["median_ms"] == pytest.approx(2.5)
    assert found["max_ms"] == pytest.approx(10.0)
    assert found["p95_ms"] == pytest.approx(3 + 0.85 * 7)
    assert found["calls"] == 4
    with pytest.raises(ValueError, match="decision_s"):
        metrics.controller_latency([])


def test_bad_shapes_are_named():
    good = trajectory(*along(0.0, 0.1))
    values = {name: getattr(good, name) for name in good.__dataclass_fields__}
    with pytest.raises(ValueError, match="contact"):
        metrics.Trajectory(**{**values, "contact": np.zeros(2)})
    with pytest.raises(ValueError, match="num_steps"):
        metrics.Trajectory(**{**values, "num_steps": np.array([2])})


def steering(*command, requested=None):
    """Return all metrics of a robot that was given the commands (v, w)."""
    made = trajectory(*along(*range(len(command) + 1)), command=command, requested=requested)
    return {name: found[0] for name, found in measure(made).items()}


def test_reversals_count_strong_turns_of_both_signs():
    w = [0.6, -0.6, -0.6, 0.4, -0.6, 0.6]  # reversals in changes 1 and 5 of 5
    assert steering(*((1.0, rate) for rate in w))["turn_reversal_share"] == pytest.approx(0.4)
    assert steering((1.0, 0.5), (1.0, -0.5))["turn_reversal_share"] == 0.0  # must exceed 0.5
    assert np.isnan(steering((1.0, 0.6))["turn_reversal_share"])  # one step has no change


def test_percentiles_of_changes_pool_the_steps():
    found = steering(*((0.1 * k * k, -0.5 * k * k) for k in range(5)))  # 0.1 and 0.5 x (1, 3, 5, 7)
    assert found["speed_change_p90_mps"] == pytest.approx(0.64)  # at 2.7 of 0 to 3: 0.5 + 0.7 * 0.2
    assert found["speed_change_p95_mps"] == pytest.approx(0.67)
    assert found["turn_rate_change_p90_radps"] == pytest.approx(3.2)
    assert found["turn_rate_change_p95_radps"] == pytest.approx(3.35)


def test_largest_turn_rate_excludes_the_first_second():
    w = [3.0, 0.1, 0.1, 0.1, -2.0, 0.1, -0.2]  # steps of 0.2 s: the sixth starts after 1 s
    assert steering(*((1.0, rate) for rate in w))["max_turn_rate_radps"] == pytest.approx(0.2)


def test_turned_angle_is_per_driven_meter():
    turned = value(metrics.turned_per_meter, *along(0, 1, 2), yaw=[0.0, 0.3, -0.1])
    assert turned == pytest.approx(0.35)
    assert np.isnan(value(metrics.turned_per_meter, *along(1, 1, 1), yaw=[0.0, 0.3, -0.1]))


def test_shielded_steps_differ_from_the_request():
    command = [(1.0, 0.0), (0.5, 0.0), (0.5, 0.1), (0.0, 0.0)]
    requested = [(1.0, 0.0), (1.0, 0.0), (0.5, 0.0), (0.0, 0.0)]
    assert steering(*command, requested=requested)["shielded_share"] == pytest.approx(0.5)
    assert np.isnan(value(metrics.shielded, *along(0, 1)))  # commands are not known
