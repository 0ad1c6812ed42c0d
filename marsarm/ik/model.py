"""Arm model of an inverse-kinematics request: arm, tool, and gravity to compensate."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from fsw.collision.geometry import RoundedBoxes, build_collision_geometry
from fsw.config import digest
from fsw.kinematics.arm import Arm, build_arm, heat_arm
from fsw.kinematics.ik import IkResult, inverse_kinematics
from fsw.kinematics.transforms import Array
from marsarm.common.pool import Runner, in_order
from marsarm.common.requests import make_world, parse_tool, select_arm
from marsarm.ik.request import ModelRequest
from marsarm.ik.targets import IkTargets
from sim.frames import Workspace
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress

MOST_WARMING_K: Final = 200.0
"""Largest temperature difference from calibration; the coldest night on Mars is nearer."""
BATCH_SIZE: Final = 8192
"""Number of targets in a part of a batch; solving a part takes about a second."""


@dataclass(frozen=True, slots=True, eq=False)
class IkModel:
    """Arm as flight software knows it, with the gravity to compensate; None without compensation."""

    request: ModelRequest
    arm: Arm
    tool: str
    gravity_R_m_s2: Array | None
    params_sha256: str
    workspace: Workspace
    """Workspace of the drawing."""
    rover: RoundedBoxes
    """Hull of the rover in RMECH."""

    @property
    def description(self) -> str:
        """Describe the arm and its load."""
        request = self.request
        text = f"{self.tool}, {request.arm} arm"
        if request.warming_K:
            text += f" {request.warming_K:+g} K"
        if self.gravity_R_m_s2 is None:
            return text + ", rigid"
        tilted = f", roll {request.tilt_roll_deg:g} pitch {request.tilt_pitch_deg:g} deg"
        level = request.tilt_roll_deg == request.tilt_pitch_deg == 0.0
        return text + f", deflected by the gravity of {request.gravity.title()}" + ("" if level else tilted)

    def solve_in_batches(self, targets: IkTargets, run: Runner, progress: Progress) -> Iterator[IkResult]:
        """Solve the inverse kinematics in parts, (8, n) each."""
        starts = range(0, len(targets), BATCH_SIZE)
        parts = ((self, targets.part(start, BATCH_SIZE)) for start in starts)
        progress(0, len(targets), "solving")
        for start, result in zip(starts, in_order(run, IkModel.solve, parts), strict=True):
            progress(start, len(targets), "solving")
            yield result

    def solve(self, targets: IkTargets) -> IkResult:
        """Solve the inverse kinematics of all targets for every branch, shape (8, n)."""
        return inverse_kinematics(
            self.arm, self.tool, targets.p_RoTo_R_m, targets.approach_R, self.gravity_R_m_s2
        )


def build_ik_model(request: ModelRequest) -> IkModel:
    """Build the arm model of a request.

    Raises:
        BadRequest: A field of the request is wrong.
    """
    world = make_world(request.gravity, request.tilt_roll_deg, request.tilt_pitch_deg, "gravity")
    if not math.isfinite(request.warming_K) or abs(request.warming_K) > MOST_WARMING_K:
        raise BadRequest(
            f"warming: {request.warming_K:g} K is not within {MOST_WARMING_K:g} K of calibration temperature"
        )
    arm = select_arm(request.arm, request.params, request.mismatch)
    params = arm.params
    tool = parse_tool(request.tool or arm.model.description.instrument, params.tool_names)
    gravity = world.gravity_N_m_s2 if request.compensate == "absolute" else None
    cold = build_arm(params)
    rover = build_collision_geometry(params, cold).rover
    warm = heat_arm(cold, request.warming_K)
    return IkModel(request, warm, tool, gravity, digest(params), arm.model.workspace, rover)
