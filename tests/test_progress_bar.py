"""Remaining time of tasks whose speed changes."""

import io
import math
import re
from unittest import mock

import pytest

from navrl.progress_bar import RemainingTime, progress_bar, shown_time


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_remaining_time_ignores_progress_before_restart(clock):
    remaining = RemainingTime(clock=clock)
    remaining.restart(0.0)
    clock.now += 1.0  # a tenth in a second, without updates
    remaining.restart(0.1)
    clock.now += 30.0  # a tenth in 30 seconds, with updates
    assert remaining.estimate(0.2) == pytest.approx(8 * 30.0)


def test_remaining_time_follows_the_last_minutes(clock):
    remaining = RemainingTime(window_s=100.0, clock=clock)
    remaining.restart(0.0)
    for share in (0.1, 0.2):  # a slow beginning
        clock.now += 100.0
        remaining.estimate(share)
    for share in (0.3, 0.4, 0.5, 0.6):
        clock.now += 25.0
        left = remaining.estimate(share)
    assert left == pytest.approx(4 * 25.0)


def test_remaining_time_is_unknown_without_progress(clock):
    remaining = RemainingTime(clock=clock)
    assert math.isinf(remaining.estimate(0.3))
    clock.now += 10.0
    assert math.isinf(remaining.estimate(0.3))
    clock.now += 10.0
    assert remaining.estimate(1.2) == 0.0


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0:00:00"), (59.6, "0:01:00"), (3725.2, "1:02:05"), (360_000.0, "100:00:00")],
)
def test_durations_are_hours_minutes_seconds(seconds, text):
    assert shown_time(seconds) == text
    assert shown_time(math.inf) == "?"


@pytest.mark.parametrize("remaining", [True, False])
def test_bar_shows_its_own_estimate_only_if_wanted(remaining):
    with mock.patch("sys.stderr", io.StringIO()) as shown:
        bar = progress_bar(10, "frame", remaining=remaining)
        bar.update(5)
        bar.set_postfix(left="1:02:05")
        bar.close()
    assert "left=1:02:05" in shown.getvalue()
    assert bool(re.search(r"\d\d:\d\d<", shown.getvalue())) == remaining
