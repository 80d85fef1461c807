"""Each reward term, by hand on a straight path along x."""

from dataclasses import replace

import pytest
import torch

from navrl.envs import (
    Collision,
    Goal,
    Guidance,
    Outcome,
    Progress,
    Proximity,
    Smoothness,
    Transition,
)
from navrl.envs.outcome import classify
from navrl.sim import Contact

PATH = torch.stack([torch.linspace(0, 4, 41), torch.zeros(41)], dim=-1).expand(2, -1, -1)


def transition(**changes) -> Transition:
    step = Transition(
        position=torch.tensor([[1.2, 0.0], [3.9, 0.3]]),
        path=PATH,
        path_length=torch.full((2,), 4.0),
        progress_before=torch.tensor([1.0, 3.8]),
        progress=torch.tensor([1.2, 3.9]),
        nearest=torch.tensor([3.5, 0.4]),
        collided=torch.tensor([False, False]),
        reached=torch.tensor([False, False]),
        robot_radius=0.178,
        velocity=torch.tensor([[1.0, 0.0], [0.5, -1.0]]),
        command_before=torch.tensor([[0.0, 0.0], [0.5, 1.0]]),
        command=torch.tensor([[1.0, 0.0], [0.75, -2.0]]),
    )
    return replace(step, **changes)


def check(term, expected, step=None):
    torch.testing.assert_close(term(step or transition()), torch.tensor(expected))


def test_collision_costs_its_weight_once():
    check(Collision(10.0), [0.0, -10.0], transition(collided=torch.tensor([False, True])))


def test_guidance_before_the_move_rewards_driving():
    # From 1.0 m the point is at 1.6 m; the robot stands at 1.2 m. At the end it is clamped to 4 m.
    to_goal = -0.2 * (0.1**2 + 0.3**2) ** 0.5
    check(Guidance(0.2, 0.6, "before_move"), [-0.2 * 0.4, to_goal])


def test_guidance_after_the_move_is_independent_of_position():
    check(Guidance(0.2, 0.6, "after_move"), [-0.2 * 0.6, -0.2 * (0.1**2 + 0.3**2) ** 0.5])


def test_proximity_grows_linearly_below_its_distance():
    check(Proximity(3.0, 0.5), [0.0, -3.0 * 0.1])
    check(Proximity(3.0, 0.5, "hull"), [0.0, -3.0 * (0.1 + 0.178)])


def test_goal_pays_once():
    check(Goal(10.0), [10.0, 0.0], transition(reached=torch.tensor([True, False])))


def test_smoothness_costs_squared_changes_of_the_command():
    check(Smoothness(0.1, 0.0), [0.0, -0.9])
    check(Smoothness(0.0, 0.2), [-0.2, -0.2 * 0.25**2])


def test_progress_rewards_meters():
    check(Progress(2.0), [0.4, 0.2])


def test_potential_form_telescopes_to_the_start_potential():
    """Discounted over an episode, shaping sums to -Phi(start), whatever the path."""
    term, gamma = Progress(2.0, "potential", gamma=0.9), 0.9
    progress = [0.0, 0.5, 1.5, 1.2, 2.0]
    total = 0.0
    for k, (before, after) in enumerate(zip(progress, progress[1:], strict=False)):
        step = transition(
            progress_before=torch.tensor([before, 0.0]),
            progress=torch.tensor([after, 0.0]),
            collided=torch.tensor([k == 3, False]),
        )
        total += gamma**k * float(term(step)[0])
    assert total == pytest.approx(2.0 * 4.0, abs=1e-5)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Guidance(point="sideways"), "point='sideways'"),
        (lambda: Proximity(measured_from="wheel"), "measured_from='wheel'"),
        (lambda: Progress(form="magic"), "form='magic'"),
    ],
)
def test_unknown_readings_are_named(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_outcome_codes_are_those_in_files():
    names = ["RUNNING", "SUCCESS", "COLLISION_PEDESTRIAN", "COLLISION_STATIC", "TIMEOUT"]
    assert {name: int(outcome) for name, outcome in Outcome.__members__.items()} == {
        name: code for code, name in enumerate(names)
    }


@pytest.mark.parametrize(
    ("contact", "distance", "late", "expected"),
    [
        (Contact.NONE, 1.0, False, Outcome.RUNNING),
        (Contact.NONE, 0.2, False, Outcome.SUCCESS),
        (Contact.NONE, 0.21, True, Outcome.TIMEOUT),
        (Contact.NONE, 0.1, True, Outcome.SUCCESS),
        (Contact.PEDESTRIAN, 0.1, True, Outcome.COLLISION_PEDESTRIAN),
        (Contact.HIT_BY_PEDESTRIAN, 1.0, False, Outcome.COLLISION_PEDESTRIAN),
        (Contact.STATIC, 0.1, False, Outcome.COLLISION_STATIC),
    ],
)
def test_outcome_has_one_definition(contact, distance, late, expected):
    outcome = classify(
        torch.tensor([int(contact)]), torch.tensor([distance]), 0.2, torch.tensor([late])
    )
    assert outcome.tolist() == [expected]


def test_default_weights_equal_the_papers():
    """Sec. IV-D: 10, 0.2 at 0.6 m, 3 below 0.5 m; goal and progress are navrl's own."""
    assert (Collision().weight, Guidance().weight, Guidance().lookahead) == (10.0, 0.2, 0.6)
    assert (Proximity().weight, Proximity().distance) == (3.0, 0.5)
    assert (Goal().weight, Progress().weight, Progress().gamma) == (10.0, 2.0, 0.98)
    assert Guidance().point == "before_move" and Proximity().measured_from == "lidar"
    assert Progress().form == "difference"


def test_potential_is_zero_at_the_goal_and_at_a_collision():
    flags = torch.tensor([True, False])
    for ending in ("reached", "collided"):
        expected = [2.0 * 3.0, 2.0 * (0.5 * -0.1 + 0.2)]
        step = transition(**{ending: flags})
        check(Progress(2.0, "potential", gamma=0.5), expected, step)
