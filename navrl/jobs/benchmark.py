"""Rows of the benchmark, built from a configuration."""

from __future__ import annotations

import functools
import logging
import math
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.envs import TransformedEnv

from navrl import benchmarks
from navrl.algos import DDPG
from navrl.algos.precision import Precision
from navrl.benchmarks import Budget, Report, Row, Series
from navrl.config import compose, instantiate
from navrl.deploy import PolicyRunner, SafetyLimits
from navrl.extras import require
from navrl.factory.environment import (
    make_device,
    make_env,
    make_navigation_env,
    make_pool,
    num_threads,
    on_cpu,
)
from navrl.factory.training import make_agent, make_collector, make_trainer, observation_shapes
from navrl.jobs.exporting import export
from navrl.jobs.row_names import check_rows
from navrl.ops.backend import missing_for_cuda
from navrl.policies.names import bundle_folder
from navrl.sim import Simulator
from navrl.training import Collector, Replay
from navrl.viz import plot_benchmark
from navrl.worlds import ScenarioPool

log = logging.getLogger(__name__)
Results = Sequence[Row | Series | str]
_DEPLOYED = "paper"  # the policy of the rows "deploy"
_COMPILED_WORLDS = 64


def run_benchmark(cfg: DictConfig, folder: Path) -> Report:
    """Measure the rows of ``cfg.rows``, in that order, and draw them.

    Args:
        cfg: A composed ``conf/benchmark.yaml``.
        folder: Folder of ``benchmark.json``, updated after each row, and of the picture.

    Raises:
        ValueError: If a row is unknown or named twice, if none can be measured, or ``cfg.device``
            is not the CPU.
    """
    if make_device(cfg).type != "cpu":
        raise ValueError(f"device={cfg.device}: rows=[gpu] measures a GPU, all others the cpu")
    check_rows(cfg.rows)
    report = Report(benchmarks.describe_machine(), factor=cfg.effort.published_factor)
    for name in cfg.rows:
        log.info("measuring %s", name)
        report.add(*MEASURED[name](cfg))
        report.save(folder / "benchmark.json")
    if not report.rows:
        raise ValueError(f"rows={list(cfg.rows)}: nothing to measure; {'; '.join(report.skipped)}")
    plot_benchmark(folder / "benchmark.json", folder / "benchmark")
    return report


def _scan(cfg: DictConfig) -> Results:
    return benchmarks.scan_rows(
        functools.partial(_simulator, cfg),
        functools.partial(_simulator, _on_bullet(cfg)),
        cfg.num_worlds,
        _budget(cfg),
        num_threads(cfg),
    )


def _peers(cfg: DictConfig) -> Results:
    return benchmarks.peer_rows(functools.partial(_simulator, cfg), cfg.num_worlds, _budget(cfg))


def _step(cfg: DictConfig) -> Results:
    pool = make_pool(cfg)
    return benchmarks.step_rows(
        _maker(cfg, pool),
        _maker(_on_bullet(cfg), pool),
        cfg.effort.step_worlds,
        cfg.effort.bullet_worlds,
        _budget(cfg),
        num_threads(cfg),
    )


def _icp_tagd(cfg: DictConfig) -> Results:
    variants = {}
    for name in ("paper", "robust"):
        steps = compose("train", [f"transforms={name}"]).transforms
        variants[name] = instantiate(steps.icp_align), instantiate(steps.tagd)
    return benchmarks.perception_rows(_maker(cfg)(cfg.effort.step_worlds), variants, _budget(cfg))


def _compile(cfg: DictConfig) -> Results:
    steps = cfg.transforms
    parts = [instantiate(step) for step in (steps.min_pool, steps.icp_align, steps.tagd)]
    return benchmarks.compile_rows(_maker(cfg)(_COMPILED_WORLDS), parts, _budget(cfg))


