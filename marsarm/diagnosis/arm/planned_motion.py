"""Motion that is planned for a diagnosis: its file, and its session. The family of these motions."""

from collections.abc import Collection, Iterator
from itertools import product
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from fsw.dictionary.commands import Command, MoveJoint, MoveJoints
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5
from sim.diagnosis_campaign import (
    COORDINATED_TURN,
    HELD_OUT_POSE,
    OUTSTRETCHED,
    ROLL_RAD,
    SESSION_COLD_C,
    SLOW_FRACTION,
    TILTED_POSES,
    TOUCHING_DEG,
    DiagnosisSession,
    set_speed,
    within_limits,
)
from sim.setting import WARM_C, World
from simgap.common.toml import Record, parse_record, read_toml, toml_text

ALL: Final = "all"
"""Name in place of a joint: all joints turn at once."""
TURNS_DEG: Final = (1.0, 5.0, 15.0)
POSES_DEG: Final = (OUTSTRETCHED, HELD_OUT_POSE, TOUCHING_DEG)
TRACKED_DEG: Final = tuple(start for start, _ in TILTED_POSES)
COUNT: Final = 2
"""Times that a joint goes there and back: the second time shows what the first has left behind."""

Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]


class PlannedMotion(Record):
    """One motion: a joint, or all, goes there and back from a pose."""

    format: Literal["arm motion 1"] = "arm motion 1"
    """Name and version of the file."""
    name: Annotated[str, Field(pattern=r"^[\w-]+$")]
    """Name of the session and of its log."""
    start_deg: Annotated[list[Degrees], Field(min_length=5, max_length=5)]
    """Output angles at the start; an angle beyond its limit is brought within."""
    joint: Literal["all", "azimuth", "elevation", "elbow", "wrist", "turret"]
    """Joint that turns."""
    turn_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    """Turn of the joint; of all joints, that of the elbow's share of a coordinated turn."""
    speed_share: Annotated[float, Field(ge=0.02, le=1.0)]
    """Speed in the nominal one."""
    count: Annotated[int, Field(ge=1, le=20)]
    """Times that it goes there and back."""
    roll_deg: Annotated[float, Field(ge=-30.0, le=30.0)]
    """Roll of the rover."""
    temperature_C: Annotated[float, Field(ge=-130.0, le=50.0)]
    """Temperature of the arm."""
    tracked: bool
    """True if a tracker measures the turret at rest; then the motion is not compared."""

    def describe(self) -> str:
        """Return the motion in words."""
        pose = ", ".join(f"{one:g}" for one in self.start_deg)
        turning = "all joints" if self.joint == ALL else self.joint
        seen = ", with a tracker" if self.tracked else ""
        return (
            f"{turning} by {self.turn_deg:g} deg and back {self.count} times at {self.speed_share:g} of the "
            f"nominal speed, from ({pose}) deg, roll {self.roll_deg:g} deg, {self.temperature_C:g} degC{seen}"
        )


def list_motions(places: Collection[str] = ()) -> Iterator[PlannedMotion]:
    """Yield the motions of the family, of joints that turn alone; of all if no place is a joint."""
    roll_deg, names = float(np.degrees(ROLL_RAD)), [one.name.lower() for one in Joint]
    moving = [one for one in names if one in places] or names
    plans = [
        *product(moving, TURNS_DEG, (1.0, SLOW_FRACTION), POSES_DEG, (0.0,), (WARM_C,), (False,)),
        *product((ALL,), TURNS_DEG, (1.0,), POSES_DEG, (roll_deg,), (SESSION_COLD_C,), (False,)),
        *product((ALL,), TURNS_DEG[-1:], (1.0,), TRACKED_DEG, (0.0, -roll_deg), (WARM_C,), (True,)),
    ]
    for number, (joint, turn_deg, speed, pose, roll, temperature_C, tracked) in enumerate(plans, 1):
        yield PlannedMotion(
            name=f"next-{number}",
            start_deg=[float(one) for one in pose],
            joint=joint,
            turn_deg=-turn_deg,
            speed_share=speed,
            count=COUNT,
            roll_deg=roll,
            temperature_C=temperature_C,
            tracked=tracked,
        )


def make_session(motion: PlannedMotion, params: Params) -> DiagnosisSession:
    """Return the session of a motion, for an arm with these flight parameters; it stays within the limits."""
    joints, share = [*Joint], np.array(COORDINATED_TURN) / COORDINATED_TURN[Joint.ELBOW]
    if motion.joint != ALL:
        joints = [Joint[motion.joint.upper()]]
        share = np.eye(5)[joints[0]]
    here, there = within_limits(params, motion.start_deg, motion.start_deg + share * motion.turn_deg)
    ways: list[Command] = [
        MoveJoints(joints5(pose), "off")
        if motion.joint == ALL
        else MoveJoint(joints[0], pose[joints[0]], "off")
        for pose in (there, here)
    ]
    speeds = [set_speed(params, one, motion.speed_share) for one in joints if motion.speed_share != 1.0]
    return DiagnosisSession(
        motion.name,
        motion.name,
        World("mars", float(np.radians(motion.roll_deg))),
        motion.temperature_C,
        here,
        (*speeds, *(ways * motion.count)),
        motion.tracked,
    )


def motion_text(motion: PlannedMotion) -> str:
    """Return the text of the file of a motion."""
    return toml_text(motion.model_dump(), [motion.describe(), "`marsarm gap record --motion` records it."])


def read_motion(path: Path) -> PlannedMotion:
    """Read the file of a motion; RobotError if it is wrong."""
    return parse_record(PlannedMotion, read_toml(path), path)
