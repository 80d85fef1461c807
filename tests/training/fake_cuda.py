"""A CUDA device without memory, to see on any machine what code asks of one.

torch's fake tensors know the shape, type and device of every result, but no numbers. So tensors of
two devices that meet, and numbers that the host asks for and would have to wait for, are errors. A
few of torch's methods ask for a driver; they are replaced by operations that do not. Compiled
kernels are not run: only where their arguments are is looked at.

``fake_cuda.py`` reads a JSON list of cases: lists of overrides, behind the name of an error to
plant if there is one. It drives a few steps of a training for each, in a fork of its process since
torch does not expect to be treated like this, and prints what each launched, or its error.
"""

import gc
import json
import os
import sys
import traceback
from types import SimpleNamespace

import torch
from torch._subclasses import FakeTensorMode
from torch.overrides import TorchFunctionMode
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp
from torchrl.objectives.utils import TargetNetUpdater

from navrl.config import compose, instantiate
from navrl.envs.rewards import Collision
from navrl.factory import make_agent, make_navigation_env, make_pool, observation_shapes
from navrl.factory.environment import make_training_env, on_cpu
from navrl.ops import backend
from navrl.ops.kernels.cuda.launch import CudaKernel
from navrl.sim import BatchedSimulator
from navrl.training.window import _count_outcomes

OPTIONS = ["device=cuda", "pool_size=8", "num_worlds=6", "num_threads=1", "replay.capacity=100"]
OPTIONS += ["replay.batch_size=4", "behavior.random_frames=0", "replay.num_steps=3"]
PLANTED = {
    "mixed": lambda value: value + torch.zeros(6),
    "asked": lambda value: value * value.sum().item(),
    "copied": lambda value: value * torch.ones(6).to(value.device),
}

_OPS = torch.ops.aten
_CASTS = {"float": torch.float32, "double": torch.float64, "long": torch.int64, "bool": torch.bool}


class _WithoutDriver(TorchFunctionMode):
    """Replace what needs a driver. ``is_strict`` forbids to wait for the device."""

    is_strict = False

    def __torch_function__(self, function, types, arguments=(), keywords=None):
        keywords, first = keywords or {}, arguments[0] if arguments else None
        name = getattr(function, "__name__", "")
        if isinstance(first, torch.Tensor) and function is getattr(torch.Tensor, name, None):
            if name in ("__getitem__", "__setitem__"):
                return _index(*arguments)
            if name == "contiguous" and not keywords:
                return _OPS.clone(first, memory_format=torch.contiguous_format)
            if name == "copy_":
                return _OPS.copy_(*arguments, **keywords)
            if name == "__invert__":
                return _OPS.bitwise_not(first)
            if name in _CASTS:
                return first.to(_CASTS[name])
            if name in ("item", "__int__", "__bool__") and (
                not self.is_strict or not first.is_cuda
            ):
                return False if name == "__bool__" else 0  # whatever it was
        if not self.is_strict and function in (torch.allclose, torch.equal):
            return True
        result = function(*arguments, **keywords)
        if self.is_strict and isinstance(result, torch.Tensor) and result.is_cuda:
            assert name not in ("tensor", "as_tensor"), "numbers copied to the device in every step"
            sources = [value for value in arguments if isinstance(value, torch.Tensor)]
            assert all(value.is_cuda or value.ndim == 0 for value in sources), f"{name} copies"
        return result


def _index(tensor, index, *value):
    """Read or write by an index; basic indices first, then tensors."""
    index = list(index) if isinstance(index, tuple) else [index]
    if not any(part is Ellipsis for part in index):
        index.append(Ellipsis)
    taken = sum(_width(part) for part in index)
    place, tensors = 0, []
    for part in index:
        if part is Ellipsis:
            tensors += [None] * (tensor.ndim - place - taken)
            place = tensor.ndim - taken
            continue
        taken -= _width(part)
        if part is None:
            tensor = tensor.unsqueeze(place)
        elif isinstance(part, slice):
            tensor = _OPS.slice(tensor, place, part.start, part.stop, part.step or 1)
        elif isinstance(part, torch.Tensor):
            tensors.append(part)
            place += _width(part)
            continue
        else:
            tensor = tensor.select(place, int(part))
            continue
        tensors.append(None)
        place += 1
    is_basic = all(part is None for part in tensors)
    if not value:
        return tensor if is_basic else _OPS.index(tensor, tensors)
    value = value[0]
    if not isinstance(value, torch.Tensor):
        value = torch.full((), value, dtype=tensor.dtype, device=tensor.device)
    if is_basic:
        return _OPS.copy_(tensor, value)
    return _OPS.index_put_(tensor, tensors, value.to(tensor.dtype))


