"""A user's own transform plugs in by --config-dir and _target_, with no edit here."""

import subprocess
import sys

TRANSFORM = """
from torchrl.envs import Transform


class Quarter(Transform):
    def __init__(self):
        super().__init__(in_keys=["ranges"], out_keys=["ranges"])

    def _call(self, tensordict):
        return tensordict.set("ranges", tensordict["ranges"] * 0.25)

    def _reset(self, tensordict, tensordict_reset):
        return self._call(tensordict_reset)
"""
EXPERIMENT = """# @package _global_
transforms:
  quarter:
    _target_: my_package.Quarter
"""


def test_own_transform_from_own_config_dir(tmp_path):
    (tmp_path / "my_package.py").write_text(TRANSFORM)
    (tmp_path / "my_conf" / "experiment").mkdir(parents=True)
    (tmp_path / "my_conf" / "experiment" / "mine.yaml").write_text(EXPERIMENT)
    code = "import sys; sys.path.insert(0, '.'); from navrl.cli.train import main; main()"
    command = [sys.executable, "-c", code, "--config-dir", "my_conf", "experiment=mine"]
    tiny = [
        "num_worlds=2",
        "num_threads=1",
        "pool_size=2",
        "scenario=corridor",
        "network=small",
        "replay.batch_size=4",
        "replay.capacity=100",
        "validation.num_episodes=2",
        "environment.time_limit_steps=4",
        "schedule.total_frames=16",
        "schedule.learning_starts=4",
        "schedule.frames_per_update=4",
        "suite=smoke",
        "progress_bar=false",
        "hydra.run.dir=run",
    ]
    result = subprocess.run(
        [*command, *tiny], cwd=tmp_path, capture_output=True, text=True, timeout=500
    )
    assert result.returncode == 0, result.stderr[-3000:]
    assert "my_package.Quarter" in (tmp_path / "run" / "config.yaml").read_text()
