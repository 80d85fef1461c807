"""The learner is fed by workers of every kind, and they follow it."""

import importlib.util
import multiprocessing

import pytest
import torch
from runs import TINY, tiny_trainer
from tensordict import TensorDict
from torchrl.collectors import Collector as TorchRLCollector

from navrl import factory, keys
from navrl.config import compose, describe
from navrl.training.worker import WorkerBatch, WorkerEnv, worker_seed

WATCHED = [
    "replay.storage=float32",
    "behavior=paper",
    "behavior.random_frames=0",
    "exploration.sigma_initial=0",
    "exploration.sigma_final=0",
    "algorithm.actor_learning_rate=0.01",  # so that new weights show
    "collector.steps_per_batch=5",
    "curriculum.levels=[1,2]",
    "schedule.total_frames=400",
    "schedule.evaluate_every_updates=5",
    "schedule.checkpoint_every_s=1000",
]
needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="needs the extra ray"
)
KINDS = [
    ["collector=process"],
    pytest.param(["collector=process", "collector.sync=true"], marks=pytest.mark.slow),
    pytest.param(["collector=ray"], marks=needs_ray),
    pytest.param(["collector=ray", "collector.sync=true"], marks=[needs_ray, pytest.mark.slow]),
    pytest.param(["collector=distributed"], marks=pytest.mark.slow),  # a printed command runs it
    pytest.param(["collector=distributed", "collector.sync=true"], marks=pytest.mark.slow),
]


class Watched:
    """A small trainer that remembers what its workers sent and what they were sent."""

    def __init__(self, folder, overrides):
        self.trainer = tiny_trainer(folder, [*WATCHED, *overrides])
        self.trainer.evaluate = lambda max_dynamic: {"success_rate": 1.0}
        self.trainer.on_best, self.trainer.saved_best = lambda metrics: None, None
        self.steps, self.pushed = [], []
        collector = self.trainer.collector
        step, push = collector.step, collector._push

        def remembering_step(frames, phases):
            worker, transitions = step(frames, phases)
            self.steps.append((worker, transitions.clone()))
            return worker, transitions

        def remembering_push(frames, workers):
            actor = self.trainer.algorithm.actor
            self.pushed.append({k: v.clone() for k, v in actor.state_dict().items()})
            push(frames, workers)

        collector.step, collector._push = remembering_step, remembering_push

    def version(self, worker, index):
        """Return the first of the pushed weights that explains a step's actions."""
        actor = self.trainer.algorithm.actor
        step = [transitions for sender, transitions in self.steps if sender == worker][index]
        inputs = TensorDict({key: step[key] for key in actor.in_keys}, step.batch_size)
        for version, weights in enumerate(self.pushed):
            actor.load_state_dict(weights)
            with torch.no_grad():
                error = (actor(inputs)[keys.ACTION] - step[keys.ACTION]).abs().max()
            if error < 1e-5:
                return version
        raise AssertionError(f"worker {worker} acted by weights that it was never sent")


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_workers_send_transitions_and_receive_weights(kind, tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_worker_niceness", "0")  # Ray's default, 15, starves on a busy machine
    watched = Watched(tmp_path, kind)
    progress = watched.trainer.run()
    assert progress.frames == 400
    assert progress.updates == (400 - 40) // 8
    for worker in (0, 1):
        assert watched.version(worker, 0) == 0
        assert watched.version(worker, -1) > 1, "no new weights arrived"
        levels = [int(s[keys.MAX_DYNAMIC].amax()) for w, s in watched.steps if w == worker]
        assert levels == sorted(levels) and levels[0] == 1
        assert levels[-1] == 2, "the curriculum's level did not arrive"
    first, second = (next(s for w, s in watched.steps if w == worker) for worker in (0, 1))
    assert not torch.equal(first["waypoints_scaled"], second["waypoints_scaled"]), (
        "workers see the same worlds"
    )
    assert not multiprocessing.active_children()
    if kind == ["collector=ray"]:
        import ray

        assert not ray.is_initialized()


@pytest.mark.slow
def test_failed_worker_ends_the_run(tmp_path):
    """Rather than letting it wait for ever; what the last checkpoint holds is safe."""
    trainer = Watched(tmp_path, ["collector=process"]).trainer
    collector, step = trainer.collector, trainer.collector.step

    def murderous_step(frames, phases):
        if frames == 120:
            collector._workers.procs[1].kill()
            collector._workers.procs[1].join()
        return step(frames, phases)

    collector.step = murderous_step
    with pytest.raises(RuntimeError, match="a worker has died"):
        trainer.run()
    assert not multiprocessing.active_children()


@pytest.mark.slow
def test_synchronous_workers_are_reproducible(tmp_path):
    runs = []
    for name in ("a", "b"):
        overrides = ["collector=process", "collector.sync=true", "schedule.total_frames=160"]
        watched = Watched(tmp_path / name, overrides)
        watched.trainer.run()
        runs.append(watched.steps)
    for (worker, step), (other, again) in zip(*runs, strict=True):
        assert worker == other
        ids = "collector"  # TorchRL counts trajectories on, over all runs of a process
        assert (step.exclude(ids) == again.exclude(ids)).all()


@pytest.mark.slow
def test_a_run_with_workers_resumes_with_the_same_learner(tmp_path):
    overrides = ["collector=process", "replay.num_steps=3"]
    trainer = Watched(tmp_path, overrides).trainer
    trainer.run()
    resumed = Watched(tmp_path, [*overrides, "schedule.total_frames=560"]).trainer
    resumed._restore()
    for name, value in trainer.algorithm.state_dict()["loss"].items():
        assert torch.equal(value, resumed.algorithm.state_dict()["loss"][name]), name
    assert vars(resumed.progress) == vars(trainer.progress)
    assert len(resumed.replay) == len(trainer.replay)
    assert not resumed.replay.save(tmp_path / "journal")["streams"], "steps of old episodes"
    assert resumed.run().frames == 560


def test_curriculum_level_reaches_the_worlds(tmp_path):
    """Not only the transitions: the worker's environment draws by it."""
    trainer = Watched(tmp_path, ["collector=process"]).trainer
    env = WorkerEnv(trainer.collector.make_env, 0, 1, max_dynamic=1)()
    assert env.base_env.max_dynamic == 1
    trainer.collector.policy.refresh(0, max_dynamic=2)
    env.step(trainer.collector.policy(env.reset()))
    assert env.base_env.max_dynamic == 2


def test_worker_seeds_differ_and_do_not_change():
    seeds = {worker_seed(seed, worker) for seed in range(10) for worker in range(100)}
    assert len(seeds) == 1000
    assert worker_seed(3, 1) == worker_seed(3, 1)
    assert worker_seed(3, 1, 1000) != worker_seed(3, 1), "a resumed run repeats its episodes"


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["collector=process", "collector.num_workers=0"], "num_workers=0: must be >= 1"),
        (["collector=process", "collector.storage=int8"], "'int8': must be one of"),
        (["collector=distributed", "collector.launcher=pbs"], "launcher='pbs': must be one of"),
    ],
)
def test_bad_collectors_are_named(overrides, message, tmp_path):
    with pytest.raises(Exception, match="collector") as caught:
        factory.make_trainer(compose("train", [*TINY, *overrides]), tmp_path)
    assert message in describe(caught.value)


