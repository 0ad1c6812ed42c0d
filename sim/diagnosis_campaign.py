"""Sessions of motions for diagnosis, and their execution in the closed loop.

Each motion is short and separates a few effects from the others. A session begins at rest on the brakes.
Poses of the tables are in degrees.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.commands import Command, GuardedMove, MoveJoint, MoveJoints, Preload, SetParam
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Severity
from fsw.dictionary.params import Params
from fsw.dictionary.types import Joints5, joints5, vector3
from fsw.estimate.reference import Reference
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle, settle_output
from fsw.kinematics.transforms import Array
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.effects.environment import Ambient
from sim.frames import p_R_from_N
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.sequence import Outcome, SequenceRun
from sim.setting import WARM_C, Surface, World

Degrees5 = tuple[int, int, int, int, int]
ROLL_RAD: Final = float(np.radians(20.0))
SESSION_COLD_C: Final = -50.0
FAST_RAD, SLOW_RAD, TURN_RAD = (float(np.radians(deg)) for deg in (5.0, 0.75, 0.75))
SLOW_FRACTION: Final = 0.2
"""Fraction of the nominal speed of a joint."""
OUTSTRETCHED: Final[Degrees5] = (0, -40, 60, 60, 60)
HELD_OUT_POSE: Final[Degrees5] = (-20, -60, 80, 90, 120)
COORDINATED_TURN: Final[Degrees5] = (5, -5, 5, -10, 10)
POSES: Final[tuple[tuple[Degrees5, Degrees5], ...]] = (
    ((-44, -90, 102, -154, 227), (-39, -95, 97, -161, 233)),
    ((32, -86, 68, 53, 65), (26, -91, 61, 60, 61)),
    ((37, -39, -34, -162, 140), (41, -43, -27, -167, 147)),
    ((54, -41, -50, 61, 30), (48, -48, -56, 66, 35)),
    ((60, -84, -113, 100, 151), (65, -80, -119, 105, 155)),
    ((13, -111, -75, 197, 290), (9, -115, -68, 201, 283)),
    ((59, -115, 44, 2, 237), (63, -108, 37, -5, 241)),
    ((-45, -149, 78, 120, 34), (-52, -143, 71, 116, 29)),
)
"""Pairs of near poses [deg], one pair for each branch of the inverse kinematics, in their order."""
TILTED_POSES: Final[tuple[tuple[Degrees5, Degrees5], ...]] = (
    ((10, -130, 95, 123, 220), (17, -126, 89, 117, 213)),
    ((-70, -14, 18, -2, 313), (-74, -7, 11, 3, 306)),
    ((54, -42, -30, 181, 125), (47, -38, -34, 187, 119)),
    ((-89, -152, 109, 192, 7), (-83, -146, 104, 188, 3)),
    ((-84, -112, -30, -176, 233), (-89, -108, -36, -181, 229)),
    ((-90, -95, -137, -172, 313), (-86, -102, -133, -166, 308)),
    ((-64, -137, 90, 15, 141), (-59, -144, 96, 19, 148)),
    ((-27, -110, 21, 69, 6), (-21, -117, 26, 76, -1)),
)
"""Pairs of near poses [deg] on the same branches, for the rolled rover."""
PRESS_N: Final = 200.0
SLIDE_RAD: Final = float(np.radians(20.0))
"""Tilt of a rock on which a tool stays by its friction, and slips with a quarter less."""
STANDOFF_M: Final = 0.02
"""Distance from a rock at which a placement begins."""
OVERTRAVEL_M: Final = 0.03
SESSION_REST_S: Final = 1.0
"""Rest before and after a motion of the campaign."""
TOUCHING_DEG: Final[Degrees5] = (0, -50, 100, 130, 90)
"""Pose from which a rock is touched."""
HELD_OUT_SESSIONS: Final = (
    "poses-level-5",
    "poses-level-8",
    "poses-rolled-3",
    "poses-rolled-7",
    "elsewhere-cold",
    "elsewhere-warm",
)
"""Sessions for the hold-out validation of a diagnosis that is fitted to the others."""


@dataclass(frozen=True, slots=True)
class DiagnosisSession:
    """Plan of one log: its start, its commands and its conditions."""

    name: str
    block: str
    """Name that the repeats of one motion share."""
    world: World
    temperature_C: float
    start_rad: tuple[float, ...]
    """Output angles, shape (5,)."""
    commands: tuple[Command, ...]
    tracked: bool
    """True if a laser tracker measures the turret whenever the arm rests."""
    rest_s: float = SESSION_REST_S
    """Rest before and after each command."""


@dataclass(frozen=True, slots=True, eq=False)
class SessionCycle:
    """One cycle of a session."""

    record: CycleRecord
    rested: bool
    """True if the arm has rested long enough to be measured."""


class SessionFailed(RuntimeError):
    """Session with a command that was not completed."""


def campaign_sessions(params: Params) -> tuple[DiagnosisSession, ...]:
    """List all sessions of the campaign, in order, for an arm with these flight parameters."""
    return (
        *pose_sessions(params),
        *sweep_sessions(params),
        *coordinated_sessions(params),
        *placement_sessions(params),
    )


def pose_sessions(params: Params) -> list[DiagnosisSession]:
    """List sessions with two poses on every branch, level and rolled; the first of each is repeated."""
    sessions = []
    for attitude, pairs, roll_rad in (("level", POSES, 0.0), ("rolled", TILTED_POSES, ROLL_RAD)):
        for number, pair in enumerate(pairs, 1):
            start, end = within_limits(params, *pair)
            for suffix in ("", "-again") if number == 1 else ("",):
                block = f"poses-{attitude}-{number}"
                sessions.append(
                    DiagnosisSession(
                        block + suffix,
                        block,
                        World("mars", roll_rad),
                        WARM_C,
                        start,
                        (MoveJoints(end, "off"),),
                        tracked=True,
                    )
                )
    return sessions


def sweep_sessions(params: Params) -> list[DiagnosisSession]:
    """List sessions that move one joint from the outstretched pose; that of the elevation is repeated.

    Each joint moves away and back fast, then slowly, then by a small angle.
    """
    sessions = []
    for joint in Joint:
        for suffix in ("", "-again") if joint is Joint.ELEVATION else ("",):
            name = joint.name.lower()
            roll_rad = ROLL_RAD if joint in (Joint.AZIMUTH, Joint.TURRET) else 0.0
            sessions.append(
                DiagnosisSession(
                    f"sweep-{name}{suffix}",
                    f"sweep-{name}",
                    World("mars", roll_rad),
                    WARM_C,
                    within_limits(params, OUTSTRETCHED)[0],
                    _sweep(params, joint),
                    tracked=False,
                )
            )
    return sessions


def coordinated_sessions(params: Params) -> list[DiagnosisSession]:
    """List sessions that move all joints at once, in the cold and warm, from two poses."""
    sessions = []
    for name, block, temperature_C, degrees in (
        ("cold", "cold", SESSION_COLD_C, OUTSTRETCHED),
        ("cold-again", "cold", SESSION_COLD_C, OUTSTRETCHED),
        ("warm", "warm", WARM_C, OUTSTRETCHED),
        ("elsewhere-cold", "elsewhere-cold", SESSION_COLD_C, HELD_OUT_POSE),
        ("elsewhere-warm", "elsewhere-warm", WARM_C, HELD_OUT_POSE),
    ):
        here, _ = within_limits(params, degrees, np.add(degrees, COORDINATED_TURN))
        there = joints5(np.array(here) + np.radians(COORDINATED_TURN))
        commands = MoveJoints(there, "off"), MoveJoints(here, "off")
        sessions.append(DiagnosisSession(name, block, World("mars"), temperature_C, here, commands, False))
    return sessions


def placement_sessions(params: Params) -> list[DiagnosisSession]:
    """List placements of the first and the last tool with switches, each on a rock in front of the tool.

    A last rock is tilted away from the turret, about the y axis of the tool, which the pads are on: the tool
    presses aside.
    """
    config, sessions = configure(params), []
    touching = [tool for tool, switches in params.tool_switches.items() if switches]
    for tool in dict.fromkeys((touching[0], touching[-1])):
        start = np.array(within_limits(params, TOUCHING_DEG)[0])
        gravity = World("mars").gravity_N_m_s2
        flank = np.sign(settle_output(config.arm, start, gravity).torque_Nm)
        deflected = settle(config.arm, start, flank * config.half_backlash_rad, gravity)
        X_RT = tool_pose(config.arm, deflected.frames, tool)
        x, _, z = X_RT.R.T
        aside = np.copysign(1.0, config.arm.X_FT[tool].R[:, 2] @ config.arm.X_FT[tool].p) * z
        for name, tilt_rad in (("place", 0.0), ("slide", SLIDE_RAD))[: 1 + (tool == touching[-1])]:
            normal_R = -(np.cos(tilt_rad) * x + np.sin(tilt_rad) * aside)
            sessions.append(placement_session(f"{name}-{tool}", tool, start, X_RT.p, x, normal_R))
    return sessions


def placement_session(
    name: str, tool: str, start_rad: Array, p_RoTo_R_m: Array, approach_R: Array, normal_R: Array
) -> DiagnosisSession:
    """Make a session that places a tool on a rock in front of it and presses."""
    touch = p_RoTo_R_m + STANDOFF_M * approach_R
    p_N = touch - p_R_from_N(np.zeros(3))
    world = World("mars", surface=Surface(vector3(p_N), vector3(normal_R)))
    end = vector3(touch + OVERTRAVEL_M * approach_R)
    touch_rock = GuardedMove(tool, end, vector3(approach_R), normal_R=vector3(normal_R))
    commands: tuple[Command, ...] = (touch_rock, Preload(tool, PRESS_N))
    return DiagnosisSession(name, name, world, WARM_C, joints5(start_rad), commands, tracked=True)


def _sweep(params: Params, joint: Joint) -> tuple[Command, ...]:
    here = within_limits(params, OUTSTRETCHED)[0][joint]
    out_rad, slow_rad, turn_rad = here - FAST_RAD, here - SLOW_RAD, here - TURN_RAD
    return (
        MoveJoint(joint, out_rad, "off"),
        MoveJoint(joint, here, "off"),
        set_speed(params, joint, SLOW_FRACTION),
        MoveJoint(joint, slow_rad, "off"),
        MoveJoint(joint, here, "off"),
        set_speed(params, joint, 1.0),
        MoveJoint(joint, turn_rad, "off"),
        MoveJoint(joint, here, "off"),
    )


def set_speed(params: Params, joint: Joint, fraction: float) -> SetParam:
    """Return the command that sets the speed of a joint to a fraction of its nominal one."""
    speed_rad_s = params.joints.in_order()[joint].speed_rad_s
    return SetParam(f"joints.{joint.name.lower()}.speed_rad_s", fraction * speed_rad_s)


def within_limits(params: Params, *poses: ArrayLike) -> list[Joints5]:
    """Return near poses in radians within the soft limits of an arm, each joint by whole turns if it can.

    A joint that no whole turn brings there is shifted by the least angle, the same in all poses.
    """
    joints = params.joints.in_order()
    least = np.array([joint.soft_min_rad for joint in joints])
    most = np.array([joint.soft_max_rad for joint in joints])
    rad = np.radians(np.array(poses))
    low, high = rad.min(axis=0), rad.max(axis=0)
    turn = 2.0 * np.pi * np.where(low < least, 1.0, np.where(high > most, -1.0, 0.0))
    fits = (low + turn >= least) & (high + turn <= most)
    by = np.where(fits, turn, np.maximum(least - low, 0.0) - np.maximum(high - most, 0.0))
    return [joints5(pose) for pose in rad + by]


def start_session(
    session: DiagnosisSession,
    arm: BuiltArm,
    reference: Reference,
    seed: int,
    effects: tuple[Effect, ...] = (),
) -> ClosedLoop:
    """Make the closed loop at the start of a session.

    The motors begin at whole encoder counts.
    """
    config = configure(arm.params)
    start = round_to_counts(np.array(session.start_rad), reference.zero_rad, config.rad_per_count)
    ambient = Ambient(session.temperature_C)
    setup = Setup(arm, session.world, joints5(start), seed, reference, (ambient, *effects))
    return ClosedLoop(setup)


def round_to_counts(motor_rad: Array, zero_rad: Array, rad_per_count: Array) -> Array:
    """Round motor angles, shape (5,), to the nearest whole encoder counts."""
    count = np.rint((motor_rad - zero_rad) / rad_per_count).astype(np.int64)
    rounded_rad: Array = count * rad_per_count + zero_rad
    return rounded_rad


def run_session(loop: ClosedLoop, session: DiagnosisSession) -> Iterator[SessionCycle]:
    """Run a session with a rest before and after each command; SessionFailed if one is not completed."""
    yield from _rest_cycles(loop, session.rest_s)
    for number, command in enumerate(session.commands, 1):
        run = SequenceRun(loop, (command,))
        for record in run:
            yield SessionCycle(record, rested=False)
        if run.outcome is not Outcome.DONE:
            warnings = [evr.message for _, evr in run.evrs if evr.severity >= Severity.WARNING_LO]
            why = warnings[0] if warnings else run.outcome.value
            where = f"session {session.name}: command {number} of {len(session.commands)}"
            raise SessionFailed(f"{where} was not completed: {why}")
        yield from _rest_cycles(loop, session.rest_s)


def _rest_cycles(loop: ClosedLoop, rest_s: float) -> Iterator[SessionCycle]:
    ticks = round(rest_s * CYCLE_HZ)
    for tick in range(ticks):
        yield SessionCycle(loop.cycle(), rested=tick == ticks - 1)
