"""Everything that training does every step stays on its device, and waits for nothing."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from runs import tiny_trainer

from navrl import keys
from navrl.config import compose, instantiate
from navrl.factory import make_agent
from navrl.factory.environment import make_training_env
from navrl.training.worker import WorkerPolicy

HERE = Path(__file__).parent
KERNELS = {"project_kernel", "points_at_kernel", "step_worlds_kernel", "scan_worlds_kernel"}
KERNELS |= {"add_range_noise_kernel", "min_pool_kernel"}
OPTIONS = ["pool_size=8", "num_worlds=6", "num_threads=1", "experiment=paper"]


FAST = [
    ["experiment=paper", "replay=n_step"],
    ["experiment=subgoal"],
    ["mixed", "experiment=quick"],
]
SLOW = [
    ["experiment=liang", "behavior=guided"],
    ["experiment=paper_literal", "reward=progress_potential"],
    ["asked", "experiment=quick"],
    ["copied", "experiment=quick"],
]
ERRORS = {
    "mixed": "FakeTensorDeviceMismatchError",
    "asked": "DataDependentOutputException",
    "copied": "AssertionError",
}


@pytest.fixture(scope="module")
def fake_training(once):
    """Return a function that gives the result of a case on a device that is not there."""

    def result(case):
        cases = FAST if case in FAST else SLOW
        folder = once(f"fake_cuda_{cases is FAST}", lambda folder: run_all(cases, folder))
        return json.loads((folder / "results.json").read_text())[cases.index(case)]

    return result


def run_all(cases, folder):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", HERE / "fake_cuda.py"],
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1])},
        input=json.dumps(cases),
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    (folder / "results.json").write_text(done.stdout.splitlines()[-1])


def marked(is_planted):
    cases = [(case, ()) for case in FAST] + [(case, pytest.mark.slow) for case in SLOW]
    found = [(case, mark) for case, mark in cases if (case[0] in ERRORS) == is_planted]
    return [pytest.param(case, marks=mark, id=case[0]) for case, mark in found]


@pytest.mark.parametrize("case", marked(is_planted=False))
def test_training_step_stays_on_its_device(case, fake_training):
    launched = fake_training(case)
    assert set(launched) >= KERNELS, launched


@pytest.mark.parametrize("case", marked(is_planted=True))
def test_device_transfer_is_detected(case, fake_training):
    assert fake_training(case) == [ERRORS[case[0]]]


@pytest.mark.gpu
def test_gpu_and_cpu_training_observe_the_same():
    seen = {}
    for device in ("cpu", "cuda"):
        env = make_training_env(compose("train", [*OPTIONS, f"device={device}"]), 0)
        carrier, rows = env.reset(), []
        for step in range(40):
            generator = torch.Generator().manual_seed(step)
            action = torch.rand(6, 2, generator=generator) * 2 - 1
            stepped, carrier = env.step_and_maybe_reset(carrier.set(keys.ACTION, action.to(device)))
            rows.append(
                stepped["next"].select(keys.RANGES, keys.POSE, keys.OUTCOME, "reward").cpu()
            )
        seen[device] = torch.stack(rows)
        env.close()
    for name in (keys.POSE, keys.OUTCOME, "reward"):
        torch.testing.assert_close(seen["cuda"][name], seen["cpu"][name], atol=1e-3, rtol=0)
    differ = (seen["cuda"][keys.RANGES] - seen["cpu"][keys.RANGES]).abs() > 1e-3
    assert differ.float().mean() < 1e-4, "more than beams that graze an edge"


@pytest.mark.gpu
@pytest.mark.parametrize("options", [[], ["collector=process", "collector.num_workers=1"]])
def test_gpu_run_resumes_on_gpu_and_cpu(tmp_path, options):
    options = [*options, "schedule.checkpoint_every_s=1e9", "algorithm.precision=float32"]
    gpu = ["device=cuda", "algorithm.cuda_graph=true"]
    trainer = tiny_trainer(tmp_path, [*options, *gpu])
    assert trainer.run().frames == 480 and trainer.progress.episodes > 0
    saved = trainer.algorithm.state_dict()["loss"]
    assert all(weight.is_cuda for weight in saved.values())
    for device in (gpu, []):
        resumed = tiny_trainer(tmp_path, [*options, *device, "schedule.total_frames=960"])
        resumed._restore()
        for name, weight in resumed.algorithm.state_dict()["loss"].items():
            torch.testing.assert_close(weight.cpu(), saved[name].cpu())
        assert len(resumed.replay) == len(trainer.replay)
        assert resumed.replay.sample()["action"].is_cuda == bool(device)
    assert resumed.run().frames == 960


@pytest.mark.gpu
def test_workers_get_the_weights_of_a_learner_on_a_gpu():
    cfg = compose("train", [*OPTIONS, "device=cuda"])
    actor, _ = make_agent(
        cfg, {"spatial": [180, 2], "temporal": [30, 4], "waypoints_scaled": [5, 2]}
    )
    behavior = instantiate(cfg.behavior, actor=actor, exploration=instantiate(cfg.exploration))
    policy = WorkerPolicy(behavior)
    with torch.no_grad():
        for weight in actor.parameters():
            weight += 1.0
    sent = policy.refresh(7, 2)
    assert all(value.device.type == "cpu" for value in sent.values(True, True))
    for weight, copy in zip(actor.parameters(), policy.actor.parameters(), strict=True):
        assert torch.equal(weight.cpu(), copy) and not copy.requires_grad
