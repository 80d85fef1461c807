"""Shares of a training's time come from its log, whichever phases it has."""

import pytest

from navrl.benchmarks.training import training_rows


@pytest.mark.parametrize("phases", [("act", "environment", "update"), ("wait", "push", "update")])
def test_rows_are_the_phases_of_the_log(tmp_path, phases):
    log = tmp_path / "metrics.csv"
    names = [f"seconds/{phase}" for phase in phases]
    speeds = ["speed/frames_per_s", "speed/updates_per_s"]
    lines = [["9", "9", "9", "1", "1"], ["1", "2", "1", "320", "10"], ["1", "2", "1", "640", "20"]]
    log.write_text("\n".join(",".join(line) for line in [names + speeds, *lines]) + "\n")
    rows = {row.key: row for row in training_rows(log, cores=1)}
    assert rows.keys() == {f"training.{name}" for name in ("frames", "updates", *phases)}
    assert rows["training.frames"].values == pytest.approx([320, 640])
    assert rows[f"training.{phases[1]}"].values == pytest.approx([50, 50])
    assert (rows[f"training.{phases[1]}"].bar is not None) == (phases[1] == "environment")


def test_log_without_timings_is_rejected(tmp_path):
    log = tmp_path / "metrics.csv"
    log.write_text("frames,speed/frames_per_s\n1,\n2,100\n")
    with pytest.raises(ValueError, match="two rows with timings"):
        training_rows(log, cores=1)
