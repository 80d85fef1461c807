"""Diagnosis of a log: findings, verdict and a picture in a run folder."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig

from navrl.config import compose, instantiate
from navrl.deploy.bags import LIVE, Log, LogSource, listen, open_log
from navrl.deploy.doctor import LogMeasures, measure_log
from navrl.deploy.doctor_checks import diagnose
from navrl.deploy.doctor_findings import VERDICTS, Checked, Finding, Level, verdict
from navrl.factory.environment import set_threads
from navrl.files import write_json
from navrl.jobs.evaluation import record
from navrl.jobs.replaying import make_topics, plain_list
from navrl.jobs.run_folder import claim_folder
from navrl.jobs.run_lock import locked
from navrl.policies import load_bundle
from navrl.policies.names import bundle_folder
from navrl.sim import Lidar, RobotModel

DIAGNOSIS, PICTURE = "doctor.json", "scan.png"


def run_doctor(cfg: DictConfig, folder: Path) -> tuple[Level, list[Finding]]:
    """Measure ``cfg.bag`` and write the findings to a folder.

    Args:
        cfg: A composed ``conf/doctor.yaml``.
        folder: Folder of ``doctor.json`` and ``scan.png``.

    Returns:
        The most severe level, and all findings.

    Raises:
        ValueError: If a value is out of range or does not fit the log.
        DamagedFileError: If the log is damaged; the message has file and place.
        ModuleNotFoundError: If it is a bag and the extra ``bags`` is not installed, or ROS is not
            sourced for live topics.
    """
    where = bundle_folder(cfg.policy)
    if where is None:
        raise ValueError(f"policy={cfg.policy}: must be a bundle, its lidar is compared")
    set_threads(cfg)
    bundle = load_bundle(where, cfg.allow)
    lidar, robot = bundle.build("lidar"), bundle.build("robot")
    with locked(folder), closing(_opened(cfg)) as log:
        claim_folder(cfg, folder)
        source = LogSource(log, make_topics(cfg))
        mount = plain_list(cfg.mount)
        scanner, origin = source.scanner(source.first_scan(), instantiate(cfg.scanner), mount)
        measures = measure_log(source, scanner, lidar, robot)
        step, limits = bundle.config.get("time_step_s", 0.2), instantiate(cfg.limits)
        near = bundle.config["transforms"].get("min_pool", {}).get("max_range")
        facts = Checked(measures, source, scanner, origin, lidar, robot, limits, step, near)
        findings = diagnose(facts)
        level = verdict(findings)
        _write(cfg, folder, measures, (lidar, robot))
        rows = [
            {"level": f.level.name.lower(), "subject": f.subject, "text": f.text, "do": f.action}
            for f in findings
        ]
        about = {"bag": str(cfg.bag), "policy": str(cfg.policy), "verdict": VERDICTS[level]}
        write_json(folder / DIAGNOSIS, {**about, "findings": rows}, indent=2)
    return level, findings


def _opened(cfg: DictConfig) -> Log:
    """Return the log, after ``cfg.listen_s`` if it is one of live topics."""
    if cfg.bag in LIVE:
        return listen(cfg.bag, cfg.listen_s, cfg.use_sim_time)
    return open_log(cfg.bag)


def _write(
    cfg: DictConfig, folder: Path, measures: LogMeasures, parts: tuple[Lidar, RobotModel]
) -> None:
    """Draw a scan of the log beside one of the training."""
    from navrl.viz.scans import plot_scans

    if measures.sample is None:
        return
    lidar, robot = parts
    scans: list[tuple[str, np.ndarray]] = [(f"{Path(cfg.bag).name}, as seen", measures.sample)]
    if cfg.training_scan:
        scans.append((f"training scan of {cfg.policy}", _training_scan(str(cfg.policy))))
    plot_scans(scans, lidar, float(robot.radius), folder / PICTURE)


def _training_scan(policy: str) -> np.ndarray:
    """Return a scan of a simulated episode of the policy, ``[N]`` m."""
    overrides = [f"policy={policy}", "environment.time_limit_steps=1", "num_threads=1"]
    return np.asarray(record(compose("play", overrides)).ranges[0])


def shown(findings: list[Finding]) -> list[str]:
    """Return the lines that a person reads, one or two per finding."""
    marks = {Level.OK: "ok     ", Level.WARNING: "warning", Level.FAILURE: "FAILURE"}
    lines: list[str] = []
    for finding in findings:
        lines.append(f"{marks[finding.level]}  {finding.subject}: {finding.text}")
        if finding.action:
            lines.append(f"         -> {finding.action}")
    return lines


def outcome(level: Level, is_strict: bool) -> dict[str, Any]:
    """Return verdict and exit status: 0, or 3 if it will not work; strict counts warnings too."""
    failed = level is Level.FAILURE or (is_strict and level is Level.WARNING)
    return {"verdict": VERDICTS[level], "status": 3 if failed else 0}
