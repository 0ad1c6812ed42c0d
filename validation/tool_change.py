"""Campaign of tool changes: distance of the second tool from the spot of the first, against absolute moves.

Calibrated arms are 50 K warmer or colder than their sensor tells, and all their springs are a fifth softer or
stiffer. The APXS is placed, and the tool changed to MAHLI. On the same arm and target, MAHLI is also placed
by coordinates alone. As-built arms are flown with the nominal parameters.

Every target counts at which flight software accepts to place the APXS. A change may be refused where no
branch of the second tool reaches the spot and a point in front of it.

A change that ends far from the spot is one that flight software has told of, before it moved: the events on
undecided backlash name a distance that is at most twice the one that there is.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np

from fsw.dictionary.commands import Command, Retract, ToolChange
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import BacklashUndecided, CommandAccepted, CommandCompleted, Evr, Severity
from fsw.dictionary.types import AUTO, joints5
from fsw.estimate.reference import Reference
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.transforms import Array
from fsw.motion.plan import Compensation
from fsw.motion.plan_tool import start_line
from sim.arms import arm_named
from sim.effects.effect import Effect
from sim.effects.geometry import Warming
from sim.effects.joints import GearStiffness
from sim.effects.structure import LinkStiffness
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import place_command, random_placement
from sim.sequence import run_sequence
from sim.tolerances import SPRING_FRAMES
from validation.campaigns import Context, Document

WARMING_K = 50.0
STIFFNESS = 1.2
TILT_RAD = float(np.radians(30.0))
POSES = 5
FROM_SPOT_MM = 10.0
"""Largest distance from the spot after a tool change on a calibrated arm."""
NEAR_MM = 2.0
"""Distance within which a change on a calibrated arm ends, or else flight software told before it moved."""
LEAST_NEAR = 57 / 60
"""Least share of changes that end within this distance."""
MOST_NAMED_RATIO = 2.0
"""Largest ratio of the distance that was named to the one that there was, where that is not near."""
NAMED_MM = 3.0
"""Largest median of the distances that were named."""
MOST_FAILED = 3 / 60
"""Largest share of accepted changes that are not completed."""
MOST_REFUSED = 0.15
"""Largest share of changes in reach that are refused."""
FIRST, SECOND = "apxs", "mahli"
CLOSE_M = 0.1
"""Distance from the face of a spot in reach."""


@dataclass(frozen=True, slots=True)
class ToolChangeErrors:
    """Lateral distances of a tool change."""

    from_spot_mm: float
    """Second tool, placed by the tool change, from the true contact of the first."""
    absolute_mm: float
    """Second tool, placed by its coordinates, from the target."""
    named_mm: float
    """Distance that flight software named before it moved, of all joints together; 0 without an event."""

    @property
    def is_near_or_told(self) -> bool:
        """Return whether the change ends near the spot, or an honest distance was named before."""
        return self.from_spot_mm <= NEAR_MM or 0 < self.named_mm <= MOST_NAMED_RATIO * self.from_spot_mm


def unknown_to_flight(seed: int) -> tuple[Effect, ...]:
    """Draw effects that flight software does not know: warmer or colder, and softer or stiffer springs."""
    warm, stiff = np.random.default_rng([seed, 50]).choice([-1.0, 1.0], 2)
    factor = float(STIFFNESS**stiff)
    springs = [LinkStiffness(frame, factor) for frame in SPRING_FRAMES]
    return (Warming(WARMING_K * float(warm)), *springs, *(GearStiffness(joint, factor) for joint in Joint))


@dataclass(frozen=True, slots=True)
class NotChanged:
    """Tool change without errors to measure."""

    why: Literal["first tool not placed", "refused", "not completed", "absolute not placed"]
    reason: str
    reachable: bool = True
    """Whether any branch of the second tool reaches the spot, and a point in front of it."""


def one_arm(kind: str, seed: int, poses: int) -> list[ToolChangeErrors | NotChanged]:
    """Try one tool change at each of some random targets of one arm."""
    name = f"{kind}:{seed}"
    reference = initial_reference(arm_named(name))
    return [one_target(name, reference, draw) for draw in range(1, poses + 1)]


def one_target(name: str, reference: Reference, draw: int) -> ToolChangeErrors | NotChanged:
    """Measure the tool change at a random target, or say why there is none."""
    arm, seed = arm_named(name), int(name.partition(":")[2])
    world, preview = random_placement(1000 * seed + draw, arm, FIRST, TILT_RAD)
    effects = unknown_to_flight(seed) if name.startswith("calibrated") else ()
    loop = ClosedLoop(Setup(arm, world, joints5(preview.standoff_rad), draw, reference, effects))
    place = place_command(preview.placement)
    target, axis = np.array(place.p_RoTo_R_m), np.array(place.approach_R)
    first = _touch(loop, (place,))
    if first.problem is not None:
        return NotChanged("first tool not placed", first.problem)
    again = replace(place, tool=SECOND, branch=AUTO)
    changing = loop.fork()
    relative = _touch(changing, (ToolChange(SECOND),))
    if relative.problem is not None and not relative.is_accepted:
        return NotChanged("refused", relative.problem, _is_reachable(loop))
    if relative.problem is not None:
        return NotChanged("not completed", relative.problem)
    absolute = _touch(loop.fork(), (Retract(FIRST, place.standoff_m), again))
    if absolute.problem is not None:
        return NotChanged("absolute not placed", absolute.problem)
    from_spot_mm, absolute_mm = (
        _lateral_mm(one, axis) for one in (relative.p_R_m - first.p_R_m, absolute.p_R_m - target)
    )
    return ToolChangeErrors(from_spot_mm=from_spot_mm, absolute_mm=absolute_mm, named_mm=relative.named_mm)


def _is_reachable(loop: ClosedLoop) -> bool:
    """Return whether a branch of the second tool reaches the point of contact, and one in front of it."""
    contact = start_line(loop.config, loop.state.joints, FIRST, Compensation())
    p = contact.p_m[:, None] - contact.axis[:, None] * np.array([CLOSE_M, 0.0])
    axis, gravity = np.tile(contact.axis[:, None], 2), loop.state.joints.gravity_R_m_s2
    found = inverse_kinematics(loop.config.arm, SECOND, p, axis, gravity)
    return bool((found.verdict == BranchVerdict.VALID).all(axis=-1).any())


def not_completed(command: Command, evrs: Sequence[Evr]) -> str | None:
    """Return the warning that ended a command early; None if it was completed."""
    if CommandCompleted(type(command).__name__) in evrs:
        return None
    return next((evr.message for evr in evrs if evr.severity >= Severity.WARNING_LO), "no reason")


@dataclass(frozen=True, slots=True, eq=False)
class _Touch:
    """Commands that end with a touch."""

    p_R_m: Array
    """True position of the last commanded tool in RMECH, (3,)."""
    problem: str | None
    """Warning that ended the last command early; None if it was completed."""
    is_accepted: bool
    """True if the last command was accepted."""
    named_mm: float
    """Distance that events on undecided backlash named."""


def _touch(loop: ClosedLoop, commands: tuple[Command, ...]) -> _Touch:
    """Run commands that end with a touch."""
    evrs = [evr for record in run_sequence(loop, commands) for evr in record.outputs.evrs]
    return _Touch(
        p_R_m=loop.plant.truth().p_RoTo_R_m[loop.plant.tools.index(loop.state.tool)],
        problem=not_completed(commands[-1], evrs),
        is_accepted=CommandAccepted(type(commands[-1]).__name__) in evrs,
        named_mm=1e3 * sum(evr.error_m for evr in evrs if isinstance(evr, BacklashUndecided)),
    )


def _lateral_mm(difference_m: Array, axis: Array) -> float:
    return 1e3 * float(np.linalg.norm(difference_m - (difference_m @ axis) * axis))


def summary(tried: list[ToolChangeErrors | NotChanged]) -> Document:
    """Count the outcomes; three times the root mean square of each lateral distance, and the largest."""
    changes = [one for one in tried if isinstance(one, ToolChangeErrors)]
    others = [one for one in tried if isinstance(one, NotChanged)]
    refused = [one for one in others if one.why == "refused"]
    counts = {
        "count": len(changes),
        "refused": len(refused),
        "refused_in_reach": sum(one.reachable for one in refused),
        "not_completed": sum(one.why == "not completed" for one in others),
        "failures": [asdict(one) for one in others],
    }
    if not changes:
        return counts
    table = np.array([(one.from_spot_mm, one.absolute_mm) for one in changes])
    three_sigma = 3 * np.sqrt(np.mean(table**2, axis=0))
    rows = zip(("from_spot_mm", "absolute_mm"), three_sigma, table.max(axis=0), strict=True)
    errors = {name: {"three_sigma": float(three), "max": float(most)} for name, three, most in rows}
    told = [one.named_mm for one in changes if one.named_mm > 0]
    near = sum(one.from_spot_mm <= NEAR_MM for one in changes)
    named = {
        "near": near,
        "near_share": near / len(changes),
        "named": len(told),
        "named_median_mm": float(np.median(told)) if told else 0.0,
        "neither_near_nor_told": [asdict(one) for one in changes if not one.is_near_or_told],
    }
    return {**counts, **named, **errors}


def campaign(context: Context, calibrated: int = 50, as_built: int = 20, poses: int = POSES) -> Document:
    """Measure tool changes of this many arms."""
    tried: dict[str, list[ToolChangeErrors | NotChanged]] = {}
    for kind, count in (("calibrated", calibrated), ("as-built", as_built)):
        arms = context.each(one_arm, ((kind, context.seed + k, poses) for k in range(count)), f"{kind} arms")
        tried[kind] = [change for arm in arms for change in arm]
    measured = {kind: summary(found) for kind, found in tried.items() if found}
    return {**measured, "in_bounds": tool_changes_in_bounds(tried["calibrated"])}


def tool_changes_in_bounds(tried: list[ToolChangeErrors | NotChanged]) -> bool:
    """Return whether changes end near the spot or are told, and whether few fail or are refused in reach."""
    changes = [one for one in tried if isinstance(one, ToolChangeErrors)]
    near = sum(one.from_spot_mm <= NEAR_MM for one in changes) >= LEAST_NEAR * len(changes)
    told = all(one.is_near_or_told and one.from_spot_mm <= FROM_SPOT_MM for one in changes)
    named = [one.named_mm for one in changes if one.named_mm > 0]
    others = [one for one in tried if isinstance(one, NotChanged)]
    refused = [one for one in others if one.why == "refused" and one.reachable]
    accepted = len(tried) - sum(one.why in ("refused", "first tool not placed") for one in others)
    failed = sum(one.why == "not completed" for one in others)
    few_fail = failed <= MOST_FAILED * accepted
    few_refused = len(refused) <= MOST_REFUSED * (accepted + len(refused))
    small = not named or bool(np.median(named) <= NAMED_MM)
    return near and told and small and few_fail and few_refused
