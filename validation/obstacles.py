"""Campaign of obstacles of which flight software is not told.

Each move is a turn of one joint or a straight line of the drill, in either direction, on nominal and
calibrated arms, warm and cold, with all contact switches dead. A rock face stands across the way of a tool
that leads. Each must be reported as an unexpected contact. The true force is at most 50 N in straight moves;
`docs/faults.md` derives the bound of joint moves.
"""

from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.commands import Command, MoveJoints, MoveTool
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import Fault, UnexpectedContact
from fsw.dictionary.types import Joints5, Vector3, joints5, vector3
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Array
from sim.arms import arm_named
from sim.effects.environment import Ambient
from sim.effects.faults import SensorFault
from sim.frames import P_NR_M
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.sequence import run_sequence
from sim.setting import Surface, World
from validation.campaigns import Context, Document

STRAIGHT_N: Final = 50.0
"""Largest true force in a straight move."""
TEMPERATURES_C: Final = (-55.0, 10.0)
TURN_RAD: Final = 0.3
LINE_M: Final = 0.12
MARGIN_RAD: Final = 0.4
"""Distance of the start from the soft limits: more than the turn."""
AT_SHARE: Final = 0.7
"""Share of the way at which the obstacle stands."""
MOST_DRAWS: Final = 30
"""Draws until a move is possible and meets its obstacle."""
READY_SIGMA_RAD: Final = 0.25
"""Spread of the start around the ready pose."""
REST_S: Final = 1.0
"""Time after the command in which the force is still measured."""
KINDS: Final = tuple(kind for joint in Joint for kind in (joint.name, "line"))
"""Turn of each joint, and a straight move after it: the first four moves have two of them."""
TOOL: Final = "drill"
"""Tool of the straight moves."""


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Move with an obstacle in its way."""

    arm: str
    temperature_C: float
    kind: str
    """Joint that turns, or `line`."""
    start_rad: Joints5
    command: Command
    p_N_m: Vector3
    normal_N: Vector3


@dataclass(frozen=True, slots=True)
class Encounter:
    """Encounter of the arm with an obstacle."""

    arm: str
    temperature_C: float
    kind: str
    report: str
    """Faults."""
    reported: bool
    """True if the first fault is the unexpected contact, with torque."""
    true_N: float
    """Largest true force."""

    @property
    def in_bounds(self) -> bool:
        """True if the contact was reported, and in time if the move was straight."""
        return self.reported and (self.kind != "line" or self.true_N <= STRAIGHT_N)


def draw(seed: int, index: int, attempt: int) -> Obstacle:
    """Draw a move and its obstacle; arms, temperatures, kinds and directions take turns."""
    rng = np.random.default_rng([seed, index, attempt, 52])
    name = "nominal" if index % 4 == 0 else f"calibrated:{seed + index}"
    params = arm_named(name).params
    arm = configure(params).arm
    start = np.array(params.poses.ready_rad) + READY_SIGMA_RAD * rng.standard_normal(len(Joint))
    start = np.clip(start, arm.soft_min_rad + MARGIN_RAD, arm.soft_max_rad - MARGIN_RAD)
    sign, kind = (1.0 if index % 2 else -1.0), KINDS[(index // 2) % len(KINDS)]
    if kind == "line":
        command, p_R_m, normal = _line(arm, start, rng.standard_normal(3))
    else:
        turn = sign * TURN_RAD * (np.arange(len(Joint)) == Joint[kind])
        command = MoveJoints(joints5(start + turn))
        p_R_m, normal = _across_the_turn(arm, start, turn, attempt)
    temperature_C = TEMPERATURES_C[(index // (2 * len(KINDS))) % len(TEMPERATURES_C)]
    p_N_m = vector3(p_R_m + P_NR_M)
    return Obstacle(name, temperature_C, kind, joints5(start), command, p_N_m, vector3(normal))


def _line(arm: Arm, start: Array, way: Array) -> tuple[Command, Array, Array]:
    """Return a straight move, and point and normal of a face across the way of the tool that leads."""
    way = way / np.linalg.norm(way)
    frames = forward(arm, start)
    X_RT = tool_pose(arm, frames, TOOL)
    tools = np.stack([tool_pose(arm, frames, tool).p for tool in arm.X_FT])
    leading = tools[int(np.argmax(tools @ way))]
    command = MoveTool(TOOL, vector3(X_RT.p + LINE_M * way), vector3(X_RT.R[:, 0]), straight=True)
    return command, leading + AT_SHARE * LINE_M * way, -way


def _across_the_turn(arm: Arm, start: Array, turn: Array, attempt: int) -> tuple[Array, Array]:
    """Return point and normal of a face across the way of a tool, at the first attempt of the fastest."""
    frames = forward(arm, start + AT_SHARE * turn)
    points = [tool_pose(arm, frames, tool).p for tool in arm.X_FT]
    ways = [joint_jacobian(frames, p)[3:] @ turn for p in points]
    lengths = [float(np.linalg.norm(way)) for way in ways]
    tool = int(np.argsort(lengths)[-1 - attempt % len(lengths)])
    return points[tool], -ways[tool] / lengths[tool]


def meet(seed: int, index: int) -> Encounter:
    """Fly the first drawn move that is possible and meets its obstacle; RuntimeError if there is none."""
    for attempt in range(MOST_DRAWS):
        met = _fly(draw(seed, index, attempt), index)
        if met is not None:
            return met
    raise RuntimeError(f"obstacle {index}: no move meets it in {MOST_DRAWS} draws")


def _fly(one: Obstacle, seed: int) -> Encounter | None:
    """Fly a move; return None if it is refused, begins in contact, or passes its obstacle."""
    arm = arm_named(one.arm)
    dead = [SensorFault(0.0, "switch_closed", "biased", k, -1.0) for k in range(len(arm.params.switches))]
    world = World(surface=Surface(one.p_N_m, one.normal_N))
    effects = (Ambient(one.temperature_C), *dead)
    loop = ClosedLoop(Setup(arm, world, one.start_rad, seed, true_reference(arm), effects))
    if loop.plant.data.ncon:
        return None
    evrs: list[Evr] = []
    force_N: list[float] = []
    reported = 0
    for record in run_sequence(loop, (one.command,)):
        evrs += record.outputs.evrs
        force_N.append(loop.truth().contact_force_N)
        if any(isinstance(evr, Fault) for evr in record.outputs.evrs):
            reported = reported or len(force_N) - 1
    for _ in range(round(REST_S * CYCLE_HZ)):
        loop.cycle()
        force_N.append(loop.truth().contact_force_N)
    faults = [evr for evr in evrs if isinstance(evr, Fault)]
    if not any(force_N) and not faults:
        return None
    touched = next((k for k, force in enumerate(force_N) if force > 0.0), len(force_N))
    return Encounter(
        one.arm,
        one.temperature_C,
        one.kind,
        report="; ".join(evr.message for evr in faults),
        reported=bool(faults) and isinstance(faults[0], UnexpectedContact) and touched <= reported,
        true_N=max(force_N),
    )


def campaign(context: Context, count: int = 40) -> Document:
    """Fly this many obstacles; in bounds if each is reported, in straight moves below 50 N."""
    met = context.each(meet, ((context.seed, k) for k in range(count)), "obstacles")
    return {
        "obstacles": count,
        "reported": sum(one.reported for one in met),
        "max_straight_N": max((one.true_N for one in met if one.kind == "line"), default=0.0),
        "max_joint_N": max((one.true_N for one in met if one.kind != "line"), default=0.0),
        "met": [asdict(one) for one in met],
        "in_bounds": all(one.in_bounds for one in met),
    }
