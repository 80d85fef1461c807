"""Parameters of the ROS nodes, and what is built from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from navrl.checks import checked_numbers, checked_pose
from navrl.deploy.control_limits import ControlLimits
from navrl.deploy.controller import Controller
from navrl.deploy.map_planner import MapPlanner
from navrl.deploy.safety import SafetyLimits
from navrl.deploy.scan_adapter import load_scanner
from navrl.policies.names import bundle_folder

_T = TypeVar("_T")

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
_NO_REVERSE = 1e-9  # m/s, a limit must be positive
_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")  # of each node
_LIMITS = {
    "scan_timeout_s": "scan_timeout",
    "pose_timeout_s": "pose_timeout",
    "max_clock_skew_s": "transform_tolerance",
    "speed_scale": "speed_scale",
    "max_speed": "max_vel_x",
    "max_reverse_speed": "min_vel_x",
    "max_turn_rate": "max_vel_theta",
    "linear_acceleration": "acc_lim_x",
    "linear_deceleration": "decel_lim_x",
    "angular_acceleration": "acc_lim_theta",
}  # arguments of ControlLimits
_SAFETY = {
    "goal_radius": "xy_goal_tolerance",
    "max_path_distance": "max_path_distance",
    "min_measured_share": "min_measured_share",
}  # arguments of SafetyLimits


def checked_parameters(given: Mapping[str, Any], sources: tuple[str, ...]) -> dict[str, Any]:
    """Return the parameters of a node by name, integers in place of floats converted.

    Args:
        given: Values of :data:`PARAMETERS`.
        sources: Values of ``pose_source`` that the node has.

    Raises:
        ValueError: If a parameter is not allowed; the message names it.
    """
    values: dict[str, Any] = {
        name: _typed(name, given[name], default) for name, default in PARAMETERS.items()
    }
    source, frequency, mount = (
        values[name] for name in ("pose_source", "controller_frequency", "mount")
    )
    if source not in sources:
        raise ValueError(f"pose_source={source}: must be one of {', '.join(sources)}")
    if values["path_source"] not in ("plan", "map"):
        raise ValueError(f"path_source={values['path_source']}: must be one of plan, map")
    if not frequency >= _MIN_FREQUENCY_HZ:
        raise ValueError(
            f"controller_frequency={frequency}: must be at least {_MIN_FREQUENCY_HZ:g} Hz, so that "
            "the robot stops within 0.1 s"
        )
    if len(mount) != 3 or not any(map(math.isnan, mount)):
        checked_pose("mount", mount)
    low, high = values["free_thresh"], values["occupied_thresh"]
    if not 0.0 <= low < high <= 1.0:
        raise ValueError(f"free_thresh={low}: must be in 0 to below occupied_thresh={high}")
    return values


def _typed(name: str, value: object, default: object) -> object:
    """Return a value of the type of the parameter's default."""
    if isinstance(default, list):
        allowed = "a list of numbers"
        numbers = checked_numbers(name, cast(ArrayLike, value), allowed)
        if numbers.ndim != 1:
            raise ValueError(f"{name}={numbers.tolist()}: must be {allowed}")
        return numbers.tolist()
    if isinstance(default, float):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{name}={value!r}: must be a number")
        return float(value)
    if not isinstance(value, type(default)):
        allowed = "true or false" if isinstance(default, bool) else "text"
        raise ValueError(f"{name}={value!r}: must be {allowed}")
    return value


def unknown_parameters(given: Mapping[str, Any]) -> list[str]:
    """Return a line for each parameter that has no effect, with the nearest known ones.

    Args:
        given: Values of the command line or launch file by name.

    Example:
        >>> unknown_parameters({"policy": "paper", "max_vel_y": 0.5})  # doctest: +ELLIPSIS
        ['max_vel_y=0.5: no effect, the node has no such parameter; did you mean max_vel_x or ...']
    """
    from navrl.config import did_you_mean

    return [
        f"{name}={value}: no effect, the node has no such parameter{did_you_mean(name, PARAMETERS)}"
        for name, value in given.items()
        if name not in PARAMETERS and not name.startswith(_OF_ROS)
    ]


def ready_line(values: Mapping[str, Any], mount: tuple[float, float, float]) -> str:
    """Return the line that a node logs when it can drive.

    Args:
        values: Result of :func:`checked_parameters`.
        mount: (x, y, yaw) of the lidar in the robot frame, m and rad.
    """
    path = ["plan_topic"] if values["path_source"] == "plan" else ["map_topic", "goal_topic"]
    names = ["scan_topic", "odom_topic", *path, "emergency_stop_topic"]
    names += ["pose_topic"] if values["pose_source"] == "amcl_pose" else []
    sent = "nothing, dry_run" if values["dry_run"] else values["cmd_vel_topic"]
    place = ", ".join(f"{value:.3f}" for value in mount)
    return (
        f"ready: policy={values['policy']}, scanner={values['scanner']} at mount=[{place}], "
        f"pose from {values['pose_source']}; listens to {', '.join(values[k] for k in names)}; "
        f"publishes {sent}"
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
    limits = _named(ControlLimits, _LIMITS, parameters)
    safety = _named(SafetyLimits, _SAFETY, parameters)
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


def _named(kind: type[_T], names: Mapping[str, str], parameters: Mapping[str, Any]) -> _T:
    """Return limits by the node's names of their arguments.

    Raises:
        ValueError: If a limit is out of range; the message names the parameter.
    """
    values = {own: float(parameters[name]) for own, name in names.items()}
    for own in {"max_reverse_speed", "linear_deceleration"} & values.keys():
        values[own] = abs(values[own])  # negative in ROS
    if values.get("max_reverse_speed") == 0.0:
        values["max_reverse_speed"] = _NO_REVERSE
    try:
        return kind(**values)
    except ValueError as error:
        own, _, rest = str(error).partition("=")
        if own not in names:
            raise
        value, allowed = parameters[names[own]], rest.partition(": ")[2]
        raise ValueError(f"{names[own]}={value}: {allowed}") from error


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