def _growth(cfg: DictConfig) -> Results:
    sizes, budget, make = cfg.effort.sizes, _budget(cfg), _maker(cfg)
    found: list[Series | str] = [
        benchmarks.worlds_series(make, list(sizes.worlds), budget),
        *benchmarks.growth_series(
            functools.partial(_simulator, cfg),
            cfg.num_worlds,
            budget,
            list(sizes.beams),
            list(sizes.boxes),
            list(sizes.pedestrians),
        ),
    ]
    threads = [n for n in (1, 2, 4, 8, 16, 32, 64, 128) if n <= num_threads(cfg)]
    if len(threads) < 2:
        return [*found, "growth with threads: there is one core"]
    return [*found, benchmarks.threads_series(make, cfg.effort.step_worlds, threads, budget)]


def _memory(cfg: DictConfig) -> Results:
    return [benchmarks.memory_row(_maker(cfg), cfg.effort.memory_worlds)]


def _update(cfg: DictConfig) -> Results:
    env = _maker(cfg)(1)
    shapes = observation_shapes(env)
    env.close()
    actor, _ = make_agent(cfg, shapes)
    return [
        row
        for device in ("cpu", *(["cuda"] if torch.cuda.is_available() else []))
        for row in benchmarks.update_rows(
            functools.partial(_learner, cfg, shapes),
            {key: shapes[key] for key in actor.in_keys},
            cfg.replay.batch_size,
            Precision(cfg.algorithm.precision, torch.device(device)).name,
            _budget(cfg),
            num_threads(cfg),
            device,
        )
    ]


def _training(cfg: DictConfig) -> Results:
    with tempfile.TemporaryDirectory() as folder:
        log = _train(cfg, cfg.effort.updates_per_row, Path(folder))
        return benchmarks.training_rows(log, num_threads(cfg))


def _train(cfg: DictConfig, updates: int, folder: Path) -> Path:
    """Run a training that logs every ``updates`` updates; return its log."""
    cfg = cfg.copy()
    cfg.schedule.learning_starts = 4 * cfg.replay.batch_size
    cfg.schedule.log_every_updates = updates
    cfg.schedule.evaluate_every_updates = 10**9
    cfg.schedule.checkpoint_every_s = 1e9
    total_updates = updates * (cfg.effort.repeats + 1)
    cfg.schedule.total_frames = int(
        cfg.schedule.learning_starts + total_updates * cfg.schedule.frames_per_update
    )
    cfg.behavior.random_frames = 0
    cfg.replay.capacity = cfg.schedule.total_frames + cfg.num_worlds
    cfg.validation.num_episodes = 2
    make_trainer(cfg, folder).run()
    return folder / "metrics.csv"


def _gpu(cfg: DictConfig) -> Results:
    missing = missing_for_cuda()
    if missing is not None:
        return [f"gpu: needs {missing}"]
    cfg, effort = cfg.copy(), cfg.effort
    cfg.device, cfg.num_worlds = "cuda", effort.gpu_worlds
    env = _maker(on_cpu(cfg))(1)
    shapes = observation_shapes(env)
    env.close()
    learners = {
        name: _learner(cfg, shapes, cfg.algorithm.precision, "cuda", cuda_graph=name == "recorded")
        for name in ("eager", "recorded")
    }
    needed = {key: shapes[key] for key in learners["eager"].actor.in_keys}
    cfg.algorithm.cuda_graph = True
    with tempfile.TemporaryDirectory() as folder:
        updates = math.ceil(cfg.num_worlds / cfg.schedule.frames_per_update)
        rows = benchmarks.training_rows(_train(cfg, updates, Path(folder)), 1)
    return benchmarks.gpu_rows(
        _simulator(cfg, cfg.num_worlds),
        _maker(cfg)(cfg.num_worlds),
        learners,
        benchmarks.random_transitions(needed, cfg.replay.batch_size, "cuda"),
        next(row.values for row in rows if row.key == "training.frames"),
        _budget(cfg),
    )


def _workers(cfg: DictConfig) -> Results:
    cores = num_threads(cfg)
    counts = [count for count in cfg.effort.sizes.workers if count <= cores]
    return benchmarks.worker_rows(functools.partial(_source, cfg), counts, _budget(cfg))