def _width(part) -> int:
    """Return how many dimensions of a tensor a part of an index takes."""
    if part is None or part is Ellipsis:
        return 0
    return part.ndim if isinstance(part, torch.Tensor) and part.dtype == torch.bool else 1


def _move_networks(module, device):
    for part in module.modules():
        for name, weight in part._parameters.items():
            if weight is not None:
                part._parameters[name] = torch.nn.Parameter(
                    torch.empty(weight.shape, device=device)
                )
        for name, buffer in part._buffers.items():
            if buffer is not None:
                part._buffers[name] = torch.empty(buffer.shape, dtype=buffer.dtype, device=device)
    return module


def pretend(launched: list[str]) -> None:
    """Let everything in this process find a CUDA device; kernels note their names instead."""

    def launch(kernel, *arguments):
        tensors = [value for value in arguments if isinstance(value, torch.Tensor)]
        assert all(tensor.is_cuda for tensor in tensors), f"{kernel.__name__}: not on the device"
        launched.append(kernel.__name__)

    backend.missing_for_cuda = lambda: None
    torch.cuda.current_device = lambda: 0
    torch.cuda.get_device_properties = lambda _: SimpleNamespace(multi_processor_count=132)
    torch.cuda._lazy_init = lambda: None
    torch.nn.Module.to = _move_networks
    CudaKernel.__call__ = launch
    BatchedSimulator.check_reset = lambda *_: None  # reads numbers, as the next one
    BatchedSimulator._check_last_commands = lambda *_: None
    TargetNetUpdater.init_ = lambda self: setattr(self, "initialized", True)


def drive(cfg, pool, shapes, mode) -> list[torch.Tensor]:
    """Act, step, remember, sample and take the loss; return all that came of it."""
    # Without TorchRL's ActionScaling, whose buffers cannot be fake.
    env = make_navigation_env(cfg, cfg.num_worlds, pool, 0)
    env = TransformedEnv(env, instantiate(cfg.transforms))
    actor, critic = make_agent(cfg, shapes)
    exploration = instantiate(cfg.exploration)
    behavior = instantiate(cfg.behavior, actor=actor, exploration=exploration)
    replay = instantiate(cfg.replay, observation_keys=actor.in_keys)
    learner = instantiate(cfg.algorithm, actor=actor, critic=critic)
    carrier = env.reset()
    env.base_env.simulator._is_ready = True
    for step in range(6):
        mode.is_strict = step > 0  # constants are copied to the device once
        behavior.act(carrier, frames=100_000)
        stepped = env.step(carrier)
        replay.extend(stepped)
        outcomes = _count_outcomes(stepped["next"])
        carrier = step_mdp(stepped)
    terms = learner.loss(replay.sample()[0])
    mode.is_strict = False
    return [*stepped.values(True, True), outcomes, terms["loss_actor"]]


def launched_by(planted: str | None, overrides: list[str]) -> list[str]:
    """Return the names of the kernels that a few steps of a training launch."""
    cfg, launched = compose("train", [*OPTIONS, *overrides]), []
    pool, env = make_pool(cfg), make_training_env(on_cpu(cfg), 0, num_worlds=1)
    shapes = observation_shapes(env)
    if planted is not None:
        collision, plant = Collision.__call__, PLANTED[planted]
        Collision.__call__ = lambda self, step: plant(collision(self, step))
    pretend(launched)
    exploring = set_exploration_type(ExplorationType.RANDOM)
    with FakeTensorMode(allow_non_fake_inputs=True), _WithoutDriver() as mode, exploring:
        with torch.no_grad():
            results = drive(cfg, pool, shapes, mode)
        assert all(value.device.type == "cuda" for value in results)
    return sorted(set(launched))


def result(case: list[str]) -> list[str] | str:
    planted = case[0] if case[0] in PLANTED else None
    try:
        return launched_by(planted, case[planted is not None :])
    except Exception as error:
        return [type(error).__name__] if planted else traceback.format_exc()


if __name__ == "__main__":
    gc.disable()
    results = []
    for case in json.load(sys.stdin):
        reading, writing = os.pipe()
        if os.fork() == 0:
            os.write(writing, json.dumps(result(case)).encode())
            os._exit(0)  # torch cannot take fake tensors down in order
        os.close(writing)
        results.append(json.load(os.fdopen(reading)))
        os.wait()
    print(json.dumps(results))
