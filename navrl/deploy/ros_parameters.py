"""Parameters of the ROS nodes, and what is built from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from navrl.deploy.control_limits import ControlLimits
from navrl.deploy.controller import Controller
from navrl.deploy.map_planner import MapPlanner
from navrl.deploy.safety import SafetyLimits
from navrl.deploy.scan_adapter import load_scanner
from navrl.policies.names import bundle_folder

PARAMETERS: dict[str, Any] = {
    "policy": "navrl-best-deployed",
    "scanner": "any",
    "mount": [math.nan, math.nan, math.nan],
    "is_upside_down": False,
    "own_radius": 0.0,
    "blind_sectors": [0.0, 0.0],
    "global_frame": "map",
    "robot_base_frame": "base_link",
    "pose_source": "tf",
    "path_source": "plan",
    "scan_topic": "scan",
    "odom_topic": "odom",
    "pose_topic": "amcl_pose",
    "plan_topic": "plan",
    "map_topic": "map",
    "goal_topic": "goal_pose",
    "cmd_vel_topic": "cmd_vel",
    "emergency_stop_topic": "emergency_stop",
    "enable_stamped_cmd_vel": False,
    "controller_frequency": 20.0,
    "transform_tolerance": 0.1,
    "scan_timeout": 0.5,
    "pose_timeout": 0.5,
    "xy_goal_tolerance": 0.2,
    "max_path_distance": 2.0,
    "min_measured_share": 0.01,
    "robot_radius": 0.0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.25,
    "speed_scale": 1.0,
    "max_vel_x": math.inf,
    "min_vel_x": -math.inf,
    "max_vel_theta": math.inf,
    "acc_lim_x": math.inf,
    "decel_lim_x": -math.inf,
    "acc_lim_theta": math.inf,
    "compensate_motion": True,
    "publish_markers": True,
    "dry_run": False,
}
"""Parameters of both nodes with their defaults; docs/robots.md describes them."""


_MIN_FREQUENCY_HZ = 10.0  # so that the robot stops within 0.1 s


def check_parameters(parameters: dict[str, Any], sources: tuple[str, ...]) -> None:
    """Check the sources of pose and path, and the frequency.

    Args:
        parameters: Values of :data:`PARAMETERS`.
        sources: Values of ``pose_source`` that the node has.

    Raises:
        ValueError: If a parameter is not allowed; the message names it.
    """
    source, frequency = parameters["pose_source"], parameters["controller_frequency"]
    if source not in sources:
        raise ValueError(f"pose_source={source}: must be one of {', '.join(sources)}")
    if parameters["path_source"] not in ("plan", "map"):
        raise ValueError(f"path_source={parameters['path_source']}: must be one of plan, map")
    if not frequency >= _MIN_FREQUENCY_HZ:
        raise ValueError(
            f"controller_frequency={frequency}: must be at least {_MIN_FREQUENCY_HZ:g} Hz, so that "
            "the robot stops within 0.1 s"
        )


def make_controller(parameters: dict[str, Any], mount: tuple[float, float, float]) -> Controller:
    """Return the controller of a node, warmed up.

    Args:
        parameters: Values of :data:`PARAMETERS`.
        mount: (x, y, yaw) of the lidar in the robot frame, m and rad.

    Raises:
        ValueError: If a parameter is out of range; the message names it.
    """
    folder = bundle_folder(parameters["policy"])
    if folder is None:
        raise ValueError(f"policy={parameters['policy']}: must be a bundle or a name of the zoo")
    sectors = np.asarray(parameters["blind_sectors"], dtype=np.float64)
    if len(sectors) % 2:
        raise ValueError(f"blind_sectors={sectors.tolist()}: must be pairs of bearing and width")
    scanner = load_scanner(
        parameters["scanner"],
        mount=mount,
        is_upside_down=bool(parameters["is_upside_down"]),
        own_radius=float(parameters["own_radius"]),
        blind_sectors=[pair for pair in sectors.reshape(-1, 2).tolist() if pair[1] > 0.0],
    )
    limits = ControlLimits(
        scan_timeout_s=parameters["scan_timeout"],
        pose_timeout_s=parameters["pose_timeout"],
        max_clock_skew_s=parameters["transform_tolerance"],
        speed_scale=parameters["speed_scale"],
        max_speed=parameters["max_vel_x"],
        max_reverse_speed=abs(parameters["min_vel_x"]) or 1e-9,
        max_turn_rate=parameters["max_vel_theta"],
        linear_acceleration=parameters["acc_lim_x"],
        linear_deceleration=abs(parameters["decel_lim_x"]),
        angular_acceleration=parameters["acc_lim_theta"],
    )
    safety = SafetyLimits(
        goal_radius=parameters["xy_goal_tolerance"],
        max_path_distance=parameters["max_path_distance"],
        min_measured_share=parameters["min_measured_share"],
    )
    control = Controller.from_bundle(
        folder,
        scanner,
        limits,
        parameters["compensate_motion"],
        safety=safety,
        with_attention=has_attention(folder),
    )
    control.warm_up()
    return control


def make_planner(
    parameters: dict[str, Any], control: Controller, on_path: Callable[[np.ndarray], object]
) -> MapPlanner | None:
    """Return the planner of a node with ``path_source`` map; ``None`` otherwise.

    Args:
        parameters: Values of :data:`PARAMETERS`.
        control: The controller.
        on_path: Called with each new path ``[P, 2]`` m.
    """
    if parameters["path_source"] != "map":
        return None
    return MapPlanner(
        control,
        robot_radius=parameters["robot_radius"] or None,
        occupied_percent=100.0 * parameters["occupied_thresh"],
        free_percent=100.0 * parameters["free_thresh"],
        on_path=on_path,
    )


def has_attention(folder: Path) -> bool:
    """Return whether the actor of a bundle can write attention weights."""
    from navrl.policies import load_bundle

    try:
        load_bundle(folder).actor_with_attention()
    except (TypeError, ValueError, RuntimeError):
        return False
    return True
