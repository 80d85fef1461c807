"""Recording of training data for the scan flow from episodes of a policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from navrl import keys
from navrl.checks import check_counts, is_finite
from navrl.envs.transformed import base_env
from navrl.sim import BatchedSimulator
from navrl.training.flow_data import MAX_SPEED_MPS, FlowSamples, return_velocity
from navrl.transforms import MinPool, RangeHistory
from navrl.worlds import ScenarioBatch

HIT_MARGIN_M = 0.02  # by which a scan without pedestrians is longer where a beam hits one
MOTIONS = 4  # kinds of motion, one for each quarter of the worlds


class FlowRecorder:
    """Drive a policy through episodes and record scans with the true motion of their returns.

    The robot of world i moves by ``i % 4``: as the policy decides, with noise, slower or not at
    all, or with a constant bias. So the alignment of past scans, which the network reads, has the
    errors of all kinds of motion.

    Args:
        env: Environment over W worlds of the batched simulator. Its transforms write ``points``,
            ``returns`` and, by a :class:`navrl.transforms.RangeHistory`, ``flow_ranges``.
        policy: Maps a TensorDict to one with a normalized action ``[W, C]``.
        num_steps: Steps of an episode at most.
        steps_per_sample: Steps from one recorded scan to the next; the true velocity is the mean
            over this time.
        noise: Standard deviation of the noise on normalized actions.
        bias: Largest constant offset of normalized actions.

    Raises:
        ValueError: If a value is out of range, the transforms lack a step, or the simulator cannot
            scan without pedestrians or has scans with an age.
    """

    def __init__(
        self,
        env: TransformedEnv,
        policy: Callable[[TensorDictBase], TensorDictBase],
        num_steps: int = 60,
        steps_per_sample: int = 2,
        noise: float = 0.3,
        bias: float = 0.5,
    ) -> None:
        """Check the values, the simulator and the transforms."""
        check_counts(num_steps=num_steps, steps_per_sample=steps_per_sample)
        if num_steps < steps_per_sample:
            raise ValueError(f"num_steps={num_steps}: must be >= steps_per_sample")
        for name, value in {"noise": noise, "bias": bias}.items():
            if not (is_finite(value) and value >= 0):
                raise ValueError(f"{name}={value!r}: must be >= 0")
        self.env, self.policy = env, policy
        self.num_steps, self.steps_per_sample = num_steps, steps_per_sample
        self.noise, self.bias = noise, bias
        self._simulator, self._pool = _batched(env), _pooling(env)
        self._duration_s = steps_per_sample * self._simulator.time_step_s

    @torch.no_grad()
    def record(self, scenarios: ScenarioBatch, seed: int) -> FlowSamples:
        """Play one episode in each world.

        Args:
            scenarios: W scenarios.
            seed: Seed of noise and bias of the robot's motion.

        Returns:
            The samples on the CPU, those of all worlds at one time together. Samples at which an
            episode ends, or a pedestrian is moved by the simulation, are left out.
        """
        env, ended = self.env, torch.zeros(len(scenarios), dtype=torch.bool)
        base_env(env).set_scenarios(scenarios)
        prepare = getattr(self.policy, "prepare", None)  # of a controller that plans episodes
        if prepare is not None:
            prepare(scenarios)
        vary, found = self._motion(len(scenarios), seed), []
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            carrier = env.reset()
            scan = self._scan(carrier)
            for step in range(1, self.num_steps + 1):
                decided = self.policy(carrier)
                decided[keys.ACTION] = vary(decided[keys.ACTION], step)
                carrier = step_mdp(env.step(decided), exclude_action=False)
                ended |= cast(Tensor, carrier["done"]).flatten().cpu()
                if step % self.steps_per_sample == 0:
                    found.append(self._labeled(scan, ended))
                    scan = self._scan(carrier)
                if bool(ended.all()):
                    break
        if not found:
            found.append(self._labeled(scan, torch.ones_like(ended)))  # no sample
        return FlowSamples.joined(found)

    def _motion(self, num_worlds: int, seed: int) -> Callable[[Tensor, int], Tensor]:
        """Return the function of action ``[W, C]`` and step that varies the motion."""
        generator = torch.Generator().manual_seed(seed)
        low, high = (bound.cpu().float() for bound in self._simulator.robot.bounds("cpu"))
        still = (-(low + high) / (high - low)).clamp(-1.0, 1.0)  # action of a stationary robot
        size = (num_worlds, len(still))
        noise = self.noise * torch.randn(self.num_steps, *size, generator=generator)
        bias = self.bias * (2.0 * torch.rand(size, generator=generator) - 1.0)
        share = (2.0 * torch.rand(num_worlds, 1, generator=generator) - 1.0).clamp_min(0.0)
        kind = (torch.arange(num_worlds) % MOTIONS)[:, None]

        def vary(action: Tensor, step: int) -> Tensor:
            own = action.cpu()
            varied = torch.where(kind == 1, own + noise[step - 1], own)
            varied = torch.where(kind == 2, still + share * (own - still), varied)
            varied = torch.where(kind == 3, own + bias, varied)
            return varied.clamp(-1.0, 1.0).to(action.device)

        return vary

    def _scan(self, carrier: TensorDictBase) -> dict[str, Tensor]:
        """Return the present scan, the robot's pose and the pedestrians."""
        simulator = self._simulator
        state = simulator.state()
        seen, behind = (
            self._pool.map_values(simulator.ranges(has_pedestrians=flag))[0]
            for flag in (True, False)
        )
        returns = carrier[keys.RETURNS]
        return {
            "ranges": carrier[keys.FLOW_RANGES].half(),
            "points": carrier[keys.POINTS].clone(),
            "returns": returns.clone(),
            "shown": returns & (seen < behind - HIT_MARGIN_M),
            "pose": state.pose,
            "pedestrians": state.pedestrians[..., :2],
        }

    def _labeled(self, scan: dict[str, Tensor], ended: Tensor) -> FlowSamples:
        """Return the samples of a scan, by where the pedestrians are now."""
        after = self._simulator.state().pedestrians[..., :2]
        places = (scan["pose"], scan["pedestrians"], after)
        shown, velocity = return_velocity(scan["points"], scan["shown"], *places, self._duration_s)
        walked = velocity.norm(dim=-1).amax(dim=-1) < MAX_SPEED_MPS
        samples = FlowSamples(scan["ranges"], scan["returns"], shown, velocity.half())
        return samples.to("cpu")[~ended & walked.cpu()]


def _batched(env: TransformedEnv) -> BatchedSimulator:
    simulator = base_env(env).simulator
    if not isinstance(simulator, BatchedSimulator):
        name = type(simulator).__name__
        raise ValueError(f"simulator={name}: must be batched, which scans without pedestrians too")
    if simulator.scan_memory.is_used:
        raise ValueError("timing: must have scans without age, because labels are of the present")
    return simulator


def _pooling(env: TransformedEnv) -> MinPool:
    """Return the pooling of raw scans to the points that the history reads."""
    steps = list(env.transform.modules())
    if not any(isinstance(s, RangeHistory) and keys.FLOW_RANGES in s.out_keys for s in steps):
        raise ValueError(f"transforms: must have a RangeHistory that writes {keys.FLOW_RANGES!r}")
    for step in steps:
        if isinstance(step, MinPool) and (step.in_keys[0], step.out_keys[1]) == (
            keys.RANGES,
            keys.POINTS,
        ):
            return step
    raise ValueError(
        f"transforms.min_pool: must pool {keys.RANGES!r} to {keys.POINTS!r}, without another lidar "
        "or a compensation of motion in between"
    )
