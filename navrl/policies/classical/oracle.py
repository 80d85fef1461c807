"""Oracle: privileged planner that knows every pedestrian's future."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive
from navrl.deprecation import renamed_arguments, warn
from navrl.ops.kernels.maneuvers import maneuver_kernel
from navrl.ops.kernels.space_time import FOUND, plan_kernel
from navrl.policies.classical.commands import normalized_action
from navrl.policies.classical.maneuvers import Maneuvers, maneuvers
from navrl.policies.classical.space_time_maps import space_time_maps
from navrl.policies.controller import Controller
from navrl.sim import Delays, DifferentialDrive
from navrl.worlds import ScenarioBatch


@dataclass(frozen=True)
class SearchEffort:
    """Settings of one planning attempt.

    Args:
        margin: Clearance of the plan to all obstacles, m.
        heuristic_weight: Weight of the heuristic of A*; 1 finds the shortest plan, higher values
            find a plan faster.
        max_nodes: Number of expanded poses after which the attempt fails.
    """

    margin: float
    heuristic_weight: float
    max_nodes: int

    @property
    def greed(self) -> float:
        """Deprecated name of :attr:`heuristic_weight`."""
        warn("SearchEffort.greed", "use heuristic_weight")
        return self.heuristic_weight

    def __post_init__(self) -> None:
        if not (self.margin >= 0 and self.heuristic_weight > 0 and self.max_nodes > 0):
            raise ValueError(
                f"margin={self.margin}: must be >= 0 m; heuristic_weight={self.heuristic_weight}, "
                f"max_nodes={self.max_nodes}: must be > 0"
            )


SearchEffort.__init__ = renamed_arguments(greed="heuristic_weight")(SearchEffort.__init__)


class Oracle(Controller):
    """Plan the whole episode in advance, then replay the plan.

    The controller is privileged: :meth:`prepare` reads the walls and the position of each
    pedestrian at each substep. The search space is position, heading and time; moves are arcs that
    a unicycle drives exactly, and each is checked at every substep by the contact rule of the
    simulators. An episode without a plan is reported as not solved, and the robot is stationary in
    it.

    For a base with limits of acceleration, lag or errors the search space has its velocity too, and
    moves are the :func:`maneuvers` that it drives exactly. Commands that are late are planned for
    the time at which they take effect. Both are exact if the base is the same in all episodes, the
    delays are fixed, and those of speed and turn rate differ by whole steps; otherwise the plan is
    for the nominal base and the nearest delays.

    Solved episodes are solvable, so its success rate is a lower bound of the maximum. That an
    episode is unsolved does not prove that no plan exists.

    Args:
        robot: Robot, whose motion follows exactly from the commands.
        goal_radius: Distance to the goal that counts as success, m.
        time_limit_steps: Steps in which the goal must be reached.
        time_step_s: Time between two commands, s.
        substeps: Contact checks per step.
        speeds: Speeds of a step as fractions of the maximum; 0 waits or turns in place.
        turns: Left turns of a step as fractions of the maximum, multiples of the first one; right
            turns and straight motion are added.
        cell: Largest size of a cell, m, at most the longest step; only the first pose per cell,
            heading and step is expanded.
        efforts: Attempts in order, until one finds a plan.
        delays: Delays of the commands; ``None`` for none.

    Raises:
        ValueError: If the robot cannot stop or a value is out of range.

    Reference:
        Dolgov et al., "Practical search techniques in path planning for autonomous driving", 2008
        (hybrid A*). Time as a dimension of the search and the efforts are ours.
    """

    privileged = True
    needs_known_future = True

    def __init__(
        self,
        robot: DifferentialDrive,
        goal_radius: float = 0.2,
        time_limit_steps: int = 150,
        time_step_s: float = 0.2,
        substeps: int = 10,
        speeds: Sequence[float] = (1.0, 0.5, 0.0),
        turns: Sequence[float] = (0.5, 1.0),
        cell: float = 0.1,
        efforts: Sequence[SearchEffort] = (
            SearchEffort(0.03, 1.1, 300_000),
            SearchEffort(0.005, 1.5, 3_000_000),
        ),
        delays: Delays | None = None,
    ) -> None:
        super().__init__()
        _check_oracle(robot, speeds, turns, efforts)
        check_positive(
            goal_radius=goal_radius,
            time_limit_steps=time_limit_steps,
            time_step_s=time_step_s,
            substeps=substeps,
            cell=cell,
        )
        self.in_keys, self.out_keys = [], [keys.ACTION]
        self.robot, self.goal_radius, self.cell = robot, goal_radius, cell
        self.time_limit_steps, self.efforts = time_limit_steps, tuple(efforts)
        self.time_step_s, self.substeps = time_step_s, substeps
        self._delays_s = (delays or Delays()).nominal_command_delays_s
        turn = robot.max_turn_rate * time_step_s * turns[0]  # rad, the smallest turn per step
        self._bins = math.ceil(2 * math.pi / turn - 1e-9)
        self._primitives = self._make_primitives(speeds, turns)
        self._maneuvers: Maneuvers | None = None
        if not robot.follows_commands:
            self._maneuvers = maneuvers(robot, time_step_s, substeps)
        self._plan: Tensor | None = None
        self._step = 0

    def _make_primitives(self, speeds: Sequence[float], turns: Sequence[float]) -> Tensor:
        """Return ``[A, 2]`` (v, heading bins turned): fast and straight ones first."""
        bins = [0] + [sign * round(turn / turns[0]) for turn in turns for sign in (1, -1)]
        moves = [(share * self.robot.max_speed, turn) for share in speeds for turn in bins]
        return torch.tensor(moves, dtype=torch.float64)

    @property
    def commands(self) -> Tensor:
        """Commands (v, w) of the moves of a plan, ``[A, 2]`` m/s and rad/s."""
        if self._maneuvers is not None:
            return self._maneuvers.commands.flatten(0, 1)
        turn_rate = self._primitives[:, 1] * (2 * math.pi / self._bins / self.time_step_s)
        return torch.stack([self._primitives[:, 0], turn_rate], dim=-1)

    def prepare(self, scenarios: ScenarioBatch) -> Tensor:
        """Plan the next episodes.

        Args:
            scenarios: ``[S]``, one per world; equal ones are planned once.

        Returns:
            ``[S]`` bool, whether a plan was found.
        """
        rows, origin = _distinct(scenarios)
        distinct = scenarios[rows].to("cpu").touchable(self.robot.height)
        stay = int((self.commands == 0).all(-1).nonzero()[0])
        plan = torch.full((len(rows), self._plan_steps), stay)
        solved = torch.zeros(len(rows), dtype=torch.bool)
        for effort in self.efforts:
            left = (~solved).nonzero().squeeze(-1)
            if len(left) > 0:
                plan[left], solved[left] = self._search(distinct[left], effort, stay)
        self._plan, self._step = self._in_time(self.commands[plan[origin]]), 0
        return solved[origin]

    @property
    def _plan_steps(self) -> int:
        """Steps of a plan: those after which its last command takes effect in time."""
        late = math.ceil(max(self._delays_s) / self.time_step_s - 1e-9)
        return max(self.time_limit_steps - late, 1)

    def _in_time(self, plan: Tensor) -> Tensor:
        """Return the commands ``[S, T, 2]`` by the step in which each component is sent.

        The plan begins when the latest component takes effect; the others are sent later.
        """
        latest = max(self._delays_s)
        sent = torch.zeros(len(plan), self.time_limit_steps, 2, dtype=plan.dtype)
        for axis, delay_s in enumerate(self._delays_s):
            first = round((latest - delay_s) / self.time_step_s)
            steps = min(plan.shape[1], self.time_limit_steps - first)
            sent[:, first : first + steps, axis] = plan[:, :steps, axis]
        return sent

    @property
    def _top_speed(self) -> float:
        """Largest speed of a plan, m/s; caps and errors of scale make it another than commanded."""
        if self._maneuvers is None:
            return self.robot.max_speed
        return float(self._maneuvers.velocities[:, 0].max())

    def _search(
        self, scenarios: ScenarioBatch, effort: SearchEffort, stay: int
    ) -> tuple[Tensor, Tensor]:
        """Return the moves ``[S, T]`` and whether they reach the goal ``[S]``."""
        count, limit = len(scenarios), self._plan_steps
        reach = self.robot.radius + effort.margin
        ticks = torch.arange(limit * self.substeps + 1) * (self.time_step_s / self.substeps)
        ticks = ticks + max(self._delays_s)  # the plan begins when commands take effect
        step_length = self._top_speed * self.time_step_s
        cell = min(self.cell, step_length)  # else slow moves end in the cell of their start
        maps = space_time_maps(scenarios, ticks.double(), reach, cell, step_length)
        plan = torch.full((count, limit), stay)
        code, steps, nodes = (torch.zeros(count, dtype=torch.int64) for _ in range(3))
        search, moves = plan_kernel, (self._primitives.numpy(), self._offsets().numpy())
        if self._maneuvers is not None:
            table = self._maneuvers
            search = maneuver_kernel
            moves = (table.following.numpy(), table.offsets.numpy(), table.rest)
        search(
            *(value.numpy() for value in maps),
            *moves,
            self._bins,
            reach,
            self.goal_radius - min(effort.margin, 0.1 * self.goal_radius),
            cell,
            effort.heuristic_weight,
            effort.max_nodes,
            plan.numpy(),
            code.numpy(),
            steps.numpy(),
            nodes.numpy(),
        )
        return plan, code == FOUND

    def _offsets(self) -> Tensor:
        """Return the position of each move at each substep, ``[A, U, 2]`` m, from heading 0."""
        v, w = self.commands[:, None].unbind(-1)
        time_s = torch.arange(1, self.substeps + 1) * (self.time_step_s / self.substeps)
        half = 0.5 * w * time_s.double()
        chord = v * time_s * torch.sinc(half / math.pi)
        return torch.stack([chord * half.cos(), chord * half.sin()], dim=-1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the plan's next normalized action ``[N, 2]``.

        Raises:
            RuntimeError: If :meth:`prepare` was not called for these worlds.
        """
        size = tensordict.batch_size.numel()
        if self._plan is None or len(self._plan) != size:
            raise RuntimeError(f"oracle: call prepare() with the scenarios of these {size} worlds")
        step = min(self._step, self.time_limit_steps - 1)
        self._step += 1
        action = normalized_action(self.robot, self._plan[:, step])
        return tensordict.set(keys.ACTION, action.to(tensordict.device))


