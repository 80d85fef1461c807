"""Findings of a log: what works, what may not, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from navrl.deploy.bags.messages import Topic
from navrl.deploy.doctor_findings import Checked, Finding, Level
from navrl.deploy.safety import DriveState

_YAW_RAD = 0.26  # 15 deg; a yaw off by 5 deg costs no success (docs/robots.md)
_AGREEMENT = 0.9  # of the directions of the pairs; below, the guess is not used
_GAP = 3.0  # times the median interval between scans


def diagnose(facts: Checked) -> list[Finding]:
    """Return the findings of a log, in the order of a robot's pipeline."""
    checks = (_beams, _readings, _states, _rate, _age, _frames, _mount, _own_parts, _poses)
    return [found for check in (*checks, _quality_of_service, _speeds) for found in check(facts)]


# --- scans ---------------------------------------------------------------------------------------


def _beams(facts: Checked) -> Iterator[Finding]:
    found, count = facts.measures, sorted(facts.measures.beams)
    refused, reason = found.num_refused
    if refused:
        action = "correct the driver's angles and limits"
        yield Finding(Level.FAILURE, "scan", f"{refused} scans are refused: {reason}", action)
        return
    angle_min, step = next(iter(sorted(found.angles)))
    width = min(abs(step) * count[-1], math.tau)
    number = f"{count[0]}" if len(count) == 1 else f"{count[0]} to {count[-1]}"
    order = "clockwise" if step < 0.0 else "counter-clockwise"
    text = f"{number} beams from {angle_min:.3f} rad, {order}, {math.degrees(width):.0f} degrees"
    yield Finding(Level.OK, "field of view", text)
    if abs(step) > facts.scanner.max_beam_width:
        text = f"{math.degrees(abs(step)):.1f} degrees between beams, nothing is seen in between"
        action = f"scanner.max_beam_width={abs(step) * 1.05:.3f} if thin obstacles may be missed"
        yield Finding(Level.WARNING, "field of view", text, action)
    if width < math.tau - 0.1:
        text = "below 360 degrees: what is beside and behind is not seen"
        action = "prefer a policy trained with lidar=varied or the robot's own field of view"
        yield Finding(Level.WARNING, "field of view", text, action)
    low, high = min(r[0] for r in found.limits), max(r[1] for r in found.limits)
    yield Finding(Level.OK, "range", f"{low:g} to {high:g} m")
    wanted = facts.network_range or facts.lidar.max_range
    if high < wanted:
        text = f"{high:g} m is below the policy's {wanted:g} m"
        yield Finding(Level.WARNING, "range", text, "drive slower: speed_scale")


def _readings(facts: Checked) -> Iterator[Finding]:
    shares, largest = facts.measures.readings, facts.measures.largest_reading
    listed = ", ".join(f"{100 * share:.1f} % {name}" for name, share in shares.items())
    yield Finding(Level.OK, "readings", listed)
    if largest > 200.0:
        text = f"largest readings around {largest:g}: these are millimeters"
        yield Finding(Level.FAILURE, "readings", text, "let the driver publish meters")
    zeros, missing = shares.get("0", 0.0), shares.get("NaN", 0.0) + shares.get("negative", 0.0)
    if zeros > 0.01 and facts.scanner.zero == "no_return":
        text = f"{100 * zeros:.1f} % of the readings are 0, taken as free space"
        action = "scanner.zero=invalid unless the driver writes 0 for no return"
        yield Finding(Level.WARNING, "readings", text, action)
    if missing > 0.2:
        text = f"{100 * missing:.0f} % of the readings are invalid (NaN or negative)"
        action = "scanner.nan=no_return if the driver writes NaN for no return"
        yield Finding(Level.WARNING, "readings", text, action)
    near = shares.get("below range_min", 0.0)
    if near > 0.01:
        text = f"{100 * near:.1f} % of the readings are below range_min and not seen"
        action = "look for parts of the robot before the lidar, or correct range_min"
        yield Finding(Level.WARNING, "readings", text, action)


def _states(facts: Checked) -> Iterator[Finding]:
    states = facts.measures.states
    total = sum(states.values())
    if not total:
        return
    for state, action in (
        (DriveState.BLIND, "see the other findings; the mount decides where ahead is"),
        (DriveState.BLOCKED, "look for parts of the robot before the lidar"),
    ):
        share = states[state] / total
        if share > 0.02:
            level = Level.FAILURE if share > 0.5 else Level.WARNING
            text = f"the robot would stop as {state} at {100 * share:.0f} % of the scans"
            yield Finding(level, "scan check", text, action)
    if states[DriveState.DRIVE] == total:
        yield Finding(Level.OK, "scan check", f"all of {total} tested scans are usable")


