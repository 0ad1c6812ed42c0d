"""The campaign of motions for diagnosis, and how a session of it is carried out in the closed loop."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.enums import Tool
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5
from fsw.estimate.reference import Reference
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle, settle_output
from fsw.kinematics.transforms import Array
from sim.arms import BuiltArm
from sim.diagnosis.motions import Session, placement, pose_tours, sweeps, together
from sim.effects.effect import Effect
from sim.effects.environment import Ambient
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.sequence import Outcome, run_sequence
from sim.world import World

STOOD_S: Final = 8.0
"""On the brakes before a session: longer changes no reading by as much as its noise."""
REST_S: Final = 1.0
"""At rest before a motion and after it."""
PLACES: Final = (
    ("place-drill", Tool.DRILL, (0.0, -50.0, 100.0, 130.0, 90.0)),
    ("place-apxs", Tool.APXS, (0.0, -50.0, 100.0, 130.0, 90.0)),
)
"""Names, tools, and the poses [deg] from which a rock is touched."""
HELD_OUT: Final = (
    "poses-level-5",
    "poses-level-8",
    "poses-rolled-3",
    "poses-rolled-7",
    "elsewhere-cold",
    "elsewhere-warm",
)
"""Sessions on which a diagnosis is tried that was made of the others."""


class SessionFailed(RuntimeError):
    """A motion of a session did not come to its end."""


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One cycle of a session; `rested` says that the arm has stood still for long enough to be measured."""

    record: CycleRecord
    rested: bool


def sessions(params: Params) -> tuple[Session, ...]:
    """The whole campaign, in order, for an arm with these flight parameters."""
    return (*pose_tours(), *sweeps(params), *together(), *placements(params))


def placements(params: Params) -> list[Session]:
    """Each on a rock in front of the tool where it is believed to hang."""
    config, found = configure(params), []
    for name, tool, pose_deg in PLACES:
        start = np.radians(pose_deg)
        gravity = World("mars").gravity_N_m_s2
        side = np.sign(settle_output(config.arm, start, gravity).torque_Nm)
        hanging = settle(config.arm, start, side * config.half_gap_rad, gravity)
        X_RT = tool_pose(config.arm, hanging.frames, tool)
        found.append(placement(name, tool, start, X_RT.p, X_RT.R[:, 0]))
    return found


def loop_of(
    session: Session, arm: BuiltArm, reference: Reference, seed: int, effects: tuple[Effect, ...] = ()
) -> ClosedLoop:
    """The closed loop about to carry out a session; motors begin at a whole count, as encoders read them."""
    config = configure(arm.params)
    start = on_counts(np.array(session.start_rad), reference.zero_rad, config.rad_per_count)
    ambient = Ambient(session.temperature_C)
    setup = Setup(arm, session.world, joints5(start), seed, reference, (ambient, *effects), settle_s=STOOD_S)
    return ClosedLoop(setup)


def on_counts(motor_rad: Array, zero_rad: Array, rad_per_count: Array) -> Array:
    """The nearest angles (5,) at which encoders read whole counts."""
    count = np.rint((motor_rad - zero_rad) / rad_per_count).astype(np.int64)
    whole: Array = count * rad_per_count + zero_rad
    return whole


def moments(loop: ClosedLoop, session: Session) -> Iterator[Moment]:
    """Every cycle of a session: a rest, and after each command another.

    Raises:
        SessionFailed: a command was refused or ended in a fault.
    """
    yield from _rest(loop)
    for command in session.commands:
        cycles = run_sequence(loop, (command,))
        while True:
            try:
                yield Moment(next(cycles), rested=False)
            except StopIteration as end:
                if end.value is not Outcome.DONE:
                    raise SessionFailed(f"session {session.name}: {command} was {end.value}") from None
                break
        yield from _rest(loop)


def _rest(loop: ClosedLoop) -> Iterator[Moment]:
    ticks = round(REST_S * CYCLE_HZ)
    for tick in range(ticks):
        yield Moment(loop.cycle(), rested=tick == ticks - 1)
