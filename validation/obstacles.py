"""Campaign of obstacles in the way of free moves, of which flight software is not told.

Each move is a turn of one joint or a straight line of a tool, in either direction, on nominal and calibrated arms, warm
and cold. A rock face stands across the way of the part of the turret that leads. Each must be reported as an
unexpected contact. The true force is at most 50 N in straight moves. In joint moves it is at most the force at
which the contact is certain, plus what the speed of the tool adds until the motor stands.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

import mujoco
import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.commands import Command, MoveJoints, MoveTool
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import ContactInFreeSpace, Fault, UnexpectedContact
from fsw.dictionary.types import joints5, vector3
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Array
from ground.common.pool import Runner, in_order
from sim.arms import arm_named
from sim.effects.environment import Ambient
from sim.effects.faults import SensorFault
from sim.frames import FLIP, P_NR_M
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.sequence import run_sequence
from sim.world import Surface, World
from validation.options import campaign_parser, campaign_runner

EXAMPLE: Final = "example: python -m validation.obstacles --count 10"
COUNT: Final = 40
STRAIGHT_N: Final = 50.0
"""Largest true force in a straight move."""
TEMPERATURES_C: Final = (-55.0, 10.0)
TURN_RAD: Final = 0.3
LINE_M: Final = 0.12
AT_SHARE: Final = 0.7
"""Share of the way at which the obstacle stands."""
MOST_DRAWS: Final = 40
READY_SIGMA_RAD: Final = 0.25
"""Spread of the start around the ready pose."""
REST_S: Final = 1.0
"""Time after the command in which the force is still measured."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Move with an obstacle in its way."""

    arm: str
    temperature_C: float
    kind: str
    """Joint that turns, or `line`."""
    start_rad: tuple[float, ...]
    command: Command
    p_N_m: tuple[float, float, float]
    normal_N: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Met:
    """What an obstacle caused."""

    arm: str
    temperature_C: float
    kind: str
    report: str
    """First fault; empty if there was none."""
    reported: bool
    """The first fault is a contact."""
    joint: str
    torque_Nm: float
    estimated_N: float
    true_N: float
    """Largest true force."""
    at_report_N: float
    """True force when it was reported."""
    delay_s: float
    """Time from the touch to the report."""


def draw(seed: int, index: int) -> Obstacle:
    """Draw a move and its obstacle; arms, temperatures, joints and directions take turns."""
    rng = np.random.default_rng([seed, index, 52])
    arm_name = "nominal" if index % 4 == 0 else f"calibrated:{seed + index}"
    arm = arm_named(arm_name)
    config = configure(arm.params)
    start = np.array(arm.params.poses.ready_rad) + READY_SIGMA_RAD * rng.standard_normal(5)
    start = np.clip(start, config.arm.soft_min_rad + 0.4, config.arm.soft_max_rad - 0.4)
    sign = 1.0 if index % 2 else -1.0
    frames = forward(config.arm, start)
    kind = [*(joint.name for joint in Joint), *["line"] * 5][(index // 2) % 10]
    temperature = TEMPERATURES_C[(index // 20) % 2]
    if kind == "line":
        tool = "DRILL"
        X = tool_pose(config.arm, frames, tool)
        way = rng.standard_normal(3)
        way *= sign / np.linalg.norm(way)
        command: Command = MoveTool(tool, vector3(X.p + LINE_M * way), vector3(X.R[:, 0]), straight=True)
        corners, R = _corners(config.arm, frames), np.eye(3)
        lead = corners[:, int(np.argmax(way @ corners))]
        p, normal = lead + AT_SHARE * LINE_M * way, -way
    else:
        turn = sign * TURN_RAD * (np.arange(5) == Joint[kind])
        command = MoveJoints(joints5(start + turn))
        p, normal = _in_the_way(config.arm, start, turn)
    return Obstacle(
        arm_name, temperature, kind, tuple(start.tolist()), command,
        vector3(p + P_NR_M), vector3(normal),
    )


def _corners(arm: object, frames: object) -> Array:
    """Return the origins of all tools, shape (3, n)."""
    return np.stack([tool_pose(arm, frames, tool).p for tool in arm.X_FT], axis=1)


def _in_the_way(arm: object, start: Array, turn: Array) -> tuple[Array, Array]:
    """Return a point and the normal of a face across the way of the fastest tool."""
    frames = forward(arm, start + AT_SHARE * turn)
    points = [tool_pose(arm, frames, tool).p for tool in arm.X_FT]
    speeds = [joint_jacobian(frames, p)[3:] @ turn for p in points]
    k = int(np.argmax([np.linalg.norm(v) for v in speeds]))
    return points[k], -speeds[k] / np.linalg.norm(speeds[k])


def fly(seed: int, index: int) -> Met | None:
    """Fly a move into its obstacle; None if the arm touches it before, or cannot make the move."""
    one = draw(seed, index)
    arm = arm_named(one.arm)
    world = World(surface=Surface(one.p_N_m, one.normal_N))
    dead = tuple(
        SensorFault(0.0, "switch_closed", "biased", k, -1.0) for k in range(len(arm.params.switches))
    )
    setup = Setup(
        arm, world, joints5(one.start_rad), index, true_reference(arm), (Ambient(one.temperature_C), *dead)
    )
    loop = ClosedLoop(setup, with_truth=True)
    if loop.plant.data.ncon:
        return None
    evrs: list[Evr] = []
    force_N, reported_tick = [], -1
    for record in run_sequence(loop, (one.command,)):
        evrs += record.outputs.evrs
        force_N.append(record.truth.contact_force_N)
        if reported_tick < 0 and any(isinstance(e, Fault) for e in record.outputs.evrs):
            reported_tick = len(force_N) - 1
    for _ in range(round(REST_S * CYCLE_HZ)):
        force_N.append(loop.cycle().truth.contact_force_N)
    force = np.array(force_N)
    faults = [evr for evr in evrs if isinstance(evr, Fault)]
    if not force.any():
        print(index, one.kind, [e.message for e in evrs if e.severity.name.startswith('WARN')])
        return None
    found = next((e for e in faults if isinstance(e, UnexpectedContact)), None)
    return Met(
        one.arm, one.temperature_C, one.kind,
        report="; ".join(e.message for e in faults),
        reported=bool(faults) and isinstance(faults[0], UnexpectedContact | ContactInFreeSpace),
        joint="" if found is None else found.joint.name,
        torque_Nm=0.0 if found is None else found.torque_Nm,
        estimated_N=0.0 if found is None else found.force_N,
        true_N=float(force.max()),
        at_report_N=float(force[reported_tick]),
        delay_s=(reported_tick - int(np.argmax(force > 0))) / CYCLE_HZ,
    )


def main() -> int:
    a, b = int(sys.argv[1]), int(sys.argv[2])
    for k in range(a, b):
        print(k, fly(0, k), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
