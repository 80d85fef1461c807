"""A base that moves sideways and pedestrians that flee, as a user would write them."""

import torch

from navrl.sim import PedestrianModel, RobotModel


class Omnidirectional(RobotModel):
    """Three commands (forward, left, turn rate), obeyed at once, in straight substeps."""

    radius = 0.2
    command_limits = ((-0.5, -0.5, -2.0), (1.0, 0.5, 2.0))

    def advance(self, pose, velocity, command, duration):
        forward, left, turn = self.clip(command).unbind(-1)
        x, y, yaw = pose.unbind(-1)
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        x = x + duration * (cos * forward - sin * left)
        y = y + duration * (sin * forward + cos * left)
        moved = torch.stack((x, y, yaw + duration * turn), dim=-1)
        return moved, self.clip(command)

    def travel(self, pose, velocity):
        forward, left = velocity[..., 0], velocity[..., 1]
        return pose[..., 2] + torch.atan2(left, forward), torch.hypot(forward, left)


class Fleeing(PedestrianModel):
    """Each pedestrian walks straight away from the robot when it is near, else its route."""

    def __init__(self, speed=0.5, reach=3.0):
        self.speed, self.reach = speed, reach

    def targets(self, state, duration_s):
        center = state.pedestrians[..., :2]
        away = center - state.pose[:, None, :2]
        distance = away.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        step = self.speed * duration_s * away / distance
        return center + torch.where(distance < self.reach, step, torch.zeros_like(step))
