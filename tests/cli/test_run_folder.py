"""A folder of results belongs to one process at a time and to one configuration."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor

import pytest
from hydra.core.utils import setup_globals
from omegaconf import OmegaConf

from navrl.config import compose
from navrl.jobs import locked, new_folder, record_config, resumed_config
from navrl.jobs.sweeps import NewFolder

SMALL = ["experiment=quick", "network=small", "scenario=corridor"]


def test_folder_in_use_names_its_holder(tmp_path):
    with locked(tmp_path / "run"):
        with pytest.raises(ValueError, match=rf"run: in use by process {os.getpid()} on \S+ since"):
            locked(tmp_path / "run").__enter__()
        with locked(tmp_path / "other"):
            pass
    with locked(tmp_path / "run"):
        pass


def test_lock_ends_with_its_process(tmp_path):
    """A ``kill -9`` leaves no stale lock, even if the process has forked."""
    reading, writing = os.pipe()
    holder = os.fork()
    if not holder:
        with locked(tmp_path):
            child = os.fork()
            if child:
                os.write(writing, str(child).encode())
            signal.pause()
        os._exit(0)
    child = int(os.read(reading, 20))
    try:
        with pytest.raises(ValueError, match=f"in use by process {holder} "):
            locked(tmp_path).__enter__()
        os.kill(holder, signal.SIGKILL)
        os.waitpid(holder, 0)
        with locked(tmp_path):
            pass
    finally:
        os.kill(child, signal.SIGKILL)


def test_lock_does_not_follow_links(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("text")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".lock").symlink_to(precious)
    with pytest.raises(OSError, match="symbolic"):
        locked(tmp_path / "run").__enter__()
    assert precious.read_text() == "text"


def test_new_folders_are_exclusive(tmp_path):
    with ThreadPoolExecutor(8) as threads:
        folders = list(threads.map(new_folder, [tmp_path / "a" / "run"] * 8))
    assert {folder.name for folder in folders} == {"run", *(f"run_{k}" for k in range(2, 9))}


def hydra_config(folder):
    setup_globals()  # the resolver of the time
    node = {"dir": f"{folder}/it's ${{now:%Y}}"}
    return OmegaConf.create(
        {"hydra": {"run": node, "sweep": node, "overrides": {"hydra": []}}},
        flags={"readonly": True},
    )


def test_jobs_of_the_same_second_get_own_folders(tmp_path):
    folders = []
    for _ in range(3):
        config = hydra_config(tmp_path)
        NewFolder().on_run_start(config)
        folders.append(config.hydra.run.dir)
    assert len(set(folders)) == 3 and all(map(os.path.isdir, folders))


def test_jobs_of_a_sweep_share_its_new_folder(tmp_path):
    for name in ("first", "second"):
        config = hydra_config(tmp_path)
        NewFolder().on_multirun_start(config)
        (override,) = config.hydra.overrides.hydra
        job = compose("train", [override.replace("hydra.sweep.dir", "+sweep_folder")])
        assert job.sweep_folder == config.hydra.sweep.dir, name
    assert len(os.listdir(tmp_path)) == 2


def test_folder_chosen_by_the_user_is_used_unchanged(tmp_path):
    config = OmegaConf.create({"hydra": {"run": {"dir": str(tmp_path)}}})
    NewFolder().on_run_start(config)
    assert config.hydra.run.dir == str(tmp_path)


@pytest.fixture
def run(tmp_path):
    """A folder with a run of ``SMALL``."""
    cfg = compose("train", [*SMALL, "seed=3"])
    OmegaConf.save(cfg, tmp_path / "config.yaml")
    record_config(cfg, tmp_path)
    return tmp_path


def resumed(folder, *overrides):
    words = [f"resume={folder}", *overrides]
    return resumed_config(folder, compose("train", words), words)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["seed=7"], r"^seed=7: the run has seed=3; resume="),
        (["seed=0"], r"^seed=0: the run has seed=3"),  # the default, but asked for
        (["network=paper"], r"network\.\S+=.*: the run has network\."),
        (["experiment=paper"], "the run has"),
        (["+algorithm.other=1"], r"algorithm\.other=1: the run has algorithm\.other=missing"),
        (["simulator@final_simulator=bullet"], r"final_simulator\.\S+: the run has"),
    ],
)
def test_resume_rejects_values_other_than_the_runs(run, overrides, message):
    with pytest.raises(ValueError, match=message):
        resumed(run, *overrides)


def test_resume_accepts_values_that_change_no_result(run):
    cfg = resumed(run, "device=cuda", "num_threads=1", "progress_bar=false")
    assert (cfg.device, cfg.num_threads, cfg.progress_bar) == ("cuda", 1, False)
    assert cfg.seed == 3 and cfg.resume is None


def test_resume_accepts_the_original_command(run):
    assert resumed(run, *SMALL, "seed=3").seed == 3


def test_edited_configuration_is_detected(run):
    file = run / "config.yaml"
    text = file.read_text()
    file.write_text(text.replace("num_threads: null", "num_threads: 1"))
    assert resumed(run).num_threads == 1
    file.write_text(text.replace("gamma: 0.98", "gamma: 0.9"))
    with pytest.raises(
        ValueError, match=r"edited since the run began \(algorithm.gamma was 0.98 and is 0.9"
    ):
        resumed(run)
    file.write_text("")
    with pytest.raises(ValueError, match=r"config\.yaml: damaged"):
        resumed(run)
    (run / "checkpoint" / "config.yaml").unlink()  # a run from before there was a record
    file.write_text(text.replace("seed: 3", "seed: 4"))
    assert resumed(run).seed == 4
