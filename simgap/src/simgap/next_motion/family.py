"""Family of motions of a robot: one joint goes to and fro, within what logs and robot file allow.

Parameters are joint, ends, speed or jumps, rests, pose of the other joints, gain, conditions, temperature
and power.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.checks.static import visit_poses
from simgap.common.errors import RobotError
from simgap.effects.effect import joint_scales
from simgap.logs import JointLog, Motion, Signal
from simgap.robot import ControlMode, Robot

NAME: Final = "next"
"""Name of a proposed motion."""
LENGTH_s: Final = 10.0
"""Length of a motion: several turns of all but the slowest, and too short for a motor to heat up."""
START_s: Final = 1.0
"""Rest before and after; a first second depends on where friction held the joint, and is not compared."""
ENDS: Final = ((0.0, 1.0), (0.0, 0.4), (0.3, 0.7), (0.6, 1.0), (0.0, 0.1), (0.45, 0.55), (0.9, 1.0))
"""Ends of a motion, in the range of the logged commands."""
SPEED_SHARES: Final = (1.0, 0.3, 0.1, 0.03)
"""Largest speeds, in the usual speed of the logs."""
RESTS_s: Final = (0.0, 0.5)
POSES: Final = (0.5, 0.1, 0.9)
"""Pose of the other joints: quantiles of their logged positions."""
JUMP: Final = 5.0
"""Step of a command between two samples, over that of the usual speed, from which on it is a jump."""
PATH_MODES: Final = (ControlMode.POSITION, ControlMode.VELOCITY)
"""Modes in which the commands of a motion follow from its path."""
MOST: Final = 100
"""Most motions that are compared; of more, a random part: more take their time and are hardly better."""
PEAK: Final = 1.875
"""Largest over mean speed of a polynomial of fifth order that begins and ends at rest."""


@dataclass(frozen=True, slots=True)
class Plan:
    """One motion of the family."""

    joint: str
    ends_rad: tuple[float, float]
    speed_rad_s: float
    """Largest speed; infinite for jumps."""
    rest_s: float
    """Rest at each end."""
    others_rad: Mapping[str, float]
    """Where all other joints are held."""
    gain: Mapping[str, float]
    """Value of the gain column of each joint."""
    conditions: Mapping[str, float]
    temperatures_degC: Mapping[str, float]
    """Temperature of each joint that has a log of it."""
    off_s: float = np.inf
    """Time from which the joint, and all with its column of power, have none; infinite if they keep it."""

    def describe(self, robot: Robot) -> str:
        """Return the motion in words."""
        low, high = (robot.show(self.joint, one) for one in self.ends_rad)
        top = f"at up to {robot.show(self.joint, self.speed_rad_s)}/s"
        speed = top if self.speed_rad_s < np.inf else "in jumps"
        rests = f", with rests of {self.rest_s:g} s" if self.rest_s else ""
        rests += f", without power from {self.off_s:g} s" if self.off_s < np.inf else ""
        held = [f"{name} at {robot.show(name, at)}" for name, at in self.others_rad.items()]
        gained = [name for name, one in (robot.file.joints if robot.file else {}).items() if one.gain_column]
        gains = {f"gain {self.gain[name]:g}" for name in gained}
        given = [*held, *sorted(gains), *(f"{name} = {value:g}" for name, value in self.conditions.items())]
        given += [f"{heat:g} degC" for name, heat in self.temperatures_degC.items() if name == self.joint]
        more = f"; {', '.join(given)}" if given else ""
        return f"{self.joint} from {low} to {high} and back {speed}{rests}{more}"


def list_plans(
    robot: Robot, motions: Sequence[Motion], places: Sequence[str], is_simulated: bool
) -> list[Plan]:
    """List the motions that may tell effects at some places apart, in random order.

    Args:
        motions: Logged motions, whose commands, speeds, gains and conditions are the limits.
        places: Names of joints; another place may show at any joint.
        is_simulated: True if the commands are simulated, False if a controller is taken to follow the motion.

    Raises:
        RobotError: A simulated joint is commanded by torque, current or voltage.
    """
    free = next((one for one in robot.joints if one.mode not in PATH_MODES), None)
    if free is not None and is_simulated:
        raise RobotError(
            f"joint {free.name}: is commanded by {free.mode}; a motion can be proposed for commands of "
            "position or velocity"
        )
    names = [joint.name for joint in robot.joints]
    moving = [one for one in names if one in places] if set(places) & {*names} else names
    logged_rad = {name: _positions(motions, name) for name in names}
    gains, given = _some([one.gain for one in motions]), _list_conditions(robot, motions)
    heats = _some([_round_temperatures(one) for one in motions])
    offs = {name: _list_offs(motions, name) if is_simulated else (np.inf,) for name in names}
    poses = POSES if len(names) > 1 else POSES[:1]
    plans = [
        Plan(name, ends, speed, rest_s, held, gain, conditions, heat, off_s)
        for name in moving
        for pose in poses
        for held in [{one: float(np.quantile(logged_rad[one], pose)) for one in names if one != name}]
        for ends, speed in _strokes(robot, motions, name, logged_rad[name])
        for rest_s, gain, conditions, heat, off_s in product(RESTS_s, gains, given, heats, offs[name])
        if _has_time(ends, speed, rest_s)
    ]
    order = np.random.default_rng(1).permutation(len(plans))
    touching = list_touching(robot, motions)
    free_plans = (plans[k] for k in order if list_contacts(robot, _poses(robot, plans[k])) <= touching)
    return [one for one, _ in zip(free_plans, range(MOST), strict=False)]


def _some(values: Sequence[Mapping[str, float]]) -> Sequence[Mapping[str, float]]:
    """Return the least, the middle and the greatest of some settings."""
    unique = {tuple(one.items()): one for one in values}
    ordered = sorted(unique.values(), key=lambda one: tuple(one.values()))
    return [ordered[k] for k in sorted({0, len(ordered) // 2, len(ordered) - 1})]


def _list_conditions(robot: Robot, motions: Sequence[Motion]) -> Sequence[Mapping[str, float]]:
    """Return some conditions of the logs, and one for each value that the robot file calls possible."""
    logged = _some([one.conditions for one in motions])
    middle, tables = logged[len(logged) // 2], robot.file.conditions if robot.file else {}
    more = [{**middle, name: value} for name, one in tables.items() for value in dict.fromkeys(one.possible)]
    return [*logged, *(one for one in more if one not in logged)]


def _round_temperatures(motion: Motion) -> Mapping[str, float]:
    """Return the temperature of each joint that has a log of it, in whole degrees: none is met closer."""
    logs = {name: one.temperature for name, one in motion.joints.items()}
    return {name: float(np.round(np.mean(one.value))) for name, one in logs.items() if one is not None}


def _list_offs(motions: Sequence[Motion], joint: str) -> tuple[float, ...]:
    """Return when a joint may lose its power: never, or half way if the logs show it without."""
    logs = [one.joints[joint].enabled for one in motions]
    return (np.inf, 0.5 * LENGTH_s) if any(one and np.any(one.value < 0.5) for one in logs) else (np.inf,)


def _positions(motions: Sequence[Motion], joint: str) -> Array:
    """Return where a joint was in the logs, (n,) [rad], at as many times in every motion."""
    parts = []
    for motion in motions:
        log = motion.joints.get(joint)
        if log is None:
            raise RobotError(f"motion {motion.name}: joint {joint} has no log; a motion needs all joints")
        signal = log.position
        at_s = np.linspace(signal.time_s[0], signal.time_s[-1], 50)
        parts.append(np.interp(at_s, signal.time_s, signal.value))
    return np.concatenate(parts)


def _strokes(
    robot: Robot, motions: Sequence[Motion], joint: str, logged_rad: Array
) -> Iterator[tuple[tuple[float, float], float]]:
    """Yield ends and speeds of a joint within what the logs show."""
    low, high = float(logged_rad.min()), float(logged_rad.max())
    commands = [one.joints[joint].command for one in motions]
    known = [one for one in commands if one is not None and robot.joint(joint).mode is ControlMode.POSITION]
    if known:
        low, high = (float(find([find(one.value) for one in known])) for find in (np.min, np.max))
    table = robot.file.joints[joint] if robot.file else None
    if table and table.possible_rad:
        low, high = table.possible_rad
    usual = joint_scales(robot, motions)[joint].speed_rad_s
    changes = [(np.abs(np.diff(one.value)), np.diff(one.time_s)) for one in known]
    steps = [(float(np.max(jump)), float(np.median(step_s))) for jump, step_s in changes]
    jump = max((step for step, dt in steps if step > JUMP * usual * dt), default=0.0)
    for share in ENDS:
        ends = low + share[0] * (high - low), low + share[1] * (high - low)
        if ends[1] > ends[0]:
            yield from ((ends, usual * speed) for speed in SPEED_SHARES)
            if ends[1] - ends[0] <= jump:
                yield ends, np.inf


def _has_time(ends: tuple[float, float], speed: float, rest_s: float) -> bool:
    """Return whether there is time for a way there and back; jumps need rests, else nothing settles."""
    way_s = PEAK * (ends[1] - ends[0]) / speed
    return 2.0 * (way_s + rest_s) <= LENGTH_s - 2.0 * START_s and (speed < np.inf or rest_s > 0.0)


def _poses(robot: Robot, plan: Plan) -> Array:
    """Return poses along a motion, (n, n_joints) [rad]."""
    way = np.linspace(*plan.ends_rad, 7)
    return np.column_stack(
        [way if one.name == plan.joint else np.full(7, plan.others_rad[one.name]) for one in robot.joints]
    )


def list_touching(robot: Robot, motions: Sequence[Motion]) -> set[tuple[int, int]]:
    """Return the `list_contacts` of logged poses; RobotError if a joint has no log."""
    return list_contacts(robot, np.column_stack([_positions(motions, one.name) for one in robot.joints]))


def list_contacts(robot: Robot, q_rad: Array) -> set[tuple[int, int]]:
    """Return the pairs of geoms that touch in some poses, (n, n_joints) [rad], and (-1, joint) at a limit."""
    found, model = set(), robot.model
    for _, data in visit_poses(robot, [one.name for one in robot.joints], q_rad):
        mujoco.mj_collision(model, data)
        if data.ncon:  # to read the contacts takes longer than all the rest
            found |= {(int(a), int(b)) for a, b in data.contact.geom}
        (low, high), q = model.jnt_range.T, data.qpos[model.jnt_qposadr]
        found |= {(-1, int(k)) for k in np.flatnonzero(model.jnt_limited * ((q < low) | (q > high)))}
    return found


def make_motion(robot: Robot, plan: Plan, logged: Motion, name: str = NAME) -> Motion:
    """Return a motion as it would be logged if joints went where they are sent.

    Args:
        logged: Motion whose rate and signals it has.
    """
    first = logged.joints[robot.joints[0].name].position.time_s
    time_s = np.arange(0.0, LENGTH_s, float(np.median(np.diff(first))))
    columns = {name: one.enabled for name, one in (robot.file.joints if robot.file else {}).items()}
    joints, power = {}, columns.get(plan.joint)
    for joint in robot.joints:
        log, path = logged.joints[joint.name], np.full(time_s.size, plan.others_rad.get(joint.name, 0.0))
        if joint.name == plan.joint:
            path = _path(plan, time_s)
        speed, still = np.gradient(path, time_s), np.zeros(time_s.size)
        values = {"position": path, "secondary": path, "velocity": speed, "torque": still}
        is_on = joint.name != plan.joint and (power is None or columns[joint.name] != power)
        values["enabled"] = still + (is_on | (time_s < plan.off_s))
        if joint.mode in PATH_MODES:
            values["command"] = path if joint.mode is ControlMode.POSITION else speed
        if joint.name in plan.temperatures_degC:
            values["temperature"] = still + plan.temperatures_degC[joint.name]
        known = {key for key in values if getattr(log, key)} | ({"enabled"} if plan.off_s < np.inf else set())
        there = {key: Signal(time_s, own) for key, own in values.items() if key in known}
        joints[joint.name] = JointLog(**there)
    return Motion(name, joints, plan.gain, conditions=plan.conditions)


def _path(plan: Plan, time_s: Array) -> Array:
    """Return the position of the moving joint, (n,) [rad]."""
    low, high = plan.ends_rad
    way_s = PEAK * (high - low) / plan.speed_rad_s
    half_s = way_s + plan.rest_s
    count = 2 * int((LENGTH_s - 2.0 * START_s) / (2.0 * half_s))
    since = np.maximum(time_s - START_s, 0.0)
    number = np.minimum((since / half_s).astype(int), count)
    s = np.clip((since - number * half_s) / max(way_s, 1e-9), 0.0, 1.0)
    s = np.where((number >= count) | (time_s < START_s), 0.0, s)
    share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return np.asarray(low + (high - low) * np.where(number % 2 == 0, share, 1.0 - share))
