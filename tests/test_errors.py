"""What a user gets wrong is answered by one line that names it, and exit status 2."""

import shlex

import pages
import pytest
from nightly import mostly

CASES = [
    ("train", ["sed=1"], ["sed", "did you mean", "seed"]),
    ("train", ["num_worlds=many"], ["num_worlds=many: must be int"]),
    ("train", ["algorithm.gamma=1.5"], ["gamma=1.5", "[0, 1]"]),
    ("train", ["simulator=batchd"], ["simulator/batchd", "; did you mean batched?"]),
    ("train", ["simulator=gazebo"], ["simulator/gazebo", "batched"]),
    ("train", ["resume=nowhere"], ["resume=nowhere", "no run there"]),
    ("train", ["num_threads=1000"], ["num_threads=1000", "between 1 and"]),
    ("evaluate", ["policy=navrl-bset"], ["policy=navrl-bset", "; did you mean navrl-best"]),
    ("play", ["policy=pure_persuit"], ["policy=pure_persuit", "; did you mean pure_pursuit?"]),
    ("evaluate", ["policy=nobody"], ["policy=nobody", "pure_pursuit"]),
    ("evaluate", ["policy=random", "lidar.num_beams=-4"], ["num_beams", "-4"]),
    ("benchmark", ["rows=[latencies]"], ["rows=['latencies']", "; did you mean latency?"]),
    ("benchmark", ["rows=[warp]"], ["rows=['warp']", "latency", "scan"]),
    ("play", ["policy=random", "suite=smoke", "episode=99"], ["index 99", "has 6"]),
]


@pytest.mark.parametrize(
    ("command", "overrides", "words"), mostly(CASES, CASES[::3]), ids=lambda v: str(v)[:30]
)
def test_error_is_one_line(command, overrides, words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    status = pages.exit_status(shlex.join([f"navrl-{command}", *overrides, "hydra.run.dir=."]))
    printed = capfd.readouterr().err
    lines = [line for line in printed.splitlines() if line.startswith("navrl: ")]
    assert status == 2, printed
    assert len(lines) == 1
    assert "Traceback" not in printed
    for word in words:
        assert word in lines[0]
