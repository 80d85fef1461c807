"""The command that trains the scan flow: end to end, again, resumed, and its errors."""

import csv
import signal
import sys

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from pages import exit_status
from safetensors import safe_open

from navrl.config import compose, instantiate
from navrl.jobs import flow
from navrl.networks.scan_flow import load_scan_flow
from navrl.training import TrainingStoppedError
from navrl.training.flow_data import FlowSamples
from navrl.training.flow_recorder import FlowRecorder

TINY = (
    *("policy=pure_pursuit", "scenario=corridor", "num_worlds=4", "rounds=3", "held_out=0.4"),
    *("updates=6", "recorder.num_steps=8", "flow.channels=4", "flow.dilations=[1]"),
    *("training.batch_size=4", "training.evaluate_every_updates=3", "progress_bar=false"),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished training and its printed line."""
    folder = tmp_path_factory.mktemp("flow")
    return folder, flow.train_flow(compose("train_flow", TINY), folder)


def weights(folder):
    state = load_scan_flow(folder / "scan_flow.safetensors").state_dict()
    return torch.cat([value.flatten() for value in state.values()])


def data(folder):
    return {file.name: dict(np.load(file)) for file in sorted((folder / "data").glob("*.npz"))}


def equal(one, other):
    assert one.keys() == other.keys()
    return all(
        np.array_equal(value, other[name][key])
        for name, arrays in one.items()
        for key, value in arrays.items()
    )


def test_training_writes_weights_with_provenance(run):
    folder, line = run
    net = load_scan_flow(folder / "scan_flow.safetensors")
    assert net.arguments["channels"] == 4 and net.num_scans == 5
    with safe_open(folder / "scan_flow.safetensors", "pt") as file:
        notes = file.metadata()
    assert notes["held_out"] in line and "m/s (90 %)" in line and "\n" not in line
    assert " at commit " in notes["commit"] and notes["command"] in " ".join(sys.argv) + " "
    header = (folder / "metrics.csv").read_text().splitlines()[0]
    assert header.startswith(
        "frames,updates,train/loss,held_out/loss,held_out/velocity_error_median"
    )
    rows = list(csv.DictReader((folder / "metrics.csv").open()))
    assert [row["updates"] for row in rows] == ["3", "6"]
    recorded = FlowSamples.joined(map(FlowSamples.load, (folder / "data").iterdir()))
    assert recorded.ranges.shape[1:] == (6, 180) and bool(recorded.shown.any())


@pytest.mark.parametrize("steps", ["", "[flow]"])
def test_network_is_trained_on_the_scans_that_it_reads(steps):
    chosen = [f"transforms/steps@change.transforms={steps}"] if steps else []
    trained = compose("train_flow", chosen).change.transforms
    used = compose("evaluate", ["+transforms/steps@change.transforms=flow"]).change.transforms
    names = set(used.flow_history) - {"num_scans"}
    plain = [OmegaConf.to_container(one.flow_history, resolve=False) for one in (trained, used)]
    assert all(plain[0][name] == plain[1][name] for name in names)
    assert trained.flow is None and ("icp_align" in trained) == (not steps)


def test_same_command_has_the_same_numbers(run, tmp_path):
    folder, line = run
    assert flow.train_flow(compose("train_flow", TINY), tmp_path).startswith(line.partition(";")[0])
    assert torch.equal(weights(folder), weights(tmp_path))
    assert equal(data(folder), data(tmp_path))


def test_missing_round_is_recorded_again_and_others_are_read(run, tmp_path, monkeypatch):
    folder, _ = run
    whole = data(folder)
    cfg = compose("train_flow", TINY)
    seeds, record = [], FlowRecorder.record

    def counted(self, scenarios, seed):
        seeds.append(seed)
        return record(self, scenarios, seed)

    monkeypatch.setattr(FlowRecorder, "record", counted)
    (folder / "data" / "round_0001.npz").unlink()
    flow.record_rounds(cfg, folder, instantiate(cfg.flow))
    assert seeds == [1] and equal(data(folder), whole)


def test_held_out_rounds_are_not_trained_on(run, monkeypatch):
    folder, _ = run
    seen = []

    class Spy:
        def __call__(self, net, samples, held_out, folder, **options):
            seen.extend((len(samples), len(held_out)))
            raise KeyboardInterrupt

    instantiate = flow.instantiate
    monkeypatch.setattr(
        flow,
        "instantiate",
        lambda node: Spy() if "batch_size" in (node or {}) else instantiate(node),
    )
    with pytest.raises(KeyboardInterrupt):
        flow.train_flow(compose("train_flow", TINY), folder)
    sizes = [len(arrays["returns"]) for arrays in data(folder).values()]
    assert seen == [sum(sizes[:2]), sizes[2]]


def test_signal_between_rounds_retains_them(tmp_path, monkeypatch):
    record = FlowRecorder.record

    def stopped(self, scenarios, seed):
        if seed == 1:
            signal.raise_signal(signal.SIGTERM)
        return record(self, scenarios, seed)

    monkeypatch.setattr(FlowRecorder, "record", stopped)
    cfg = compose("train_flow", TINY)
    message = "stopped by SIGTERM after 1 of 3 rounds; saved, the same command continues"
    with pytest.raises(TrainingStoppedError, match=message):
        flow.record_rounds(cfg, tmp_path, instantiate(cfg.flow))
    assert [file.name for file in (tmp_path / "data").iterdir()] == ["round_0000.npz"]


@pytest.mark.parametrize(
    "override, message",
    [
        ("suite=hall", r"suite.*=.*: no effect, navrl-train-flow plays the episodes of scenario"),
        ("rounds=1", "rounds=1: must be in 2 to 10000, one is held out"),
        ("held_out=1.0", r"held_out=1\.0: must be in \(0, 1\)"),
        ("num_worlds=0", "num_worlds=0: must be an integer, at least 1"),
        ("flow.kernel_size=4", "kernel_size=4: must be odd"),
    ],
)
def test_wrong_values_are_named(tmp_path, override, message):
    with pytest.raises(Exception, match=message):
        flow.train_flow(compose("train_flow", [*TINY, override]), tmp_path)


def test_command_prints_figures_and_names_errors(run, tmp_path, capsys):
    words = [*TINY, f"hydra.run.dir={tmp_path / 'a'}"]
    assert exit_status("navrl-train-flow", *words) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("held out: velocity error ")
    assert (tmp_path / "a" / "config.yaml").is_file()
    assert exit_status("navrl-train-flow", *words, "seed=1") == 2
    assert "has a run of another configuration (seed is 0 there" in capsys.readouterr().err
    (tmp_path / "a" / "data" / "round_0000.npz").write_bytes(b"PK")
    assert exit_status("navrl-train-flow", *words) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "round_0000.npz: damaged" in line and line.endswith("records it again")


@pytest.mark.parametrize(
    "word, message",
    [
        ("change.transforms.flow_history.num_scans=4", "num_scans=5, got"),
        ("flow.num_bins=90", r"must have 90 bins.* got 180"),
    ],
)
def test_network_is_compared_with_the_scans_first(word, message, tmp_path):
    cfg = compose("train_flow", [*TINY, word])
    with pytest.raises(ValueError, match=message):
        flow.record_rounds(cfg, tmp_path, instantiate(cfg.flow))
    assert not list(tmp_path.rglob("*.npz"))