def test_missing_ray_is_named(monkeypatch, tmp_path):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "ray" else find(name, *a)
    )
    with pytest.raises(Exception, match="ray") as caught:
        factory.make_trainer(compose("train", [*TINY, "collector=ray"]), tmp_path)
    assert "collector=ray: needs ray" in describe(caught.value)
    assert "pip install -e '.[ray]'" in describe(caught.value)


def test_workers_begin_an_episode_without_a_last_action(tmp_path):
    """Neither that of the episode before, nor the zeros that a collector begins with."""
    trainer = tiny_trainer(tmp_path, ["collector=process", "environment.time_limit_steps=3"])
    policy, seen = trainer.collector.policy, []

    def guide(tensordict):
        last = tensordict.get(keys.ACTION, None)
        seen.append(last is None or bool(last.isnan().all()))
        return tensordict.set(keys.ACTION, torch.zeros(*tensordict.batch_size, 2))

    policy.behavior.guide, policy.behavior.guided_fraction = guide, 1.0
    policy.refresh(0, max_dynamic=2)
    env = WorkerEnv(trainer.collector.make_env, 0, 1, max_dynamic=2)
    collector = TorchRLCollector(env, policy, frames_per_batch=4 * 7, total_frames=4 * 7)
    for batch in collector:
        small = WorkerBatch(trainer.collector.compact, 0)(batch)
        assert not small[keys.ACTION].isnan().any()
    collector.shutdown()
    assert seen[-7:] == [True, False, False, True, False, False, True]


def test_workers_carry_correlated_noise_within_an_episode(tmp_path):
    options = ["exploration=correlated", "exploration.correlation_time_s=1e9"]  # does not change
    words = ["collector=process", "environment.time_limit_steps=3", *options]
    trainer = tiny_trainer(tmp_path, words)
    policy = trainer.collector.policy
    policy.refresh(0, max_dynamic=2)
    env = WorkerEnv(trainer.collector.make_env, 0, 1, max_dynamic=2)
    collector = TorchRLCollector(env, policy, frames_per_batch=4 * 7, total_frames=4 * 7)
    (batch,) = collector
    collector.shutdown()
    change = batch[keys.EXPLORATION_NOISE].diff(dim=1).abs().amax(dim=(0, 2))
    assert [bool(step > 1e-3) for step in change] == [False, False, True, False, False, True]
