"""Teaching of places: the true tool is moved to a place, and the estimated pose is stored."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import AUTO, MoveTool
from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.params import TeachPoint
from fsw.dictionary.types import joints5, vector3
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.transforms import Array
from fsw.messages import ToolChannels
from sim.arms import BuiltArm
from sim.effects.environment import NothingToTouch
from sim.frames import p_R_from_N
from sim.loop import ClosedLoop, Setup
from sim.scenario.data import TaughtPoint
from sim.sequence import run_sequence
from sim.world import World

TEACH_PASSES: Final = 3
"""Number of moves to the front of a place, each corrected by the true error of the last."""
SURVEY_DISTANCE_M: Final = 0.05
"""Distance in front of a place at which it is measured, clear of objects."""
TEACH_OFFSET_RAD: Final = 0.01
"""Distance of every joint from the place at the start."""
REST_S: Final = 1.0


class NotTaught(RuntimeError):
    """Place that the arm could not be taught."""


def teach(
    arm: BuiltArm, reference: Reference, points: tuple[TaughtPoint, ...], world: World, seed: int = 0
) -> BuiltArm:
    """Return the arm with these places among its parameters.

    Raises:
        NotTaught: flight software refused or did not complete a move.
    """
    found = tuple(_teach_point(arm, reference, point, world, seed) for point in points)
    names = {point.name for point in found}
    kept = tuple(point for point in arm.params.teach if point.name not in names)
    return replace(arm, params=replace(arm.params, teach=(*kept, *found)))


def _teach_point(
    arm: BuiltArm, reference: Reference, point: TaughtPoint, world: World, seed: int
) -> TeachPoint:
    axis = np.array(point.approach_N) / np.linalg.norm(point.approach_N)
    wanted = p_R_from_N(np.array(point.p_N_m)) - SURVEY_DISTANCE_M * axis
    start = _pose_near(arm, point, wanted, axis, world)
    level = replace(world, surface=None)
    tool = arm.params.tool_names.index(point.tool)
    loop = ClosedLoop(Setup(arm, level, joints5(start), seed, reference, (NothingToTouch(),)))
    aim, towards = wanted, axis
    for _ in range(TEACH_PASSES):
        believed = _move_tool_to(loop, point, aim, towards)
        truth = loop.plant.truth()
        error_m = wanted - truth.p_RoTo_R_m[tool]
        axis_error = axis - truth.R_RT[tool][:, 0]
        aim, towards = aim + error_m, towards + axis_error
    approach = believed.R_RT[:, 0] + axis_error
    return TeachPoint(
        name=point.name,
        tool=point.tool,
        p_RoTo_R_m=vector3(believed.p_RoTo_R_m + error_m + SURVEY_DISTANCE_M * approach),
        approach_R=vector3(approach),
        branch=point.branch,
    )


def _pose_near(arm: BuiltArm, point: TaughtPoint, p_R_m: Array, axis: Array, world: World) -> Array:
    """Return a pose beside the place, on its branch; of several the nearest to the ready pose."""
    ready = np.array(arm.params.poses.ready_rad)
    solutions = inverse_kinematics(
        build_arm(arm.params), point.tool, p_R_m, axis, world.gravity_N_m_s2, ready
    )
    poses = [
        solutions.output_rad[:, slot]
        for slot in np.flatnonzero(solutions.verdict == BranchVerdict.VALID)
        if point.branch in (AUTO, BRANCHES[slot % len(BRANCHES)])
    ]
    if not poses:
        raise NotTaught(f"{arm.name}: {point.name} is out of reach of the {point.tool}")
    nearest = min(poses, key=lambda pose: float(np.abs(pose - ready).max()))
    return np.asarray(nearest + TEACH_OFFSET_RAD * np.sign(ready - nearest))


def _move_tool_to(loop: ClosedLoop, point: TaughtPoint, p_R_m: Array, axis: Array) -> ToolChannels:
    """Move the tool and return its estimated pose at rest."""
    command = MoveTool(point.tool, vector3(p_R_m), vector3(axis), branch=point.branch)
    evrs = [evr for record in run_sequence(loop, (command,)) for evr in record.outputs.evrs]
    if loop.failure is not None:
        raise loop.failure
    if CommandCompleted("MoveTool") not in evrs:
        raise NotTaught(f"{point.name}: {evrs[-1].message}")
    return [tool for tool in _observe_rest(loop) if tool is not None][-1]


def _observe_rest(loop: ClosedLoop) -> Iterator[ToolChannels | None]:
    for _ in range(round(REST_S * CYCLE_HZ)):
        yield loop.cycle().outputs.tool
