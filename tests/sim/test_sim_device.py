"""Which device a simulator runs on, and what it says there."""

import pytest
import torch
from scenes import pack, scene

from navrl.ops import backend
from navrl.ops.backend import find_device
from navrl.sim import BatchedSimulator, BulletSimulator, DifferentialDrive, Lidar


def simulator(device="cpu", num_worlds=2):
    sim = BatchedSimulator(num_worlds, DifferentialDrive(), Lidar(num_beams=8), device=device)
    sim.reset(torch.arange(num_worlds), pack(*[scene()] * num_worlds))
    return sim


@pytest.mark.parametrize("device", ["gpu", "cuda:", "cuda:x", "meta", "mps", ""])
def test_unsupported_device_error_lists_allowed_devices(device):
    with pytest.raises(ValueError, match=f"device='{device}': must be cpu or cuda"):
        find_device(device)


def test_missing_gpu_package_is_named(monkeypatch):
    monkeypatch.setattr(backend, "missing_for_cuda", lambda: "a driver")
    with pytest.raises(ValueError, match="device='cuda': needs a driver; device='cpu' works"):
        simulator("cuda")


def test_non_current_cuda_device_is_rejected(monkeypatch):
    monkeypatch.setattr(backend, "missing_for_cuda", lambda: None)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)
    assert find_device("cuda") == find_device("cuda:1") == torch.device("cuda:1")
    with pytest.raises(ValueError, match="must be the current CUDA device, cuda:1"):
        find_device("cuda:0")


def test_pybullet_runs_on_the_cpu_only():
    with pytest.raises(ValueError, match="device='cuda': must be cpu for PyBullet"):
        BulletSimulator(1, DifferentialDrive(), Lidar(), device="cuda")


def test_non_finite_command_is_reported_at_the_next_reset():
    sim = simulator()
    sim.device = torch.device("cuda")  # only to take the device's way; all is on the CPU
    command = torch.tensor([[0.5, torch.nan], [-torch.inf, 1.0]])
    assert sim._finite(command).tolist() == [[0.5, 0.0], [0.0, 1.0]]
    assert sim._finite(command.nan_to_num()).isfinite().all()
    with pytest.raises(ValueError, match="command: must be finite"):
        sim._check_last_commands()
    sim._check_last_commands()  # once


@pytest.mark.gpu
def test_gpu_reports_non_finite_command_at_the_next_reset():
    sim = simulator("cuda")
    pose = sim.step(torch.tensor([[0.5, torch.nan], [0.5, 0.0]], device="cuda")).pose
    assert pose.isfinite().all()
    with pytest.raises(ValueError, match="command: must be finite"):
        sim.reset(torch.tensor([0]), pack(scene()))
    sim.reset(torch.tensor([0], device="cuda"), pack(scene()).to("cuda"))