def _distinct(scenarios: ScenarioBatch) -> tuple[Tensor, Tensor]:
    """Return the rows ``[D]`` of distinct scenarios, and the index of each row's ``[S]``."""
    tensors = [value.cpu() for value in scenarios.tensors().values()]
    numbers: dict[bytes, int] = {}
    first, number = [], []
    for row in range(len(scenarios)):
        content = b"".join(value[row].numpy().tobytes() for value in tensors)
        if content not in numbers:
            numbers[content] = len(first)
            first.append(row)
        number.append(numbers[content])
    return torch.tensor(first), torch.tensor(number)


def _check_oracle(
    robot: DifferentialDrive,
    speeds: Sequence[float],
    turns: Sequence[float],
    efforts: Sequence[SearchEffort],
) -> None:
    if robot.min_speed > 0:
        raise ValueError(f"robot.min_speed={robot.min_speed}: must be <= 0 for the oracle")
    if 0.0 not in speeds or not all(0 <= share <= 1 for share in speeds):
        raise ValueError(f"speeds={list(speeds)}: must be in [0, 1] and include 0")
    multiples = [turn / turns[0] for turn in turns if turns[0] > 0]
    if not turns or not multiples or max(turns) > 1 or any(m != round(m) for m in multiples):
        raise ValueError(f"turns={list(turns)}: must be in (0, 1], multiples of the first")
    if not efforts:
        raise ValueError("efforts=[]: must have at least one")
