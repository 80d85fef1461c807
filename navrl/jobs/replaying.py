"""Replay of a log through a policy: recording, table and summary in a run folder."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import DictConfig, ListConfig

from navrl.config import instantiate
from navrl.deploy import Controller
from navrl.deploy.bags import LogSource, Topics, open_log
from navrl.deploy.recorded_paths import GoalPath, PathPlan, TopicPaths, TrajectoryPaths
from navrl.deploy.replay import Replay
from navrl.deploy.replay_results import replay_recording, replay_summary, replay_table
from navrl.deploy.ros_parameters import has_attention
from navrl.factory.environment import set_threads
from navrl.files import write_json, write_text
from navrl.jobs.run_folder import claim_folder
from navrl.jobs.run_lock import locked
from navrl.ops.scanner import Scanner
from navrl.policies.names import bundle_folder

RECORDING, TABLE, REPLAY_SUMMARY, PICTURE = "episode.npz", "commands.csv", "replay.json", "commands"
_T = TypeVar("_T")
_PATHS = ("auto", "topic", "trajectory")


def run_replay(cfg: DictConfig, folder: Path) -> dict[str, Any]:
    """Replay ``cfg.bag`` through ``cfg.policy`` and write the results to a folder.

    The same command writes the same files, whole ones only, so that it can be killed and repeated.

    Args:
        cfg: A composed ``conf/replay.yaml``.
        folder: Folder of the results: ``episode.npz``, ``commands.csv``, ``replay.json`` and the
            picture ``commands.png``.

    Returns:
        The summary, the content of ``replay.json``.

    Raises:
        ValueError: If a value is out of range or does not fit the log, or the folder has another
            run.
        DamagedFileError: If the log is damaged; the message has file and place.
        ModuleNotFoundError: If it is a bag and the extra ``bags`` is not installed.
    """
    check_replay(cfg)
    set_threads(cfg)
    with locked(folder), closing(open_log(cfg.bag)) as log:
        claim_folder(cfg, folder)
        source = LogSource(log, make_topics(cfg))
        plan, path_source = _make_plan(cfg, source)
        mount = plain_list(cfg.mount)
        given = instantiate(cfg.scanner)
        scanner, mount_source = source.scanner(source.first_scan(), given, mount)
        control = _make_control(cfg, scanner)
        options = {key: cfg[key] for key in ("tick_s", "start_s", "duration_s", "clock")}
        replay = Replay(control, source, plan, **options)
        ticks = list(replay.ticks())
        about = {
            "bag": str(cfg.bag),
            "policy": str(cfg.policy),
            "path": path_source,
            "pose_source": source.pose_source,
            "mount": [float(value) for value in scanner.mount],
            "mount_source": mount_source,
            "scan_topic": source.scan,
            "command_topic": source.command,
        }
        summary = {**about, **replay_summary(ticks, replay.rejected, cfg.tick_s)}
        _write(folder, replay, ticks, summary)
    return summary


def _write(folder: Path, replay: Replay, ticks: list, summary: dict[str, Any]) -> None:
    from navrl.viz.commands import plot_commands

    recording = replay_recording(ticks, replay.control.runner, summary["bag"])
    if recording is not None:
        recording.save(folder / RECORDING)
    write_text(folder / TABLE, replay_table(ticks))
    plot_commands(ticks, folder / f"{PICTURE}.png", f"{summary['policy']} on {summary['bag']}")
    write_json(folder / REPLAY_SUMMARY, summary, indent=2)


def check_replay(cfg: DictConfig) -> None:
    """Check the options before the log is read.

    Raises:
        ValueError: If one is not allowed; the message names it.
    """
    if cfg.path not in _PATHS:
        raise ValueError(f"path={cfg.path}: must be one of {', '.join(_PATHS)}")
    if cfg.goal is not None and cfg.path != "auto":
        raise ValueError(f"path={cfg.path}: no effect with goal={cfg.goal}")
    if bundle_folder(cfg.policy) is None:
        raise ValueError(f"policy={cfg.policy}: must be a bundle, a controller has no scan history")


def plain_list(value: _T) -> list | _T:
    """Return a list of a configuration as a plain one, and another value as it is."""
    return list(value) if isinstance(value, ListConfig) else value


def make_topics(cfg: DictConfig) -> Topics:
    """Return the topics that a configuration chooses."""
    return Topics(
        scan=cfg.scan_topic,
        odometry=cfg.odom_topic,
        pose=cfg.pose_topic,
        path=cfg.plan_topic,
        command=cfg.cmd_vel_topic,
        pose_source=cfg.pose_source,
        global_frame=cfg.global_frame,
        base_frame=cfg.robot_base_frame,
    )


def _make_control(cfg: DictConfig, scanner: Scanner) -> Controller:
    folder = bundle_folder(cfg.policy)
    assert folder is not None  # see check_replay
    return Controller.from_bundle(
        folder,
        scanner,
        instantiate(cfg.limits),
        cfg.compensate_motion,
        safety=instantiate(cfg.safety),
        allow=list(cfg.allow),
        with_attention=has_attention(folder),
    )


def _make_plan(cfg: DictConfig, source: LogSource) -> tuple[PathPlan, str]:
    """Return the paths of a replay, and their source."""
    if cfg.goal is not None:
        goal = plain_list(cfg.goal)
        return GoalPath(goal), f"straight to {goal}"
    if cfg.path == "topic" and source.path is None:
        raise ValueError(f"path=topic: must be in the log, {source.log.file} has no nav_msgs/Path")
    if cfg.path != "trajectory" and source.path is not None:
        return TopicPaths(), source.path
    return TrajectoryPaths(*source.trajectory(), horizon_m=cfg.horizon_m), "trajectory"
