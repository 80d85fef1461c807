"""Composition of named transforms to a pipeline."""

from __future__ import annotations

from torchrl.envs import Compose, Transform

from navrl.transforms.action_shield import ActionShield
from navrl.transforms.command_rate_limit import CommandRateLimit
from navrl.transforms.icp_align import ICPAlign
from navrl.transforms.motion_compensation import MotionCompensation
from navrl.transforms.motion_prediction import MotionPrediction
from navrl.transforms.recovery import Recovery
from navrl.transforms.retreat import Retreat
from navrl.transforms.waypoints import Waypoints

BEFORE_ALL = ("scan_adapter",)
"""Names of steps that come first, wherever they are added: the others read their scans."""

AFTER_POOLING = ("motion_prediction", "motion_compensation", "full_range", "pose_history")
"""Names of steps that follow ``min_pool``, in this order, wherever they are added."""


def compose(**steps: Transform | None) -> Compose:
    """Chain named transforms in the given order; a shield is the last to change a command.

    Names make each step of a configuration addressable: a user can override a value of a step,
    replace it, append another, or remove it with ``null``. A bundle without, say,
    ``motion_compensation`` can be extended with it, although its configuration ends with others.

    A chain maps actions in reverse: its first step is the last to change a command. So a chain with
    an :class:`ActionShield`, a :class:`CommandRateLimit` or a :class:`Recovery` is reordered:
    observation transforms, limits of the rate, shields, then the transforms that change the action
    (those with ``in_keys_inv``), each group in the given order. The shield reads what every
    observation transform writes, and checks what every action transform returns, also those that a
    user appends; the limit does not change how the base drives.

    Args:
        **steps: Transforms by name; None omits a step.

    Returns:
        The chain of the steps that are not None.

    Raises:
        ValueError: If a step is not a transform, or the alignment reads poses or scans of another
            time than the network; the message names it.

    Example:
        >>> from navrl.transforms import MinPool, ScanHistory
        >>> len(compose(min_pool=MinPool(), scan_history=ScanHistory(), waypoints=None))
        2
    """
    for name, step in steps.items():
        if step is not None and not isinstance(step, Transform):
            raise ValueError(f"transforms.{name}={step!r}: must be a TorchRL Transform or null")
    _check_alignment(steps)
    _check_retreat(steps)
    given = [step for name in _ordered(list(steps)) if (step := steps[name]) is not None]
    return Compose(sorted(given, key=_rank) if any(map(_needs_order, given)) else given)


def _check_alignment(steps: dict[str, Transform | None]) -> None:
    """Check that what the alignment reads besides the scans is of their time and place."""
    aligns = next((step for step in steps.values() if isinstance(step, ICPAlign)), None)
    if aligns is None:
        return
    predicts = any(isinstance(step, MotionPrediction) for step in steps.values())
    if predicts and aligns.prior in ("pose", "velocity"):
        raise ValueError(
            f"transforms.icp_align.prior={aligns.prior}: must be pose_ahead or none, because "
            "motion_prediction moves the scans; steps/odometry_prior_ahead.yaml sets it"
        )
    compensates = any(isinstance(step, MotionCompensation) for step in steps.values())
    full = steps.get("full_range")
    if not (compensates and aligns.full_range and isinstance(full, Compose)):
        return
    motions = [step.in_keys[2] for step in full.transforms if isinstance(step, MotionCompensation)]
    scans = [step.in_keys[2] for step in steps.values() if isinstance(step, MotionCompensation)]
    if motions != scans:
        needed = "full_range_ahead" if predicts else "full_range_compensated"
        raise ValueError(
            "transforms.full_range: its scans must be moved as those of motion_compensation; "
            f"steps/{needed}.yaml does it"
        )


def _check_retreat(steps: dict[str, Transform | None]) -> None:
    """Check that a recovery drives a retreat, and that it is in the frame of the waypoints."""
    given = list(steps.values())
    for step in (step for step in given if isinstance(step, Retreat)):
        recoveries = [one for one in given if isinstance(one, Recovery)]
        drives = [one for one in recoveries if {*step.out_keys[:2]} <= {*one.scan_keys}]
        if not drives:
            raise ValueError(
                f"transforms.retreat: must have a recovery that reads {step.out_keys[:2]}; "
                "steps/retreat.yaml adds it"
            )
        if not step.patience > drives[0].patience:
            raise ValueError(
                f"transforms.retreat.patience={step.patience}: must be > "
                f"transforms.recovery.patience={drives[0].patience} s"
            )
        poses = {way.in_keys[0] for way in given if isinstance(way, Waypoints)}
        if poses and step.in_keys[4] not in poses:
            raise ValueError(
                f"transforms.retreat.in_keys={step.in_keys}: must read the pose of the waypoints, "
                f"{poses.pop()!r}"
            )


def _ordered(names: list[str]) -> list[str]:
    """Return the names with :data:`BEFORE_ALL` first, :data:`AFTER_POOLING` after the pooling."""
    first = [name for name in BEFORE_ALL if name in names]
    names = first + [name for name in names if name not in first]
    if "min_pool" not in names:
        return names
    moved = [name for name in AFTER_POOLING if name in names]
    others = [name for name in names if name not in moved]
    after = others.index("min_pool") + 1
    return [*others[:after], *moved, *others[after:]]


def _needs_order(step: Transform) -> bool:
    return isinstance(step, (ActionShield, CommandRateLimit, Recovery))


def _rank(step: Transform) -> int:
    if isinstance(step, CommandRateLimit):
        return 1
    if isinstance(step, ActionShield):
        return 2
    return 3 if step.in_keys_inv else 0
