"""Placement of an instrument: unstow, standoff, touch and retract, and the errors of its result."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import AUTO, Command, PlaceTool, Retract, Unstow
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import BranchChosen, CommandCompleted, ContactMade, Evr
from fsw.dictionary.types import Vector3, vector3
from fsw.kinematics.transforms import angle_between, normalize
from sim.frames import p_R_from_N
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.sequence import Outcome, observe_cycles, run_sequence, stop_sequence


@dataclass(frozen=True, slots=True)
class Placement:
    """Placement in RNAV; the normal points out of the surface."""

    tool: str
    target_N_m: Vector3
    normal_N: Vector3
    standoff_m: float = 0.10
    overtravel_m: float = 0.05
    """Distance beyond the target at which the guarded move ends without contact."""
    branch: str = AUTO


@dataclass(frozen=True, slots=True)
class PlacementError:
    """Error of the true tool frame against the true target."""

    total_m: float
    lateral_m: float
    normal_m: float
    """Positive if the tool is short of the surface."""
    axis_rad: float
    """Angle of the tool x axis to the inward normal."""
    backlash_m: float
    """Part from outputs that lie elsewhere in their backlash than the set-points assume."""


@dataclass(frozen=True, slots=True)
class PlacementResult:
    """Outcome of a placement."""

    outcome: Outcome
    branch: str | None
    duration_s: float
    contact: PlacementError | None
    """Error at rest in contact; None without contact."""
    standoff: PlacementError | None
    """Error at rest at the standoff, against the commanded standoff."""
    evrs: tuple[tuple[float, Evr], ...]
    """Time [s] and event."""


def place_command(placement: Placement) -> PlaceTool:
    """Make the command of a placement, along the inward normal."""
    normal = normalize(placement.normal_N)
    target = p_R_from_N(np.array(placement.target_N_m))
    return PlaceTool(
        placement.tool,
        vector3(target),
        vector3(-normal),
        standoff_m=placement.standoff_m,
        overtravel_m=placement.overtravel_m,
        branch=placement.branch,
    )


def placement_commands(placement: Placement, stowed: bool) -> tuple[Command, ...]:
    """Make the command sequence of a placement."""
    unstow = (Unstow(),) if stowed else ()
    return (*unstow, place_command(placement), Retract(placement.tool, placement.standoff_m))


class PlacementRun:
    """Placement in a closed loop; `result` is complete after the last cycle."""

    def __init__(self, loop: ClosedLoop, placement: Placement):
        stowed = loop.state.mode is Mode.STOWED
        self._loop = loop
        self._placement = placement
        self.commands = placement_commands(placement, stowed)
        self._evrs: list[tuple[float, Evr]] = []
        self._errors: dict[str, PlacementError] = {}
        self._outcome = Outcome.SOFTWARE_ERROR
        self._touched = False

    def __iter__(self) -> Iterator[CycleRecord]:
        """Run the commands.

        Yields:
            Every cycle.
        """
        self._outcome = yield from observe_cycles(run_sequence(self._loop, self.commands), self._note)

    def stopping(self) -> Iterator[CycleRecord]:
        """Stop the arm in place of the remaining commands.

        Yields:
            Every cycle.
        """
        self._outcome = yield from observe_cycles(stop_sequence(self._loop), self._note)

    def _note(self, record: CycleRecord) -> None:
        for evr in record.outputs.evrs:
            self._evrs.append((record.tick / CYCLE_HZ, evr))
            self._touched = self._touched or isinstance(evr, ContactMade)
            if evr == CommandCompleted("MoveTool"):
                self._errors["standoff"] = self._error(record, self._placement.standoff_m)
            if evr == CommandCompleted("GuardedMove"):
                self._errors["contact"] = self._error(record, 0.0)

    def _error(self, record: CycleRecord, height_m: float) -> PlacementError:
        placement, plant = self._placement, self._loop.plant
        normal = normalize(placement.normal_N)
        target = p_R_from_N(np.array(placement.target_N_m)) + height_m * normal
        truth, tool = plant.truth(), plant.tools.index(placement.tool)
        error = truth.p_RoTo_R_m[tool] - target
        along = float(error @ normal)
        boresight = truth.R_RT[tool][:, 0]
        shift = plant.tool_shift(
            placement.tool, plant.backlash_rad() - record.outputs.joint.planned_backlash_rad
        )
        return PlacementError(
            total_m=float(np.linalg.norm(error)),
            lateral_m=float(np.linalg.norm(error - along * normal)),
            normal_m=along,
            axis_rad=angle_between(-boresight, normal),
            backlash_m=float(np.linalg.norm(shift)),
        )

    def result(self) -> PlacementResult:
        """Return the result; valid after the last cycle."""
        branch = next((evr.branch for _, evr in self._evrs if isinstance(evr, BranchChosen)), None)
        return PlacementResult(
            self._outcome,
            branch,
            self._loop.plant.data.time,
            self._errors.get("contact") if self._touched else None,
            self._errors.get("standoff"),
            tuple(self._evrs),
        )
