"""Two environments to try transforms in: a batched one, and a stranger's from gymnasium."""

from __future__ import annotations

import gymnasium
import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

ROOM = (3.0, 2.0)  # half sizes, m


class RoomEnv(EnvBase):
    """N robots in a rectangular room, batched; episodes end at random, row by row."""

    _batch_locked = True

    def __init__(self, num_worlds: int = 4, num_beams: int = 48, done_rate: float = 0.2) -> None:
        super().__init__(device="cpu", batch_size=[num_worlds])
        n = num_worlds
        self.num_beams, self.done_rate = num_beams, done_rate
        self.observation_spec = Composite(
            ranges=Bounded(0.0, 3.5, (n, num_beams)),
            pose=Unbounded((n, 3)),
            path=Unbounded((n, 30, 2)),
            scan_motion=Unbounded((n, 2, 3)),
            motion_ahead=Unbounded((n, 3)),
            velocity_ahead=Unbounded((n, 2)),
            command=Unbounded((n, 2)),
            shape=(n,),
        )
        self.action_spec = Bounded(-1.0, 1.0, (n, 2))
        self.reward_spec = Unbounded((n, 1))
        flag = {name: Binary(1, (n, 1), dtype=torch.bool) for name in ("done", "terminated")}
        self.full_done_spec = Composite(flag, shape=(n,))
        self.generator = torch.Generator()
        self.pose, self.command = torch.zeros(n, 3), torch.zeros(n, 2)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(seed or 0)

    def _uniform(self, *shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=self.generator)

    def _reset(self, tensordict=None, **_) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        pose = 2.0 * self._uniform(*self.batch_size, 3) - 1.0
        self.pose = pose if mask is None else torch.where(mask.view(-1, 1), pose, self.pose)
        zero = torch.zeros_like(self.command)
        self.command = zero if mask is None else torch.where(mask.view(-1, 1), zero, self.command)
        return self._observe(torch.zeros(*self.batch_size, 1, dtype=torch.bool))

    def _step(self, tensordict: TensorDict) -> TensorDict:
        forward, turn = (0.2 * tensordict["action"]).unbind(-1)
        x, y, yaw = self.pose.unbind(-1)
        pose = torch.stack([x + forward * yaw.cos(), y + forward * yaw.sin(), yaw + turn], dim=-1)
        self.pose, self.command = pose.clamp(-1.9, 1.9), tensordict["action"].clone()
        done = self._uniform(*self.batch_size, 1) < self.done_rate
        return self._observe(done).set("reward", torch.zeros(*self.batch_size, 1))

    def _observe(self, done: torch.Tensor) -> TensorDict:
        ranges = room_ranges(self.pose, self.num_beams, torch).clamp(max=3.5)
        path = torch.linspace(-1.5, 1.5, 30)
        path = torch.stack([path, 0.3 * (2.0 * path).sin()], dim=-1)
        return TensorDict(
            {
                "ranges": ranges,
                "pose": self.pose.clone(),
                "path": path.expand(*self.batch_size, -1, -1).clone(),
                # any numbers that differ by row and step; the scan itself has no age
                "scan_motion": torch.stack([0.2 * self.pose, 0.1 * self.pose], dim=-2),
                "motion_ahead": 0.05 * self.pose,
                "velocity_ahead": 0.9 * self.command,
                "command": self.command.clone(),
                "done": done,
                "terminated": done.clone(),
            },
            self.batch_size,
        )


class StrangersEnv(gymnasium.Env):
    """A lidar robot as someone else would write it: other names, beams, range and dtype."""

    def __init__(self, num_beams: int = 90) -> None:
        box = gymnasium.spaces.Box
        self.num_beams = num_beams
        self.observation_space = gymnasium.spaces.Dict(
            {
                "laser": box(0.0, np.inf, (num_beams,), np.float64),
                "odometry": box(-np.inf, np.inf, (3,), np.float64),
                "route": box(-np.inf, np.inf, (12, 2), np.float64),
                "sweep": box(-np.inf, np.inf, (2, 3), np.float64),
            }
        )
        self.action_space = box(-1.0, 1.0, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.pose = self.np_random.uniform(-1.0, 1.0, 3)
        self.steps = 0
        return self._observe(), {}

    def step(self, action):
        self.pose[:2] += 0.1 * float(action[0]) * np.array([np.cos(self.pose[2])] * 2)
        self.pose[2] += 0.3 * float(action[1])
        self.pose[:2] = self.pose[:2].clip(-1.5, 1.5)
        self.steps += 1
        return self._observe(), 0.0, self.steps >= 7, False, {}

    def _observe(self) -> dict[str, np.ndarray]:
        ranges = room_ranges(self.pose, self.num_beams, np)
        ranges[ranges > 2.5] = np.inf  # this driver's way to say: no return
        route = np.stack([np.linspace(-1, 1, 12), np.zeros(12)], axis=-1)
        sweep = np.stack([0.2 * self.pose, 0.1 * self.pose])
        return {"laser": ranges, "odometry": self.pose.copy(), "route": route, "sweep": sweep}


def room_ranges(pose, num_beams: int, xp):
    """Return the distance to the walls of ROOM along each beam, with ``xp`` torch or numpy."""
    angle = pose[..., 2:] + xp.arange(num_beams) * (2.0 * np.pi / num_beams)
    cos, sin = xp.cos(angle), xp.sin(angle)
    to_x = (xp.sign(cos) * ROOM[0] - pose[..., 0:1]) / cos
    to_y = (xp.sign(sin) * ROOM[1] - pose[..., 1:2]) / sin
    return xp.minimum(to_x, to_y)
