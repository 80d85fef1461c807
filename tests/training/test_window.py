"""The sums between two rows of the log, and what acts while they are collected."""

import pytest
import torch
from tensordict import TensorDict

from navrl import keys
from navrl.envs import Outcome
from navrl.training import Behavior
from navrl.training.window import Window


def following(goal, outcomes):
    """Return what a step of worlds led to; a world with an outcome is done."""
    outcome = torch.tensor([[int(o)] for o in outcomes])
    terms = {"goal": torch.tensor(goal).unsqueeze(-1)}
    return TensorDict(
        {keys.OUTCOME: outcome, "done": outcome != Outcome.RUNNING, keys.REWARD_TERMS: terms},
        [len(outcomes)],
    )


@pytest.fixture
def window():
    window = Window()
    success, timeout, running = Outcome.SUCCESS, Outcome.TIMEOUT, Outcome.RUNNING
    assert (
        window.add_step(following([1.0, 2.0, 0.0, 0.5], [success, running, running, timeout])) == 2
    )
    assert (
        window.add_step(following([1.0, 0.0, 0.0, 0.0], [success, running, running, success])) == 2
    )
    window.add_updates({"q_mean": torch.tensor(3.0)}, 1)
    window.add_updates({"q_mean": torch.tensor(9.0)}, 3)
    window.phases.seconds["act"] = 1.5
    window.phases.seconds["update"] = 2.5
    return window


def test_row_holds_means_and_rates(window):
    row = window.row()
    assert row["reward/goal"] == pytest.approx(4.5 / 8)
    assert row["train/success_rate"] == 0.75 and row["train/timeout_rate"] == 0.25
    assert row["train/collision_static_rate"] == 0 and "train/running_rate" not in row
    assert row["learn/q_mean"] == 3.0
    assert row["seconds/act"] == 1.5 / 4 and row["seconds/update"] == 2.5 / 4
    assert row["speed/frames_per_s"] == 2.0 and row["speed/updates_per_s"] == 1.0


def test_restored_window_continues_exactly(window):
    restored = Window.from_state(window.state_dict())
    for each in (window, restored):
        each.add_step(following([0.1, 0.2, 0.3, 0.7], [Outcome.COLLISION_STATIC] * 4))
        each.add_updates({"q_mean": torch.tensor(0.1)}, 1)
    assert restored.row() == window.row()


def test_row_without_an_ended_episode_has_no_rates_above_zero():
    window = Window()
    window.add_step(following([0.0], [Outcome.RUNNING]))
    window.add_updates({}, 1)
    window.phases.seconds["act"] = 1.0
    assert window.row()["train/success_rate"] == 0
    assert Window.from_state(Window().state_dict()).state_dict() == Window().state_dict()


def test_phase_times_sum_to_the_total(monkeypatch):
    clock = iter([0.0, 2.0, 5.0, 8.0])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    window = Window()
    for _ in range(2):
        with window.phases("act"):
            pass
    assert window.phases.seconds == {"act": 5.0}


class Exploration:
    action_size = 2

    def __call__(self, tensordict, frames):
        return tensordict


def constant(value):
    return lambda td: td.set(keys.ACTION, torch.full((len(td), 2), float(value)))


def acted(frames, **options):
    behavior = Behavior(constant(7), Exploration(), constant(-7), **options)
    return behavior.act(TensorDict({}, [5]), frames)[keys.ACTION]


def test_random_actions_end_at_their_frame():
    torch.manual_seed(0)
    drawn = acted(9, random_frames=10)
    assert drawn.abs().max() <= 1 and drawn.min() < 0 < drawn.max()
    assert (acted(10, random_frames=10) == 7).all()


def test_guide_drives_its_share_until_its_frame():
    options = {"guided_fraction": 0.35, "guided_frames": 20, "random_frames": 0}
    assert acted(19, **options)[:, 0].tolist() == [-7, -7, 7, 7, 7]  # 1.75 worlds, rounded
    assert (acted(20, **options) == 7).all()
    assert acted(10**9, guided_fraction=1.0, random_frames=0).max() == -7
