"""Motions made for diagnosis: short, each to show a few effects apart from the others.

A session begins at rest on the brakes at a pose that people drove to. Poses are in degrees, as people
read them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.commands import Command, GuardedMove, MoveJoint, MoveJoints, Preload, SetParam
from fsw.dictionary.enums import Joint, Tool
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5, vector3
from fsw.kinematics.transforms import Array
from sim.effects.environment import WARM_C
from sim.frames import p_R_from_N
from sim.world import Surface, World

Degrees5 = tuple[int, int, int, int, int]

ROLL_RAD: Final = float(np.radians(20.0))
COLD_C: Final = -50.0
FAST_RAD, SLOW_RAD, TURN_RAD = (float(np.radians(deg)) for deg in (5.0, 0.75, 0.75))
SLOW: Final = 0.2
"""Of the speed that a joint has."""
OUTSTRETCHED: Final[Degrees5] = (0, -40, 60, 60, 60)
ELSEWHERE: Final[Degrees5] = (-20, -60, 80, 90, 120)
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
"""One for each branch of the inverse kinematics, in their order, and one a little way on."""
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
"""Others on the same branches, with the rover rolled."""
PRESS_N: Final = 60.0
BEFORE_M: Final = 0.02
"""How far in front of a rock a placement begins."""
PAST_M: Final = 0.03


@dataclass(frozen=True, slots=True)
class Session:
    """One log: where it begins, what is asked, and under which conditions."""

    name: str
    block: str
    """Repeats of one motion are one block."""
    world: World
    temperature_C: float
    start_rad: tuple[float, ...]
    """Outputs, (5,)."""
    commands: tuple[Command, ...]
    tracked: bool
    """Whether a laser tracker looks at the turret wherever the arm rests."""


def pose_tours() -> list[Session]:
    """Two poses on every branch, level and rolled; the first pair of each a second time."""
    found = []
    for named, pairs, roll_rad in (("level", POSES, 0.0), ("rolled", TILTED_POSES, ROLL_RAD)):
        for number, (here, there) in enumerate(pairs, 1):
            for again in ("", "-again") if number == 1 else ("",):
                block = f"poses-{named}-{number}"
                found.append(
                    Session(
                        block + again,
                        block,
                        World("mars", roll_rad),
                        WARM_C,
                        _rad(here),
                        (MoveJoints(joints5(np.radians(there)), "off"),),
                        tracked=True,
                    )
                )
    return found


def sweeps(params: Params) -> list[Session]:
    """Each joint alone from outstretched: there and back fast, slowly, and to and fro; elevation twice."""
    found = []
    for joint in Joint:
        for again in ("", "-again") if joint is Joint.ELEVATION else ("",):
            name = joint.name.lower()
            roll_rad = ROLL_RAD if joint in (Joint.AZIMUTH, Joint.TURRET) else 0.0
            found.append(
                Session(
                    f"sweep-{name}{again}",
                    f"sweep-{name}",
                    World("mars", roll_rad),
                    WARM_C,
                    _rad(OUTSTRETCHED),
                    _sweep(params, joint),
                    tracked=False,
                )
            )
    return found


def together() -> list[Session]:
    """All joints at once, there and back: in the cold, twice; warm, to compare; and both from elsewhere."""
    return [
        Session(name, block, World("mars"), temperature_C, _rad(pose), _there_and_back(pose), False)
        for name, block, temperature_C, pose in (
            ("cold", "cold", COLD_C, OUTSTRETCHED),
            ("cold-again", "cold", COLD_C, OUTSTRETCHED),
            ("warm", "warm", WARM_C, OUTSTRETCHED),
            ("elsewhere-cold", "elsewhere-cold", COLD_C, ELSEWHERE),
            ("elsewhere-warm", "elsewhere-warm", WARM_C, ELSEWHERE),
        )
    ]


def placement(name: str, tool: Tool, start_rad: Array, p_RoTo_R_m: Array, approach_R: Array) -> Session:
    """Onto a rock in front of a tool that is at rest there: touch and press."""
    touch = p_RoTo_R_m + BEFORE_M * approach_R
    p_N = touch - p_R_from_N(np.zeros(3))
    world = World("mars", surface=Surface(vector3(p_N), vector3(-approach_R)))
    end = vector3(touch + PAST_M * approach_R)
    commands: tuple[Command, ...] = (
        GuardedMove(tool, end, vector3(approach_R)),
        Preload(tool, PRESS_N),
    )
    return Session(name, name, world, WARM_C, joints5(start_rad), commands, False)


def _there_and_back(pose: Degrees5) -> tuple[Command, ...]:
    start = np.array(_rad(pose))
    there = start + np.radians([5.0, -5.0, 5.0, -10.0, 10.0])
    return MoveJoints(joints5(there), "off"), MoveJoints(joints5(start), "off")


def _sweep(params: Params, joint: Joint) -> tuple[Command, ...]:
    here = _rad(OUTSTRETCHED)[joint]
    out_rad, slow_rad, turn_rad = here - FAST_RAD, here - SLOW_RAD, here - TURN_RAD
    return (
        MoveJoint(joint, out_rad, "off"),
        MoveJoint(joint, here, "off"),
        _at_speed(params, joint, SLOW),
        MoveJoint(joint, slow_rad, "off"),
        MoveJoint(joint, here, "off"),
        _at_speed(params, joint, 1.0),
        MoveJoint(joint, turn_rad, "off"),
        MoveJoint(joint, here, "off"),
    )


def _at_speed(params: Params, joint: Joint, share: float) -> SetParam:
    speed_rad_s = params.joints.in_order()[joint].speed_rad_s
    return SetParam(f"joints.{joint.name.lower()}.speed_rad_s", share * speed_rad_s)


def _rad(pose: Degrees5) -> tuple[float, ...]:
    return joints5(np.radians(pose))
