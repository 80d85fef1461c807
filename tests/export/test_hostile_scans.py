"""Hostile inputs of an exported file, each listed on the page: zero, or the call raises."""

import numpy as np
import pytest
from test_hostile_inputs import listed_state, page_rows
from test_onnx_policy import arguments, exported, paper

__all__ = ["exported", "paper"]  # fixtures
NO_INPUT = "not an input"


def ranges(value):
    return lambda given: given | {"ranges": np.full(1440, value)}


def ahead(value, degrees):
    """Return a change of the beams within an angle of straight ahead."""

    def change(given):
        beams = np.array(given["ranges"])
        away = np.abs((np.degrees(2 * np.pi * np.arange(1440) / 1440) + 180) % 360 - 180)
        beams[away <= degrees] = value
        return given | {"ranges": beams}

    return change


def one_beam(given):
    return given | {"ranges": np.r_[np.full(1439, np.nan), 3.0]}


INPUTS = {
    "all beams NaN": ranges(np.nan),
    "all beams +inf": ranges(np.inf),
    "all beams 0": ranges(0.0),
    "all beams at range_max": ranges(12.0),
    "all beams NaN but one": one_beam,
    "all beams negative": ranges(-1.0),
    "-inf straight ahead": ahead(-np.inf, 0.5),
    "NaN in a sector of 20 degrees ahead": ahead(np.nan, 10.0),
    "ranges in millimeters": lambda given: (
        given | {"ranges": 1000.0 * np.clip(given["ranges"], 0.3, 3.5)}
    ),
    "a scan without beams": lambda given: given | {"ranges": []},
    "a pose that is not finite": lambda given: given | {"pose": (np.nan, 0.0, 0.0)},
    "a yaw in degrees": lambda given: given | {"pose": (0.0, 0.0, 90.0)},
    "a pose in millimeters": lambda given: given | {"pose": (9000.0, 0.0, 0.0)},
    "a path that is not finite or empty": lambda given: given | {"path": [(np.nan, 0.0)]},
}


@pytest.mark.parametrize("has_driven", [False, True])
@pytest.mark.parametrize("name", INPUTS)
def test_hostile_input_of_a_file_gives_zero_or_raises(name, has_driven, paper):
    paper.reset()
    for step in range(3 if has_driven else 0):
        paper.act(**arguments(paper, step))
    given = INPUTS[name](arguments(paper, 3))
    result = page_rows()[name][1]
    if "ValueError" in result:
        with pytest.raises(ValueError, match=r"ranges|pose|path"):
            paper.act(**given)
        return
    assert paper.act(**given).tolist() == [0.0, 0.0]
    assert paper.drive_state == listed_state(result)


def test_page_lists_the_inputs_of_a_file():
    of_files = {name for name, results in page_rows().items() if results[1] != NO_INPUT}
    assert of_files == set(INPUTS)
