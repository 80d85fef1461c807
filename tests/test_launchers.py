"""Sweeps on many cores and on clusters: the configs fit their plugins, and two of them run."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import hydra
import pytest

from navrl.config import CONF_DIR

ROOT = Path(__file__).parents[1]
PLUGIN = {
    "cores": "joblib",
    "joblib": "joblib",
    "slurm": "submitit",
    "submitit_local": "submitit",
    "ray_cluster": "ray",
    "ray": "ray",
}
TINY = [
    *("num_worlds=2", "num_threads=1", "pool_size=2", "scenario=corridor", "network=small"),
    *("replay.batch_size=4", "replay.capacity=100", "validation.num_episodes=2"),
    *("environment.time_limit_steps=4", "schedule.total_frames=16", "schedule.learning_starts=4"),
    *("schedule.frames_per_update=4", "suite=smoke", "progress_bar=false"),
]


def need(launcher):
    plugin = f"hydra_plugins.hydra_{PLUGIN[launcher]}_launcher"
    pytest.importorskip(plugin, reason="needs the extra launchers")


def compose(overrides):
    with hydra.initialize_config_dir(version_base="1.3", config_dir=str(CONF_DIR)):
        return hydra.compose("train", overrides, return_hydra_config=True)


@pytest.mark.parametrize("launcher", sorted(PLUGIN))
def test_every_launcher_composes(launcher):
    need(launcher)
    node = compose([f"hydra/launcher={launcher}"]).hydra.launcher
    assert PLUGIN[launcher] in node["_target_"]


def test_a_running_ray_cluster_keeps_its_own_object_store():
    """Ray refuses a size of it when joining a cluster, and the plugin would set one."""
    need("ray_cluster")
    init = compose(["hydra/launcher=ray_cluster"]).hydra.launcher.ray.init
    assert init.address == "auto"
    assert "object_store_memory" in init and init.object_store_memory is None


def documented():
    for block in re.findall(r"```sh\n(.*?)```", (ROOT / "docs" / "scaling.md").read_text(), re.S):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            launcher = [w.partition("=")[2] for w in words if w.startswith("hydra/launcher=")]
            if launcher:
                yield launcher[0], [w for w in words[1:] if w != "-m"]


@pytest.mark.parametrize(("launcher", "words"), list(documented()), ids=lambda v: str(v)[:40])
def test_documented_sweeps_compose(launcher, words):
    need(launcher)
    compose([f"{key}={value.split(',')[0]}" for key, _, value in (w.partition("=") for w in words)])


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_two_jobs_run(launcher, tmp_path):
    need(launcher)
    command = [sys.executable, "-m", "navrl.cli.train", "-m", f"hydra/launcher={launcher}"]
    sweep = ["seed=0,1", "hydra.sweep.dir=sweep", "hydra.sweep.subdir=${hydra.job.num}"]
    limit = ["hydra.launcher.n_jobs=2"] if launcher == "joblib" else []
    result = subprocess.run(
        [*command, *sweep, *limit, *TINY],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=1200,
    )
    assert result.returncode == 0, result.stderr[-3000:]
    for job in "01":
        assert (tmp_path / "sweep" / job / "evaluation" / "summary.json").is_file()
        assert f"seed: {job}" in (tmp_path / "sweep" / job / "config.yaml").read_text()