def _latency(cfg: DictConfig) -> Results:
    raw = make_navigation_env(cfg, 1, make_pool(cfg), cfg.seed)
    drive = benchmarks.record_drive(raw, cfg.effort.scans)
    env = make_env(raw, instantiate(cfg.transforms))
    actor, _ = make_agent(cfg, observation_shapes(env))
    env.close()
    transforms, lidar, robot = (instantiate(cfg[k]) for k in ("transforms", "lidar", "robot"))
    runner = PolicyRunner(transforms, actor.eval(), lidar, robot, SafetyLimits.simulated())
    return benchmarks.latency_rows(runner, drive, cfg.effort.repeats)


def _startup(cfg: DictConfig) -> Results:
    return benchmarks.startup_rows(cfg.effort.repeats)


def _deploy(cfg: DictConfig) -> Results:
    try:
        require("onnx", "deploy", "onnx", "onnxscript", "onnxruntime")
    except ModuleNotFoundError as error:
        return [str(error)]
    from navrl.export import OnnxPolicy

    bundle = bundle_folder(_DEPLOYED)
    assert bundle is not None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{_DEPLOYED}.onnx"
        export(compose("export", [f"policy={_DEPLOYED}", f"golden_steps={cfg.effort.scans}"]), file)
        golden = OnnxPolicy(file, check_steps=0).golden()
        return benchmarks.deploy_rows(bundle, file, golden, cfg.effort.repeats)


MEASURED: dict[str, Callable[[DictConfig], Results]] = {
    "scan": _scan,
    "peers": _peers,
    "step": _step,
    "icp_tagd": _icp_tagd,
    "growth": _growth,
    "memory": _memory,
    "update": _update,
    "training": _training,
    "workers": _workers,
    "latency": _latency,
    "startup": _startup,
    "deploy": _deploy,
    "compile": _compile,
    "gpu": _gpu,
}


def _budget(cfg: DictConfig) -> Budget:
    return Budget(cfg.effort.seconds, cfg.effort.repeats)


def _on_bullet(cfg: DictConfig) -> DictConfig:
    """Return the configuration with the reference simulator."""
    copy = cfg.copy()
    OmegaConf.set_struct(copy, False)
    copy.device = "cpu"  # the only device of PyBullet
    copy.simulator = compose("train", ["simulator=bullet"]).simulator
    return copy


def _simulator(
    cfg: DictConfig, num_worlds: int, num_beams: int | None = None, max_pedestrians: int = 1
) -> Simulator:
    beams = {} if num_beams is None else {"num_beams": num_beams}
    return instantiate(
        cfg.simulator,
        num_worlds=num_worlds,
        lidar=instantiate(cfg.lidar, **beams),
        max_pedestrians=max_pedestrians,
    )


def _maker(cfg: DictConfig, pool: ScenarioPool | None = None) -> Callable[[int], TransformedEnv]:
    """Return a factory of environments with any number of worlds on the same scenarios."""
    return functools.partial(_env, cfg, make_pool(cfg) if pool is None else pool)


def _env(cfg: DictConfig, pool: ScenarioPool, num_worlds: int) -> TransformedEnv:
    env = make_navigation_env(cfg, num_worlds, pool, cfg.seed)
    return make_env(env, instantiate(cfg.transforms))


def _source(cfg: DictConfig, num_workers: int) -> tuple[Collector, Replay]:
    """Return a collector with ``num_workers`` processes, or in this one, and a replay buffer."""
    cfg = cfg.copy()
    options = ["collector=process", f"collector.num_workers={num_workers}"]
    cfg.collector = compose("train", options if num_workers else ["collector=direct"]).collector
    cfg.behavior.random_frames = 0
    cfg.replay.capacity = 100_000
    env = _maker(cfg)(1)
    actor, _ = make_agent(cfg, observation_shapes(env))
    env.close()
    replay = instantiate(cfg.replay, observation_keys=actor.in_keys)
    return make_collector(cfg, actor), replay


def _learner(
    cfg: DictConfig,
    shapes: dict[str, list[int]],
    precision: str,
    device: str,
    cuda_graph: bool = False,
) -> DDPG:
    actor, critic = (network.to(device) for network in make_agent(cfg, shapes))
    options = {"precision": precision, "cuda_graph": cuda_graph}
    return instantiate(cfg.algorithm, actor=actor, critic=critic, **options)