def _rate(facts: Checked) -> Iterator[Finding]:
    stamps = facts.measures.stamps
    if len(stamps) < 3:
        yield Finding(Level.FAILURE, "scan rate", f"{len(stamps)} scans", "record a longer log")
        return
    steps = np.diff(stamps)
    typical, longest = float(np.median(steps)), float(steps.max())
    back = int((steps <= 0.0).sum())
    if back:
        text = f"{back} of {len(steps)} stamps do not increase; these scans are ignored"
        level = Level.FAILURE if back > 0.5 * len(steps) else Level.WARNING
        yield Finding(level, "scan stamps", text, "let the driver stamp each scan")
    if typical <= 0.0:
        return
    text = f"{1.0 / typical:.1f} Hz, longest gap {longest:.2f} s"
    limit = facts.limits.max_step_s or 2.0 * facts.time_step_s
    if typical > limit:
        action = f"the policy needs a scan every {facts.time_step_s:g} s"
        text += "; the scan history restarts at each scan, moving obstacles are not recognized"
        yield Finding(Level.FAILURE, "scan rate", text, action)
    elif typical > 1.05 * facts.time_step_s:
        action = f"the policy was trained with a scan every {facts.time_step_s:g} s"
        yield Finding(Level.WARNING, "scan rate", text, action)
    elif longest > max(_GAP * typical, limit):
        gaps = int((steps > limit).sum())
        action = "look for a lossy network or a slow recorder"
        yield Finding(Level.WARNING, "scan rate", f"{text}; {gaps} gaps restart history", action)
    else:
        yield Finding(Level.OK, "scan rate", text)


def _age(facts: Checked) -> Iterator[Finding]:
    ages, limits = facts.measures.ages, facts.limits
    if not len(ages):
        return
    typical, oldest = float(np.median(ages)), float(ages.max())
    text = f"{typical:.3f} s from stamp to reception (median), {oldest:.3f} s at most"
    if typical > limits.scan_timeout_s or typical < -limits.max_clock_skew_s:
        action = "synchronize the clocks (chrony, use_sim_time); clock=stamp replays it anyway"
        yield Finding(Level.FAILURE, "scan age", f"{text}: stale_scan at each tick", action)
    elif oldest > limits.scan_timeout_s or float(ages.min()) < -limits.max_clock_skew_s:
        share = float((ages > limits.scan_timeout_s).mean())
        text += f"; {100 * share:.1f} % beyond scan_timeout"
        yield Finding(Level.WARNING, "scan age", text, "look for a slow network or driver")
    else:
        yield Finding(Level.OK, "scan age", text)


# --- frames and motion ---------------------------------------------------------------------------


def _frames(facts: Checked) -> Iterator[Finding]:
    frames, source = sorted(facts.measures.frames), facts.source
    if len(frames) > 1:
        text = f"scans have the frames {', '.join(frames)}"
        action = "two drivers publish on one topic: give each its own"
        yield Finding(Level.FAILURE, "frames", text, action)
    placed = source.tree.lookup(source.base_frame, frames[0]) if frames else None
    if placed is None:
        return
    off = min(placed.tilt, math.pi - placed.tilt)
    if off > 0.1:
        text = f"the lidar is tilted by {math.degrees(off):.0f} degrees, scans are not planar"
        yield Finding(Level.WARNING, "frames", text, "mount it level, or correct tf")


def _mount(facts: Checked) -> Iterator[Finding]:
    guess, scanner = facts.measures.mount, facts.scanner
    x, y, yaw = (float(value) for value in scanner.mount)
    text = f"({x:.2f} m, {y:.2f} m, {_degrees(yaw)} degrees) from {facts.mount_source}"
    is_assumed = facts.mount_source.startswith("assumed")
    if guess.is_mirrored is not None and guess.is_mirrored != scanner.is_upside_down:
        seen = "clockwise" if guess.is_mirrored else "counter-clockwise"
        text = f"{text}; by odometry the scans are {seen} as seen from above"
        action = f"scanner.is_upside_down={str(guess.is_mirrored).lower()}, or correct tf"
        yield Finding(Level.FAILURE, "mount", text, action)
        return
    if guess.yaw is None or guess.agreement < _AGREEMENT:
        level = Level.WARNING if is_assumed else Level.OK
        action = "give mount=[x,y,yaw]" if is_assumed else ""
        text += "; not checked, the robot hardly drives straight in the log"
        yield Finding(level, "mount", text, action)
        return
    off = math.remainder(guess.yaw - yaw, math.tau)
    seen = f"by the motion of {guess.num_pairs} pairs of scans {_degrees(guess.yaw)}"
    if abs(off) > _YAW_RAD:
        text = f"{text}; {seen} degrees: the policy would look into another direction"
        node = f'-p mount:="[{x:.3f}, {y:.3f}, {guess.yaw:.3f}]"'
        action = f"'mount=[{x:g},{y:g},{guess.yaw:.3f}]' (node: {node}), or correct tf"
        yield Finding(Level.FAILURE, "mount", text, action)
    else:
        level = Level.WARNING if is_assumed else Level.OK
        action = "measure x and y and give mount=[x,y,yaw]" if is_assumed else ""
        yield Finding(level, "mount", f"{text}; {seen} degrees", action)


