"""Placement of an instrument: what flight software plans, and a run with the errors of its result.

A placement is: unstow, standoff, touch and retract. A preview uses what flight software knows: the nominal
model of rover and terrain, not the built arm.
"""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.arguments import Wrong, read_arguments
from fsw.dictionary.commands import Command, PlaceTool, Retract, Unstow
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import BranchChosen, CommandCompleted, ContactMade, Evr
from fsw.dictionary.types import AUTO, Vector3, vector3
from fsw.estimate.joints import JointEstimate, uninitialised_estimate
from fsw.estimate.reference import no_reference
from fsw.executive.context import known_names
from fsw.executive.expansion import locate_surface
from fsw.executive.planning import PlannedSequence, Start, plan_command
from fsw.kinematics.transforms import Array, angle_between, normalize
from fsw.motion.plan import JointPositions, Plan, Refusal, estimate_at
from fsw.motion.work import complete
from sim.arms import BuiltArm
from sim.frames import p_R_from_N, random_surface
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.sequence import Outcome, SequenceRun
from sim.setting import Surface, World
from sim.world import params_in_world


@dataclass(frozen=True, slots=True)
class Placement:
    """Placement in RNAV; the normal points out of the surface."""

    tool: str
    p_N_m: Vector3
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
    target = p_R_from_N(np.array(placement.p_N_m))
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


class PlacementRun(SequenceRun):
    """Placement in a closed loop; `result` is complete after the last cycle."""

    def __init__(self, loop: ClosedLoop, placement: Placement):
        super().__init__(loop, placement_commands(placement, loop.state.mode is Mode.STOWED))
        self._placement = placement
        self._errors: dict[str, PlacementError] = {}
        self._touched = False

    def note(self, record: CycleRecord) -> None:
        """Measure the true errors at the standoff and in contact."""
        for evr in record.outputs.evrs:
            self._touched = self._touched or isinstance(evr, ContactMade)
            if evr == CommandCompleted("MoveTool"):
                self._errors["standoff"] = self._error(record, self._placement.standoff_m)
            if evr == CommandCompleted("GuardedMove"):
                self._errors["contact"] = self._error(record, 0.0)

    def _error(self, record: CycleRecord, height_m: float) -> PlacementError:
        placement, plant = self._placement, self.loop.plant
        normal = normalize(placement.normal_N)
        target = p_R_from_N(np.array(placement.p_N_m)) + height_m * normal
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
        branch = next((evr.branch for _, evr in self.evrs if isinstance(evr, BranchChosen)), None)
        return PlacementResult(
            self.outcome,
            branch,
            self.loop.plant.data.time,
            self._errors.get("contact") if self._touched else None,
            self._errors.get("standoff"),
            tuple(self.evrs),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """Placement as flight software plans it, or the reason that it refuses."""

    placement: Placement
    problem: str | None
    plans: tuple[Plan, ...] = ()
    """Plans of the moves to the standoff, and of the guarded move; none with a problem."""

    @property
    def duration_s(self) -> float:
        """Return an upper bound of the duration from the ready pose to contact."""
        return sum(path.duration_s for plan in self.plans for path in plan.paths)

    @property
    def branch(self) -> str | None:
        """Return the branch of the inverse kinematics at the standoff."""
        return self.plans[-2].branch if self.plans else None

    @property
    def standoff_rad(self) -> Array:
        """Return the motor angles at the standoff, shape (5,)."""
        return self.plans[-2].end.motor_rad


def preview_placement(arm: BuiltArm, world: World, placement: Placement, stowed: bool = False) -> Preview:
    """Plan a placement from the ready pose; from the stowed pose, the way to the ready pose too."""
    config = configure(params_in_world(world, arm.params))
    command = read_arguments(place_command(placement), known_names(config.params))
    if isinstance(command, Wrong):
        return Preview(placement, command.text)
    joints = first_estimate(config, np.array(arm.params.poses.ready_rad), world.gravity_N_m_s2)
    if stowed:
        unstow = _plan_unstow(config, joints)
        if isinstance(unstow, Refusal):
            return Preview(placement, f"{unstow.reason} on the way from the stowed to the ready pose")
    surface = locate_surface(config, joints, command.tool, command, None)
    planned = complete(config, plan_command(Start(joints, command.tool, surface), command))
    if isinstance(planned, Refusal):
        return Preview(placement, planned.reason)
    return Preview(placement, None, planned.plans)


def unstow_duration_s(arm: BuiltArm) -> float:
    """Compute the duration of the move from the stowed to the ready pose."""
    config = configure(arm.params)
    plan = _plan_unstow(config, first_estimate(config, np.array(arm.params.poses.ready_rad), np.zeros(3)))
    return 0.0 if isinstance(plan, Refusal) else plan.duration_s


def _plan_unstow(config: Config, joints: JointEstimate) -> PlannedSequence | Refusal:
    stowed = joints_at(joints, np.array(config.params.poses.stowed_rad))
    return complete(config, plan_command(Start(stowed, config.params.tools[0].name, None), Unstow()))


def first_estimate(config: Config, output_rad: Array, gravity_R_m_s2: Array) -> JointEstimate:
    """Build the estimate of calibrated joints at rest at these outputs, with gravity from the IMU."""
    joints = uninitialised_estimate(config, no_reference(config))
    return joints_at(replace(joints, imu_R_m_s2=gravity_R_m_s2), output_rad)


def joints_at(joints: JointEstimate, output_rad: Array) -> JointEstimate:
    """Return the estimate with each output at an angle, in the middle of its backlash."""
    return estimate_at(joints, JointPositions(output_rad, np.zeros_like(output_rad)))


def random_placement(seed: int, arm: BuiltArm, tool: str, max_tilt_rad: float) -> tuple[World, Preview]:
    """Draw placements of random point, normal and tilt, at most this, until flight software plans one."""
    rng = np.random.default_rng([seed, 3])
    while True:
        point, normal = random_surface(rng, arm.model.workspace)
        tilt, heading = rng.uniform(0.0, max_tilt_rad), rng.uniform(-np.pi, np.pi)
        roll, pitch = float(tilt * np.cos(heading)), float(tilt * np.sin(heading))
        world = World("mars", roll, pitch, Surface(point, normal))
        preview = preview_placement(arm, world, Placement(tool, point, normal))
        if preview.problem is None:
            return world, preview
