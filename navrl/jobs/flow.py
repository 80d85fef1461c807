"""Training of the scan flow: episodes of a policy, updates, and the file of the weights."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import torch
from omegaconf import DictConfig

from navrl import keys
from navrl.checks import check_counts, is_finite
from navrl.config import instantiate
from navrl.factory.environment import make_device
from navrl.factory.overrides import check_flow
from navrl.factory.policy import make_evaluated_policy
from navrl.networks import ScanFlow
from navrl.networks.scan_flow import save_scan_flow
from navrl.progress_bar import progress_bar
from navrl.training.flow_data import FlowSamples
from navrl.training.interruption import StopRequested, StopSignals, TrainingStoppedError
from navrl.training.provenance import code_version, record_command, recorded_commands
from navrl.worlds import ScenarioBatch

LOG = logging.getLogger(__name__)
WEIGHTS = "scan_flow.safetensors"
_SUITE = "flow"  # name of the episodes, which no suite of an evaluation has
_MAX_ROUNDS = 10_000  # of one seed


def train_flow(cfg: DictConfig, folder: Path) -> str:
    """Train a scan flow and write ``scan_flow.safetensors``.

    Rounds of episodes that are in the folder are read instead of recorded, and an interrupted
    training continues from its checkpoint.

    Args:
        cfg: A composed ``conf/train_flow.yaml``.
        folder: Run folder: ``data/``, ``metrics.csv``, ``checkpoint/`` and the weights.

    Returns:
        One line with the figures on the held-out rounds.

    Raises:
        TrainingStoppedError: If a signal was received; the same command continues.
        ValueError: If a value is out of range or has no effect, or a file is damaged.
    """
    check_flow(cfg)
    num_held_out = _num_held_out(cfg)
    record_command(folder)
    torch.manual_seed(cfg.seed)
    net = instantiate(cfg.flow).to(make_device(cfg))
    record_rounds(cfg, folder, net)
    rounds = [FlowSamples.load(file) for file in _files(cfg, folder)]
    samples = FlowSamples.joined(rounds[:-num_held_out])
    held_out = FlowSamples.joined(rounds[-num_held_out:])
    LOG.info("%d samples, and %d of held-out rounds", len(samples), len(held_out))
    options = {"updates": cfg.updates, "seed": cfg.seed, "progress_bar": cfg.progress_bar}
    trainer = instantiate(cfg.training)(net, samples, held_out, folder, **options)
    scores = trainer.run()
    figures = (
        f"velocity error {scores['velocity_error_median']:.3f} m/s (median) and "
        f"{scores['velocity_error_q90']:.3f} m/s (90 %), {scores['recall']:.1%} of moving returns "
        f"found, {scores['false_share']:.2%} of static returns marked as moving"
    )
    command = recorded_commands(folder).splitlines()[-1].rpartition("  # ")[0]
    file = folder / WEIGHTS
    save_scan_flow(net, file, command=command, commit=code_version(), held_out=figures)
    return f"held out: {figures}; {file}"


def record_rounds(cfg: DictConfig, folder: Path, net: ScanFlow) -> None:
    """Record the rounds of episodes that are missing in ``folder/data``.

    A round depends on the seed and its number only.

    Args:
        cfg: A composed ``conf/train_flow.yaml``.
        folder: Run folder.
        net: Network that the recorded scans have to fit.

    Raises:
        TrainingStoppedError: If a signal was received; recorded rounds are retained.
        ValueError: If the policy or its transforms do not fit.
    """
    files = _files(cfg, folder)
    missing = [number for number, file in enumerate(files) if not file.is_file()]
    if not missing:
        return
    before = len(files) - len(missing)
    with (
        StopSignals() as signals,
        closing(make_evaluated_policy(cfg)) as driver,
        progress_bar(len(files), "round", initial=before, enabled=cfg.progress_bar) as bar,
    ):
        recorder = instantiate(cfg.recorder)(driver.env, driver.policy)
        specs = driver.env.full_observation_spec
        net.check_shapes(specs[keys.FLOW_RANGES].shape, specs[keys.RETURNS].shape)
        try:
            for number, scenarios in _scenarios(cfg, missing):
                with signals.immediate():
                    recorder.record(scenarios, _seed(cfg, number)).save(files[number])
                bar.update()
        except StopRequested:
            assert signals.received is not None
            done = f"{sum(file.is_file() for file in files)} of {len(files)} rounds"
            raise TrainingStoppedError(signals.received, done, folder, "the same command") from None


def _scenarios(cfg: DictConfig, rounds: list[int]) -> Iterator[tuple[int, ScenarioBatch]]:
    """Yield the number and the scenarios of each round."""
    distribution = instantiate(cfg.scenario)
    for number in rounds:
        indices = range(cfg.num_worlds)
        drawn = [distribution.sample(_SUITE, _seed(cfg, number), index) for index in indices]
        yield number, ScenarioBatch.pack(drawn)


def _seed(cfg: DictConfig, number: int) -> int:
    return cfg.seed * _MAX_ROUNDS + number


def _files(cfg: DictConfig, folder: Path) -> list[Path]:
    return [folder / "data" / f"round_{number:04d}.npz" for number in range(cfg.rounds)]


def _num_held_out(cfg: DictConfig) -> int:
    """Return the number of held-out rounds, at least one and not all."""
    check_counts(rounds=cfg.rounds, num_worlds=cfg.num_worlds)
    if not 2 <= cfg.rounds <= _MAX_ROUNDS:
        raise ValueError(f"rounds={cfg.rounds}: must be in 2 to {_MAX_ROUNDS}, one is held out")
    if not (is_finite(cfg.held_out) and 0 < cfg.held_out < 1):
        raise ValueError(f"held_out={cfg.held_out}: must be in (0, 1)")
    return min(max(1, round(cfg.held_out * cfg.rounds)), cfg.rounds - 1)
