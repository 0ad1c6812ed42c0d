"""Campaign of tool changes: distance of the second tool from the spot of the first, against absolute moves.

Calibrated arms are 50 K warmer or colder than their sensor tells, and all their springs are a fifth
softer or stiffer. The APXS is placed, and the tool changed to MAHLI. On the same arm and target, MAHLI is
also placed by coordinates alone. As-built arms are flown with the nominal parameters.

Every target counts at which flight software accepts to place the APXS. A refused change is compared with an
independent search for a clear way (validation/clear_way.py).

Contacts are judged on calibrated arms: from 0.5 s after the last change of set-point, no contact is lost and
no switch changes. The force stays within 20 % of its mean over the last second; from 2 s on, or once the
brakes hold, within 5 %.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from typing import Literal

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import AUTO, Command, Retract, ToolChange
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.evrs import CommandCompleted, Evr, Severity
from fsw.dictionary.types import joints5
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array
from fsw.motion.plan import Compensation
from fsw.motion.plan_tool import start_line
from sim.arms import SPRING_FRAMES, BuiltArm, arm_named
from sim.clearance import tool_forces
from sim.effects.effect import Effect
from sim.effects.geometry import FrameError, Warming
from sim.effects.joints import GearStiffness
from sim.effects.structure import LinkStiffness
from sim.initialisation import initial_reference, true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import place_command, random_placement
from sim.sequence import run_sequence
from sim.world import World
from validation.campaigns import Context, Document
from validation.clear_way import find_clear_way, reaches

WARMING_K = 50.0
STIFFNESS = 1.2
TILT_RAD = float(np.radians(30.0))
POSES = 5
FROM_SPOT_MM = 10.0
"""Largest distance from the spot after a tool change on a calibrated arm."""
MOST_FAILED = 3 / 60
"""Largest share of accepted changes that are not completed."""
MOST_REFUSED = 0.15
"""Largest share of changes in reach that are refused."""
FIRST, SECOND = "apxs", "mahli"


@dataclass(frozen=True, slots=True)
class ToolChangeErrors:
    """Lateral distances of a tool change."""

    from_spot_mm: float
    """Second tool, placed by the tool change, from the true contact of the first."""
    absolute_mm: float
    """Second tool, placed by its coordinates, from the target."""
    twice_absolute_mm: float
    """Second tool, placed by its coordinates, from the true contact of the first, placed likewise."""
    tool_frames_mm: float
    """Contribution of the errors of both tool frames to `from_spot_mm`."""
    residual_mm: float
    """Lateral distance of `from_spot_mm` without this contribution."""


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
    """Whether any branch of the second tool reaches the spot."""
    clear_way: str | None = None
    """Way that the independent search finds, of a refused change."""


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
    if isinstance(first, str):
        return NotChanged("first tool not placed", first)
    again = replace(place, tool=SECOND, branch=AUTO)
    changing = loop.fork()
    relative = _touch(changing, (ToolChange(SECOND),))
    if isinstance(relative, str) and changing.state.mode is loop.state.mode:
        return _judge_refusal(loop, arm, world, relative)
    if isinstance(relative, str):
        return NotChanged("not completed", relative)
    absolute = _touch(loop.fork(), (Retract(FIRST, place.standoff_m), again))
    if isinstance(absolute, str):
        return NotChanged("absolute not placed", absolute)
    (spot, R_1), (second, R_2) = first, relative
    frames = R_2 @ _tool_shift(arm, SECOND) - R_1 @ _tool_shift(arm, FIRST)
    return ToolChangeErrors(
        from_spot_mm=_lateral_mm(second - spot, axis),
        absolute_mm=_lateral_mm(absolute[0] - target, axis),
        twice_absolute_mm=_lateral_mm(absolute[0] - spot, axis),
        tool_frames_mm=_lateral_mm(frames, axis),
        residual_mm=_lateral_mm(second - spot - frames, axis),
    )


def _judge_refusal(loop: ClosedLoop, arm: BuiltArm, world: World, reason: str) -> NotChanged:
    """Compare a refused tool change with the independent search, at the spot where the arm touches."""
    config, joints = loop.config, loop.state.joints
    contact = start_line(config, joints, FIRST, Compensation())
    spot = contact.p_m, contact.axis
    reachable = reaches(config, SECOND, *spot, joints.gravity_R_m_s2)
    way = find_clear_way(arm, world, config, (FIRST, SECOND), joints.output_rad, *spot)
    return NotChanged("refused", reason, reachable, way)


def not_completed(command: Command, evrs: Sequence[Evr]) -> str | None:
    """Return the warning that ended a command early; None if it was completed."""
    if CommandCompleted(type(command).__name__) in evrs:
        return None
    return next((evr.message for evr in evrs if evr.severity >= Severity.WARNING_LO), "no reason")


def _touch(loop: ClosedLoop, commands: tuple[Command, ...]) -> tuple[Array, Array] | str:
    """Run commands; return true position and rotation of the touching tool, or the warning of a failure."""
    evrs = [evr for record in run_sequence(loop, commands) for evr in record.outputs.evrs]
    problem = not_completed(commands[-1], evrs)
    if problem is not None:
        return problem
    truth, tool = loop.plant.truth(), loop.plant.tools.index(loop.state.tool)
    return truth.p_RoTo_R_m[tool], truth.R_RT[tool]


def _tool_shift(arm: BuiltArm, tool: str) -> Array:
    """Return the position error of a tool on the turret, in tool axes, shape (3,), in metres.

    It is relative to the nominal parameters.
    """
    return sum(
        (
            np.array(effect.screw[3:])
            for effect in arm.effects
            if isinstance(effect, FrameError) and effect.frame is Frame.TOOL and effect.tool == tool
        ),
        np.zeros(3),
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
        "refused_wrongly": sum(one.clear_way is not None for one in refused),
        "not_completed": sum(one.why == "not completed" for one in others),
        "failures": [asdict(one) for one in others],
    }
    if not changes:
        return counts
    table = np.array([[getattr(c, name) for name in ToolChangeErrors.__slots__] for c in changes])
    three_sigma = 3 * np.sqrt(np.mean(table**2, axis=0))
    named = {
        name: {"three_sigma": float(three), "max": float(largest)}
        for name, three, largest in zip(
            ToolChangeErrors.__slots__, three_sigma, table.max(axis=0), strict=True
        )
    }
    return {**counts, **named}


def campaign(context: Context, calibrated: int = 50, as_built: int = 20, poses: int = POSES) -> Document:
    """Measure tool changes of this many arms."""
    tried: dict[str, list[ToolChangeErrors | NotChanged]] = {}
    for kind, count in (("calibrated", calibrated), ("as-built", as_built)):
        arms = context.each(one_arm, ((kind, context.seed + k, poses) for k in range(count)), f"{kind} arms")
        tried[kind] = [change for arm in arms for change in arm]
    measured = {kind: summary(found) for kind, found in tried.items() if found}
    return {**measured, "in_bounds": _is_in_bounds(tried["calibrated"])}


def _is_in_bounds(tried: list[ToolChangeErrors | NotChanged]) -> bool:
    """Return whether changes end near the spot, and whether few fail or are refused without reason."""
    near = all(one.from_spot_mm <= FROM_SPOT_MM for one in tried if isinstance(one, ToolChangeErrors))
    others = [one for one in tried if isinstance(one, NotChanged)]
    refused = [one for one in others if one.why == "refused" and one.reachable]
    accepted = len(tried) - sum(one.why in ("refused", "first tool not placed") for one in others)
    failed = sum(one.why == "not completed" for one in others)
    few_fail = failed <= MOST_FAILED * accepted
    few_refused = len(refused) <= MOST_REFUSED * (accepted + len(refused))
    return near and few_fail and few_refused and all(one.clear_way is None for one in refused)


SOON_S, LATER_S, HELD_S = 0.5, 2.0, 4.0
SOON, LATER = 0.20, 0.05
"""Largest deviations of the force from its mean, as a share of it."""
MOST_DRAWS = 25
"""Largest number of targets that are tried on an arm."""


@dataclass(frozen=True, slots=True)
class ContactRest:
    """Contact of a tool, from the touch until 4 s after the command."""

    arm: str
    tool: str
    mean_N: float
    """Mean force over the last second."""
    force_error_0_5_s: float
    """Largest deviation of the force from its mean from 0.5 s on, as a share of it."""
    force_error_2_s: float
    """Likewise from 2 s on or once the brakes hold."""
    lost: int
    """Cycles without contact."""
    switched: int
    """Changes of a switch of the tool."""

    @property
    def in_bounds(self) -> bool:
        """True if the contact is at rest within the bounds."""
        return (
            self.force_error_0_5_s < SOON and self.force_error_2_s < LATER and self.lost == self.switched == 0
        )


def rest_after(loop: ClosedLoop, commands: Sequence[Command], tool: str, arm: str = "") -> ContactRest | str:
    """Measure the contact of a tool that touches at the end of these commands.

    The loop runs until 4 s after the last command.

    Returns:
        The measured contact, or the warning that ended the commands early.
    """
    evrs: list[Evr] = []
    force_N, closed, setpoint_count, braked = [], [], [], []
    commanded = run_sequence(loop, commands)
    for record in chain(commanded, (loop.cycle() for _ in range(round(HELD_S * CYCLE_HZ)))):
        evrs += record.outputs.evrs
        force_N.append(float(np.linalg.norm(tool_forces(loop.plant)[loop.plant.tools.index(tool)])))
        closed.append(record.sensors.switch_closed[list(loop.config.protection.tool_switches[tool])])
        setpoint_count.append(record.outputs.drive.setpoint_count)
        braked.append(loop.braked)
    problem = not_completed(commands[-1], evrs)
    if problem is not None:
        return problem
    last = int(np.flatnonzero(np.diff(np.array(setpoint_count), axis=0).any(axis=1))[-1]) + 1
    soon = last + round(SOON_S * CYCLE_HZ)
    later = min(last + round(LATER_S * CYCLE_HZ), max(soon, braked.index(True, last)))
    force, mean_N = np.array(force_N), float(np.mean(force_N[-CYCLE_HZ:]))
    deviation = np.abs(force - mean_N) / mean_N
    changes = np.diff(np.array(closed[soon:]).astype(int), axis=0)
    return ContactRest(
        arm,
        tool,
        mean_N,
        force_error_0_5_s=float(deviation[soon:].max()),
        force_error_2_s=float(deviation[later:].max()),
        lost=int(np.sum(force[soon:] == 0.0)),
        switched=int(np.abs(changes).sum()),
    )


def contacts_of(seed: int) -> list[ContactRest]:
    """Measure a placement and a tool change of one arm, at the first target where both succeed."""
    name = f"calibrated:{seed}"
    arm = arm_named(name)
    for draw in range(1, MOST_DRAWS + 1):
        world, preview = random_placement(1000 * seed + draw, arm, FIRST, TILT_RAD)
        loop = ClosedLoop(Setup(arm, world, joints5(preview.standoff_rad), draw, true_reference(arm)))
        first = rest_after(loop, (place_command(preview.placement),), FIRST, name)
        second = (
            rest_after(loop, (ToolChange(SECOND),), SECOND, name) if isinstance(first, ContactRest) else first
        )
        if isinstance(first, ContactRest) and isinstance(second, ContactRest):
            return [first, second]
    raise RuntimeError(f"{name}: no tool change was carried out at {MOST_DRAWS} targets")


def contacts(context: Context, arms: int = 20) -> Document:
    """Measure contacts on this many calibrated arms; in bounds if every contact is at rest."""
    measured = context.each(contacts_of, ((context.seed + arm,) for arm in range(arms)), "arms")
    found = [rest for rests in measured for rest in rests]
    return {
        "contacts": len(found),
        "max_force_error_0_5_s": max(rest.force_error_0_5_s for rest in found),
        "max_force_error_2_s": max(rest.force_error_2_s for rest in found),
        "not_at_rest": [asdict(rest) for rest in found if not rest.in_bounds],
        "in_bounds": all(rest.in_bounds for rest in found),
    }
