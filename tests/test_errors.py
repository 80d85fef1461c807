"""What a user gets wrong is answered by one line that names it, and exit status 2."""

import subprocess
import sys

import pytest

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


@pytest.mark.parametrize(("command", "overrides", "words"), CASES, ids=lambda v: str(v)[:30])
def test_error_is_one_line(command, overrides, words, tmp_path):
    code = f"import sys; from navrl.cli.{command} import main; sys.argv[0] = 'navrl'; main()"
    result = subprocess.run(
        [sys.executable, "-c", code, *overrides, "hydra.run.dir=."],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    lines = [line for line in result.stderr.splitlines() if line.startswith("navrl: ")]
    assert result.returncode == 2, result.stderr
    assert len(lines) == 1
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in lines[0]
