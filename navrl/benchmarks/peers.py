"""Comparison with other lidar simulators, of the extra ``benchmark-peers``.

One stationary robot is between four walls while ten obstacles move; a unit is one simulation step
and one scan. Each simulator is used through its public interface.
"""

from __future__ import annotations

import contextlib
import io
import math
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.results import Bar, Row
from navrl.benchmarks.scanning import NUM_BEAMS, MakeSimulator, drive_task
from navrl.benchmarks.scenes import ROOM_HALF_SIZE, WALK_SPEED, WALKER, clutter, walkers
from navrl.extras import install_hint

NUM_OBSTACLES = 10
_TIME_STEP_S, _ROBOT_RADIUS, _MAX_RANGE = 0.2, 0.178, 3.5
_H = ROOM_HALF_SIZE
_CORNERS = [[-_H, -_H], [_H, -_H], [_H, _H], [-_H, _H]]


def peer_rows(make: MakeSimulator, num_worlds: int, budget: Budget) -> list[Row | str]:
    """Measure beams per second against each installed simulator, all on one core.

    Args:
        make: Builds navrl's simulator.
        num_worlds: Number of its worlds; other simulators have one.
        budget: Duration and number of measurements.

    Returns:
        Rows, and a line for each peer that is not installed.
    """
    found = {name: start for name, start in PEERS.items() if find_spec(_MODULES[name])}
    missing: list[Row | str] = [
        f"{name}: not installed ({install_hint('benchmark-peers')})"
        for name in PEERS
        if name not in found
    ]
    if not found:
        return missing
    own = drive_task(
        make(num_worlds, max_pedestrians=NUM_OBSTACLES), clutter(num_worlds, 4, NUM_OBSTACLES)
    )
    rates = alternate(
        {"navrl": own} | {name: Task(start()) for name, start in found.items()}, budget
    )
    beams = {name: rate * NUM_BEAMS / 1e6 for name, rate in rates.items()}
    what = f"beams, 4 walls, {NUM_OBSTACLES} moving obstacles, 1 core"
    rows: list[Row | str] = [Row("peers.navrl", what, "million/s", beams["navrl"])]
    for name in found:
        bar = Bar(4.0) if name == "navground" else None
        ratio = beams["navrl"] / beams[name]
        rows.append(Row(f"peers.{name}", f"… {name}", "million/s", beams[name]))
        rows.append(Row(f"peers.{name}_ratio", f"… navrl / {name}", "x", ratio, bar))
    return rows + missing


class Navground:
    """Navground world with a lidar; a call steps the world and scans."""

    def __init__(self) -> None:
        from navground import core, sim

        self.world = sim.World()
        self.lidar = sim.state_estimations.LidarStateEstimation(
            range=_MAX_RANGE,
            start_angle=0.0,
            field_of_view=2 * math.pi * (NUM_BEAMS - 1) / NUM_BEAMS,
            resolution=NUM_BEAMS,
        )
        self.robot = self._add_agent(_ROBOT_RADIUS, 0.0, None)
        for person in walkers(NUM_OBSTACLES):
            ends = [point.tolist() for point in person.route]
            task = sim.tasks.WaypointsTask(waypoints=ends, loop=True, tolerance=0.1)
            agent = self._add_agent(WALKER, WALK_SPEED, task)
            agent.position = person.route.mean(axis=0)
        for start, end in zip(_CORNERS, _CORNERS[1:] + _CORNERS[:1], strict=True):
            self.world.add_wall(sim.Wall(start, end))
        self.state = core.SensingState()
        self.lidar.prepare_state(self.state)

    def _add_agent(self, radius: float, speed: float, task: object) -> Any:
        from navground import core, sim

        drive = core.kinematics.OmnidirectionalKinematics(max(speed, 0.01), 1.0)
        dummy = core.behaviors.DummyBehavior()
        agent = sim.Agent(radius=radius, kinematics=drive, behavior=dummy, task=task)
        self.world.add_agent(agent)
        return agent

    def __call__(self) -> int:
        """Move and scan once; return 1."""
        self.world.update(_TIME_STEP_S)
        self.lidar.update(self.robot, self.world, self.state)
        return 1

    def ranges(self) -> np.ndarray:
        """Return the last scan ``[beams]`` m, beam 0 straight ahead, counter-clockwise."""
        return np.array(self.state.buffers["range"].data)


class IrSim:
    """ir-sim world with a lidar, without display; a call steps the world and scans."""

    def __init__(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()):  # messages about missing window systems
            import irsim
        walls = {"name": "linestring", "vertices": [*_CORNERS, _CORNERS[0]]}
        scene = {
            "world": {
                "width": 2 * _H,
                "height": 2 * _H,
                "offset": [-_H, -_H],
                "step_time": _TIME_STEP_S,
                "sample_time": _TIME_STEP_S,
                "collision_mode": "unobstructed",
            },
            "robot": [_irsim_robot()],
            "obstacle": [
                *(_irsim_walker(person.route) for person in walkers(NUM_OBSTACLES)),
                {"shape": walls, "state": [0, 0, 0]},  # the default is (1, 1)
            ],
        }
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "scene.yaml"
            file.write_text(yaml.safe_dump(scene))
            self.env = irsim.make(
                str(file), display=False, disable_all_plot=True, log_level="ERROR"
            )
        self._stop = np.zeros((2, 1))

    def __call__(self) -> int:
        """Move and scan once; return 1."""
        self.env.step(self._stop)
        return 1

    def ranges(self) -> np.ndarray:
        """Return the last scan ``[beams]`` m, beam 0 straight ahead, counter-clockwise."""
        return np.roll(self.env.get_lidar_scan()["ranges"], -NUM_BEAMS // 2)  # from -pi


def _irsim_robot() -> dict:
    return {
        "kinematics": {"name": "diff"},
        "shape": {"name": "circle", "radius": _ROBOT_RADIUS},
        "state": [0, 0, 0],
        "goal": [100, 100, 0],
        "sensors": [
            {
                "name": "lidar2d",
                "range_min": 0,
                "range_max": _MAX_RANGE,
                "angle_range": 2 * math.pi,
                "number": NUM_BEAMS,
                "noise": False,
            }
        ],
    }


def _irsim_walker(route: np.ndarray) -> dict:
    low, high = [-_H + 0.4, -_H + 0.4, -math.pi], [_H - 0.4, _H - 0.4, math.pi]
    return {
        "kinematics": {"name": "omni"},
        "shape": {"name": "circle", "radius": WALKER},
        "state": [*route.mean(axis=0).tolist(), 0.0],
        "behavior": {"name": "dash", "wander": True, "range_low": low, "range_high": high},
        "vel_max": [WALK_SPEED, WALK_SPEED],
    }


PEERS: dict[str, Callable[[], Callable[[], int]]] = {"navground": Navground, "ir_sim": IrSim}
_MODULES = {"navground": "navground", "ir_sim": "irsim"}
