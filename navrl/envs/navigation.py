"""Batched TorchRL environment of the navigation task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from navrl import keys
from navrl.envs.observations import observation_spec, privileged_observation
from navrl.envs.outcome import Outcome, classify
from navrl.envs.rewards import Transition
from navrl.ops.path import path_length, project_onto_path
from navrl.sim import Contact, Localization, SimState, Simulator
from navrl.sim.localization import PoseMemory
from navrl.transforms.base_motion import Base
from navrl.worlds import MAX_PATH_POINTS, ScenarioBatch, ScenarioPool

RewardTerm = Callable[[Transition], Tensor]

_STATE = (
    *("_path", "_path_length", "_goal", "_noise_seed", "_steps", "_progress", "_position"),
    *("_ranges", "_outcome", "_command"),
)


class NavigationEnv(EnvBase):
    """Drive N robots to their goals among non-reactive pedestrians.

    **Action** ``action [N, C]``: the robot's command, within its limits; of a differential drive
    ``[N, 2]``, (v, w) in m/s and rad/s.

    **Observation** (transforms compute everything else):

    ============  ================  ======================================================
    key           shape             meaning
    ============  ================  ======================================================
    ranges        ``[N, beams]`` m  noisy scan, beam j at 2 pi j / beams in the lidar's frame
    measured      ``[N, beams]``    bool, false for blind beams; only if the lidar has such
    scan_motion   ``[N, 2, 3]``     robot at first and last beam, in its present frame
    pose          ``[N, 3]``        (x, y, yaw), world frame, as the localization reports it
    velocity      ``[N, C]``        velocity of the robot, e.g. (v, w), m/s and rad/s
    command       ``[N, C]``        command of the last step, zero after a reset
    motion_ahead  ``[N, 3]``        robot when a command given now takes effect, present frame
    velocity_ahead ``[N, C]``       velocity of the robot at that time
    path          ``[N, P, 2]`` m   global path, world frame, padded with the goal
    outcome       ``[N, 1]``        :class:`Outcome` of the last step
    contact       ``[N, 1]``        :class:`navrl.sim.Contact` of the last step
    ============  ================  ======================================================

    With ``privileged=True`` also the true state, ``pedestrian_boxes [N, K, 5]``,
    ``pedestrian_clearance [N, 1]`` and, unless the localization is exact, ``true_pose [N, 3]``.

    **Reward** ``[N, 1]``: the sum of the terms; each is in ``reward_terms`` too.

    **Start**: a scenario drawn by the environment's own generator, the robot stationary and facing
    along its path. **End**: ``terminated`` on collision or goal; ``truncated`` at the step limit,
    so that the value bootstraps there.

    **Partial reset**: the other rows repeat their last observation, so that running statistics of
    the environment's output (VecNorm) do not include zeros.

    Args:
        simulator: Simulator; its number of worlds is the batch size.
        scenarios: Source of training scenarios; ``None`` if :meth:`set_scenarios` is
            called before every reset.
        rewards: Reward term by name; ``None`` removes a term.
        goal_radius: Distance to the goal that counts as success, m.
        time_limit_steps: Steps after which an episode is truncated.
        privileged: Whether the observation includes the true state.
        localization: Errors of the observed pose; ``None`` is exact. Rewards, outcomes and metrics
            use the true pose.
        seed: Seed of the environment's generator; ``None`` draws one from the operating system, so
            that environments without a seed differ. Global generators are not used.

    Raises:
        ValueError: If a limit is not positive.

    Reference:
        Paper Sec. III to V-A.
    """

    _batch_locked = True

    def __init__(
        self,
        simulator: Simulator,
        scenarios: ScenarioPool | None,
        rewards: Mapping[str, RewardTerm | None],
        goal_radius: float = 0.2,
        time_limit_steps: int = 150,
        privileged: bool = False,
        seed: int | None = None,
        localization: Localization | None = None,
    ) -> None:
        if goal_radius <= 0 or time_limit_steps <= 0:
            raise ValueError(
                f"goal_radius={goal_radius}, time_limit_steps={time_limit_steps}: must be > 0"
            )
        super().__init__(device=simulator.device, batch_size=torch.Size([simulator.num_worlds]))
        self.is_closed = False  # TorchRL's initial value is True, so close() would do nothing
        self.simulator = simulator
        self.scenarios = scenarios if scenarios is None else scenarios.to(self.device)
        self.rewards = {name: term for name, term in rewards.items() if term is not None}
        self.goal_radius, self.time_limit_steps = goal_radius, time_limit_steps
        self.privileged = privileged
        self.localization = Localization() if localization is None else localization
        self.max_dynamic: int | None = None  # curriculum: maximum number of dynamic pedestrians
        self._fixed: ScenarioBatch | None = None
        self._generator = torch.Generator()
        self._allocate()
        self._make_specs()
        self.set_seed(seed)

    def set_scenarios(self, scenarios: ScenarioBatch | None) -> ScenarioBatch | None:
        """Set the scenario of each world from its next reset on; ``None`` draws at random again.

        Args:
            scenarios: One row per world.

        Returns:
            The scenarios that were set before.

        Raises:
            ValueError: If the number of rows is not the number of worlds.
        """
        if scenarios is not None and len(scenarios) != self.simulator.num_worlds:
            raise ValueError(
                f"scenarios: must be one for each of {self.simulator.num_worlds} worlds, "
                f"got {len(scenarios)}"
            )
        before, self._fixed = self._fixed, None if scenarios is None else scenarios.to(self.device)
        return before

    @property
    def base(self) -> Base:
        """The base as a shield knows it: nominal limits and delays."""
        delays, robot = self.simulator.delays, self.simulator.robot
        return Base(robot, delays.nominal_command_delays_s, delays.nominal_scan_age_s)

    # --- specs and state -------------------------------------------------------------------------

    def _allocate(self) -> None:
        n, device = self.simulator.num_worlds, self.device
        self._path = torch.zeros(n, MAX_PATH_POINTS, 2, device=device)
        self._path_length = torch.zeros(n, device=device)
        self._goal = torch.zeros(n, 2, device=device)
        self._position = torch.zeros(n, 2, device=device)
        self._noise_seed = torch.zeros(n, dtype=torch.int64, device=device)
        self._steps = torch.zeros(n, dtype=torch.int64, device=device)
        self._progress = torch.zeros(n, device=device)
        # The last observation: a partial reset returns it for the other worlds.
        self._ranges = torch.zeros(n, self.simulator.lidar.num_beams, device=device)
        self._command = torch.zeros(n, self.simulator.robot.command_size, device=device)
        self._outcome = torch.full((n,), Outcome.RUNNING, dtype=torch.int64, device=device)
        time_step_s = self.simulator.time_step_s
        self._pose_memory = PoseMemory(self.localization, n, time_step_s, device)
        self._terms = {name: torch.zeros(n, 1, device=device) for name in self.rewards}

    def _make_specs(self) -> None:
        n, device, rows = self.simulator.num_worlds, self.device, self.batch_size
        self.observation_spec = observation_spec(
            self.simulator, self.localization, list(self.rewards), self.privileged
        )
        bounds = self.simulator.robot.bounds(device)
        low, high = (row.expand(n, -1).contiguous() for row in bounds)
        self.action_spec = Bounded(low, high, device=device)
        self.reward_spec = Unbounded(torch.Size([n, 1]), device=device)
        flag = Binary(1, torch.Size([n, 1]), dtype=torch.bool, device=device)
        flags = {key: flag.clone() for key in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flags, shape=rows, device=device)

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            self._generator.seed()  # the operating system's entropy
        else:
            self._generator.manual_seed(seed)

    def episode_state(self) -> dict[str, Any]:
        """Return the state from which an environment continues bit for bit."""
        return {
            "simulator": self.simulator.state_dict(),
            "generator": self._generator.get_state(),
            "past_poses": self._pose_memory.poses.clone(),
            "reward_terms": {name: value.clone() for name, value in self._terms.items()},
            **{name: getattr(self, name).clone() for name in _STATE},
        }

    def load_episode_state(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`episode_state` returned, of the same localization."""
        self._pose_memory.load(state.get("past_poses"))
        self.simulator.load_state_dict(state["simulator"])
        self._generator.set_state(state["generator"])
        for name in _STATE:
            if name in state:  # older states lack the last observation
                setattr(self, name, state[name].to(self.device).clone())
        for name, value in state.get("reward_terms", {}).items():
            self._terms[name] = value.to(self.device).clone()

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the environment and its simulator."""
        if not self.is_closed:
            self.simulator.close()
        super().close(raise_if_closed=raise_if_closed)

    # --- dynamics --------------------------------------------------------------------------------

    def _reset(self, tensordict: TensorDictBase | None = None, **unknown: object) -> TensorDictBase:
        if unknown:
            raise ValueError(
                f"reset({', '.join(f'{name}={value!r}' for name, value in unknown.items())}): must "
                f"be a TensorDict only; set_seed() and set_scenarios() choose what is played"
            )
        mask = None if tensordict is None else tensordict.get("_reset", None)
        n = self.simulator.num_worlds
        every = torch.arange(n, device=self.device)
        worlds = every if mask is None else mask.reshape(n).nonzero().squeeze(-1)
        batch = self._draw(worlds)
        self.simulator.reset(worlds, batch)
        state = self.simulator.state()
        # New tensors instead of in-place writes: earlier results must not change.
        path = batch.path.float()
        self._path = self._path.index_put((worlds,), path)
        self._path_length = self._path_length.index_put((worlds,), path_length(path))
        self._goal = self._goal.index_put((worlds,), batch.goal.float())
        self._noise_seed = self._noise_seed.index_put((worlds,), batch.noise_seed)
        self._steps = self._steps.index_fill(0, worlds, 0)
        self._command = self._command.index_fill(0, worlds, 0.0)
        self._position = state.pose[:, :2]
        self._pose_memory.reset(worlds, state.pose)
        progress, _ = project_onto_path(path, self._position[worlds])
        self._progress = self._progress.index_put((worlds,), progress)
        # The other worlds repeat their last observation, which statistics of whole batches need.
        noisy = self._noisy_ranges(self.simulator.ranges(worlds), worlds)
        ranges = self._ranges.index_copy(0, worlds, noisy)
        outcome = self._outcome.index_fill(0, worlds, Outcome.RUNNING)
        terms = {name: value.index_fill(0, worlds, 0.0) for name, value in self._terms.items()}
        return self._observe(state, ranges, outcome, terms)

    def _draw(self, worlds: Tensor) -> ScenarioBatch:
        if self._fixed is not None:
            return self._fixed[worlds]
        if self.scenarios is None:
            raise ValueError("scenarios=None: call set_scenarios() before reset()")
        return self.scenarios.draw(self._generator, len(worlds), self.max_dynamic)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        command, command_before = tensordict.get(keys.ACTION), self._command
        state = self.simulator.step(command)
        self._command = command.float().clone()
        ranges = self.simulator.ranges()
        self._steps = self._steps + 1
        self._pose_memory.push(state.pose)
        self._position = position = state.pose[:, :2]
        before = self._progress
        self._progress, _ = project_onto_path(self._path, position, before)
        outcome = classify(
            state.contact,
            (self._goal - position).norm(dim=-1),
            self.goal_radius,
            self._steps >= self.time_limit_steps,
        )
        transition = Transition(
            position=position,
            path=self._path,
            path_length=self._path_length,
            progress_before=before,
            progress=self._progress,
            nearest=self.simulator.lidar.nearest(ranges),
            collided=state.contact != Contact.NONE,
            reached=outcome == Outcome.SUCCESS,
            robot_radius=self.simulator.robot.radius,
            velocity=state.velocity,
            command_before=command_before,
            command=self._command,
        )
        terms = {name: term(transition).unsqueeze(-1) for name, term in self.rewards.items()}
        noisy = self._noisy_ranges(ranges, slice(None))
        result = self._observe(state, noisy, outcome, terms)
        truncated = (outcome == Outcome.TIMEOUT).unsqueeze(-1)
        terminated = (outcome != Outcome.RUNNING).unsqueeze(-1) & ~truncated
        reward = torch.stack(list(terms.values())).sum(0) if terms else torch.zeros_like(truncated)
        ends = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        return result.update({"reward": reward.float(), **ends})

    def _noisy_ranges(self, ranges: Tensor, worlds: Tensor | slice) -> Tensor:
        seeds, steps = self._noise_seed[worlds], self._steps[worlds]
        return self.simulator.lidar.add_noise(ranges, seeds, steps)

    def _observe(
        self, state: SimState, ranges: Tensor, outcome: Tensor, terms: Mapping[str, Tensor]
    ) -> TensorDict:
        self._ranges, self._outcome, self._terms = ranges, outcome, dict(terms)
        motion_ahead, velocity_ahead = self.simulator.motion_ahead()
        observation = {
            keys.RANGES: ranges,
            keys.MOTION_AHEAD: motion_ahead.float(),
            keys.VELOCITY_AHEAD: velocity_ahead.float(),
            keys.POSE: self._pose_memory.report(state.pose, self._noise_seed, self._steps),
            keys.VELOCITY: state.velocity,
            keys.COMMAND: self._command,
            keys.SCAN_MOTION: self.simulator.scan_motion().float(),
            keys.PATH: self._path,
            keys.OUTCOME: outcome.unsqueeze(-1),
            keys.CONTACT: state.contact.unsqueeze(-1),
            keys.REWARD_TERMS: TensorDict(dict(terms), self.batch_size, device=self.device),
        }
        coverage = self.simulator.lidar.coverage
        if not coverage.is_full:
            observation[keys.MEASURED] = coverage.measured(self._noise_seed).contiguous()
        if self.privileged:
            radius = self.simulator.robot.radius
            observation |= privileged_observation(state, radius, self.localization)
        return TensorDict(observation, self.batch_size, device=self.device)
