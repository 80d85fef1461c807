"""Simulators of robots, pedestrians and lidar scans in scenarios."""

from importlib import import_module
from typing import TYPE_CHECKING

from navrl.sim.crowd import PedestrianModel, ScriptedRoutes
from navrl.sim.delays import Delays
from navrl.sim.differential_drive import DifferentialDrive
from navrl.sim.draws import LogUniform, Uniform
from navrl.sim.lidar import Lidar
from navrl.sim.limited_drive import LimitedDrive
from navrl.sim.localization import Localization
from navrl.sim.robot import RobotModel
from navrl.sim.simulator import Simulator
from navrl.sim.state import Contact, SimState
from navrl.sim.walkers import RouteWalkers

if TYPE_CHECKING:
    from navrl.sim.batched import BatchedSimulator
    from navrl.sim.bullet import BulletSimulator
    from navrl.sim.orca_pedestrians import OrcaPedestrians
    from navrl.sim.social_force import SocialForcePedestrians

__all__ = [
    "BatchedSimulator",
    "BulletSimulator",
    "Contact",
    "Delays",
    "DifferentialDrive",
    "Lidar",
    "LimitedDrive",
    "Localization",
    "LogUniform",
    "OrcaPedestrians",
    "PedestrianModel",
    "RobotModel",
    "RouteWalkers",
    "ScriptedRoutes",
    "SimState",
    "Simulator",
    "SocialForcePedestrians",
    "Uniform",
]

_LAZY = {
    "BatchedSimulator": "navrl.sim.batched",
    "BulletSimulator": "navrl.sim.bullet",
    "OrcaPedestrians": "navrl.sim.orca_pedestrians",
    "SocialForcePedestrians": "navrl.sim.social_force",
}


def __getattr__(name: str) -> type:  # imports numba and pybullet only when they are used
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
