"""The arm whose inverse kinematics is asked for: which one, with which tool, and how it hangs."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fsw.config import digest
from fsw.dictionary.enums import Tool
from fsw.kinematics.arm import Arm, build_arm, heat_arm
from fsw.kinematics.ik import IkResult, inverse_kinematics
from fsw.kinematics.transforms import Array
from ground.common.progress import Progress
from ground.common.requests import BadRequest, make_world, select_arm
from ground.ik.targets import IkTargets

COMPENSATIONS: Final = ("absolute", "off")
MOST_WARMING_K: Final = 200.0
"""Either way, more than from the warmest day of calibration to the coldest night on Mars."""


BATCH_SIZE: Final = 8192
"""Targets at a time: about a second."""


@dataclass(frozen=True, slots=True)
class ModelRequest:
    """What is asked; degrees and kelvin."""

    tool: str = "apxs"
    compensate: str = "absolute"
    tilt_roll_deg: float = 0.0
    tilt_pitch_deg: float = 0.0
    gravity: str = "mars"
    warming_K: float = 0.0
    arm: str = "nominal"
    params: Path | None = None


@dataclass(frozen=True, slots=True, eq=False)
class IkModel:
    """What flight software believes about the arm, and the gravity to compensate, if any."""

    request: ModelRequest
    arm: Arm
    tool: Tool
    gravity_R_m_s2: Array | None
    params_sha256: str

    @property
    def description(self) -> str:
        """The arm and its load in words."""
        asked = self.request
        words = f"{asked.tool.upper()}, {asked.arm} arm"
        if asked.warming_K:
            words += f" {asked.warming_K:+g} K"
        if self.gravity_R_m_s2 is None:
            return words + ", rigid"
        tilted = f", roll {asked.tilt_roll_deg:g} pitch {asked.tilt_pitch_deg:g} deg"
        level = asked.tilt_roll_deg == asked.tilt_pitch_deg == 0.0
        return words + f", hanging in the gravity of {asked.gravity.title()}" + ("" if level else tilted)

    def solve_in_batches(self, targets: IkTargets, progress: Progress) -> Iterator[IkResult]:
        """The answers to many targets, some at a time, (S, n) each; S may differ."""
        for start in range(0, len(targets), BATCH_SIZE):
            progress(start, len(targets), "solving")
            yield self.answers(targets.part(start, BATCH_SIZE))

    def answers(self, targets: IkTargets) -> IkResult:
        """Every branch of every target, (S, n)."""
        return inverse_kinematics(
            self.arm, self.tool, targets.p_RoTo_R_m, targets.approach_R, self.gravity_R_m_s2
        )


def build_ik_model(request: ModelRequest) -> IkModel:
    """The arm that is meant.

    Raises:
        BadRequest: a field of the request is wrong.
    """
    tool = _parse_tool(request.tool)
    if request.compensate not in COMPENSATIONS:
        raise BadRequest(
            f"compensate: {request.compensate!r} is not known; there are {', '.join(COMPENSATIONS)}"
        )
    world = make_world(request.gravity, request.tilt_roll_deg, request.tilt_pitch_deg, "gravity")
    if not math.isfinite(request.warming_K) or abs(request.warming_K) > MOST_WARMING_K:
        raise BadRequest(
            f"warming: {request.warming_K:g} K is not within {MOST_WARMING_K:g} K of calibration temperature"
        )
    params = select_arm(request.arm, request.params).params
    gravity = world.gravity_N_m_s2 if request.compensate == "absolute" else None
    return IkModel(request, heat_arm(build_arm(params), request.warming_K), tool, gravity, digest(params))


def _parse_tool(name: str) -> Tool:
    known = {tool.name.lower(): tool for tool in Tool}
    if name.lower() not in known:
        raise BadRequest(f"tool: {name!r} is not known; there are {', '.join(known)}")
    return known[name.lower()]