def _own_parts(facts: Checked) -> Iterator[Finding]:
    sectors = facts.measures.own_sectors
    if sectors:
        text = f"something is within 0.4 m at {len(sectors)} bearings of the lidar in all scans"
        listed = ",".join(f"[{bearing:g},{width:g}]" for bearing, width in sectors[:12])
        action = f"if it is the robot: 'scanner.blind_sectors=[{listed}]'"
        yield Finding(Level.WARNING, "own parts", text, action)


def _poses(facts: Checked) -> Iterator[Finding]:
    found, source, limits = facts.measures, facts.source, facts.limits
    if source.odometry is None:
        text = "no odometry: motion since a scan is estimated from commands"
        yield Finding(Level.WARNING, "odometry", text, "record nav_msgs/Odometry")
    elif len(found.odometry_stamps) > 1:
        step = float(np.median(np.diff(found.odometry_stamps)))
        level = Level.OK if 0.0 < step < 0.5 * limits.pose_timeout_s else Level.WARNING
        rate = f"{1.0 / step:.0f} Hz" if step > 0.0 else "its stamps do not increase"
        text = f"{rate}, {found.driven_m:.1f} m driven"
        yield Finding(level, "odometry", text, "" if level is Level.OK else "at least 10 Hz")
    if source.pose_source == "odometry":
        text = "no localization in the log: odometry is taken as the pose"
        action = "record /tf or /amcl_pose, or plan in the frame of odometry"
        if source.has_tf:
            frame = source.topics.global_frame
            text += f"; tf has no transform from {frame} to {source.base_frame}"
            action = "record tf while localization runs, or set global_frame to a frame of tf"
        yield Finding(Level.WARNING, "pose", text, action)
    elif source.pose_source == "standing":
        yield Finding(Level.WARNING, "pose", "none, the robot is taken as standing", "")
    elif len(found.pose_ages):
        age = float(np.median(found.pose_ages))
        text = f"{len(found.pose_ages)} from {source.pose_source}, {age:.3f} s old (median)"
        is_late = age > limits.pose_timeout_s and source.odometry is None
        is_ahead = age < -limits.max_clock_skew_s
        level = Level.FAILURE if is_late or is_ahead else Level.OK
        yield Finding(level, "pose", text, "synchronize the clocks" if level else "")


# --- topics and limits ---------------------------------------------------------------------------


def _quality_of_service(facts: Checked) -> Iterator[Finding]:
    source, topics = facts.source, facts.source.log.topics
    known = [name for name in (source.scan, source.odometry, source.pose, source.path) if name]
    offered = {name: topics[name] for name in known if topics[name].reliability}
    if not offered:
        return
    listed = ", ".join(f"{name} {_offered(topic)}" for name, topic in offered.items())
    yield Finding(Level.OK, "QoS", listed)
    pose, path = offered.get(source.pose or ""), offered.get(source.path or "")
    if pose is not None and pose.durability == "volatile":
        text = (
            f"{pose.name} is volatile; the node with pose_source:=amcl_pose asks for a latched one"
        )
        action = "use pose_source:=tf, or publish it transient local"
        yield Finding(Level.WARNING, "QoS", text, action)
    if path is not None and path.reliability == "best_effort":
        text = f"{path.name} is best effort; the node asks for a reliable one and gets none"
        yield Finding(Level.FAILURE, "QoS", text, "publish it reliable")


def _offered(topic: Topic) -> str:
    return f"{topic.reliability}, {topic.durability}"


def _speeds(facts: Checked) -> Iterator[Finding]:
    slowest, fastest, turn = facts.measures.speeds
    lower, upper = (list(map(float, limit)) for limit in facts.robot.command_limits)
    text = f"v {slowest:.2f} to {fastest:.2f} m/s, w up to {turn:.2f} rad/s in the log"
    text += f"; the policy commands up to {upper[0]:g} m/s and {upper[1]:.2f} rad/s"
    action = ""
    if fastest < 0.7 * upper[0]:
        speed = max(fastest, 0.05)
        action = f"if the base is slower: +limits.max_speed={speed:.2f}, max_vel_x:={speed:.2f}"
    yield Finding(Level.OK, "limits", text, action)
    if slowest < lower[0] - 0.05:
        text = f"the log drives backwards at {-slowest:.2f} m/s, the policy never does"
        yield Finding(Level.OK, "limits", text)


def _degrees(angle: float) -> int:
    return round(math.degrees(angle))
