"""Campaign of tool changes: distance of the second tool from the spot of the first, against absolute moves.

Calibrated arms are 50 K warmer or colder than their sensor tells, and all their springs are a fifth softer or
stiffer. The APXS is placed, and the tool changed to MAHLI. On the same arm and target, MAHLI is also placed
by coordinates alone. As-built arms are flown with the nominal parameters.

Every target counts at which flight software accepts to place the APXS. A refused change is compared with an
independent search for a clear way by other code than that of flight software, in MuJoCo's geometry: the rock
is an infinite plane at the true face. The arm retracts straight, turns with even joint rates to the standoff
of the second tool, and goes straight on to the face.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal

import mujoco
import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import AUTO, Command, Retract, ToolChange
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CommandCompleted, Evr, Severity
from fsw.dictionary.types import joints5
from fsw.estimate.reference import Reference
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from fsw.motion.plan import Compensation
from fsw.motion.plan_tool import start_line
from sim.arms import BuiltArm, arm_named
from sim.effects.effect import Effect
from sim.effects.geometry import Warming
from sim.effects.joints import GearStiffness
from sim.effects.structure import LinkStiffness
from sim.frames import FLIP
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import place_command, random_placement
from sim.plant import Plant
from sim.sequence import run_sequence
from sim.setting import World
from sim.tolerances import SPRING_FRAMES
from sim.world import build, lower_ground
from validation.campaigns import Context, Document

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
    return ToolChangeErrors(
        from_spot_mm=_lateral_mm(relative - first, axis), absolute_mm=_lateral_mm(absolute - target, axis)
    )


def _judge_refusal(loop: ClosedLoop, arm: BuiltArm, world: World, reason: str) -> NotChanged:
    """Compare a refused tool change with the independent search, at the spot where the arm touches."""
    config, joints = loop.config, loop.state.joints
    contact = start_line(config, joints, FIRST, Compensation())
    spot = contact.p_m, contact.axis
    reachable = bool(_valid_poses(config, SECOND, *spot, joints.gravity_R_m_s2, CLOSE_M))
    way = find_clear_way(arm, world, config, (FIRST, SECOND), joints.output_rad, *spot)
    return NotChanged("refused", reason, reachable, way)


def not_completed(command: Command, evrs: Sequence[Evr]) -> str | None:
    """Return the warning that ended a command early; None if it was completed."""
    if CommandCompleted(type(command).__name__) in evrs:
        return None
    return next((evr.message for evr in evrs if evr.severity >= Severity.WARNING_LO), "no reason")


def _touch(loop: ClosedLoop, commands: tuple[Command, ...]) -> Array | str:
    """Run commands; return the true position of the touching tool, or the warning of a failure."""
    evrs = [evr for record in run_sequence(loop, commands) for evr in record.outputs.evrs]
    problem = not_completed(commands[-1], evrs)
    if problem is not None:
        return problem
    touching: Array = loop.plant.truth().p_RoTo_R_m[loop.plant.tools.index(loop.state.tool)]
    return touching


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


RETRACTIONS_M: Final = np.arange(0.10, 0.501, 0.05)
SPACING_RAD: Final = 0.02
LINE_POSES: Final = 6
CLOSE_M: Final = 0.1
"""Distance from the face of a spot in reach."""
UNCHECKED: Final = {"link2", "link3"}
"""Bodies that may be below the plane: rock is not endless."""


def find_clear_way(
    arm: BuiltArm,
    world: World,
    config: Config,
    tools: tuple[str, str],
    start_rad: Array,
    p_R_m: Array,
    approach_R: Array,
) -> str | None:
    """Find a branch and a retraction, in words, that are clear by flight software's padding; None if none is.

    Args:
        tools: Touching tool, and the tool that is to touch next.
        start_rad: Outputs in contact, (5,).
        p_R_m: Point of contact in RMECH, (3,).
        approach_R: Unit approach, (3,).
    """
    plant, gravity = _plant_with_plane(arm, world, config.params.collision.padding_m), world.gravity_N_m_s2
    first, second = tools
    for retraction_m in RETRACTIONS_M:
        back = _follow(config, first, p_R_m, approach_R, gravity, retraction_m, start_rad)
        if back is None or not _is_clear(plant, config, gravity, back, first):
            continue
        for branch, pose in _valid_poses(config, second, p_R_m, approach_R, gravity, retraction_m):
            turn = _between(back[:, -1], pose)
            onward = _follow(config, second, p_R_m, approach_R, gravity, retraction_m, pose, onward=True)
            if onward is None or not _is_clear(plant, config, gravity, turn, None):
                continue
            if _is_clear(plant, config, gravity, onward, second):
                return f"{branch} after {1e3 * retraction_m:.0f} mm"
    return None


def _plant_with_plane(arm: BuiltArm, world: World, padding_m: float) -> Plant:
    """Build a plant whose rock is an infinite plane, and whose contacts begin at the padding."""
    face = world.surface
    assert face is not None
    spec = build(replace(world, surface=None), arm.model)
    lower_ground(spec, -world.ground_N_m)
    z, quat = FLIP * np.array(face.normal_N), np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, z / np.linalg.norm(z))
    spec.worldbody.add_geom(
        name="rock_face",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0, 0, 1),
        pos=FLIP * np.array(face.p_N_m),
        quat=quat,
        contype=2,
        conaffinity=1,
    )
    for geom in spec.geoms:
        geom.margin = 0.5 * padding_m
    return Plant(spec.compile())


def _valid_poses(
    config: Config, tool: str, p_R_m: Array, approach_R: Array, gravity: Array, distance_m: float
) -> list[tuple[str, Array]]:
    """Return branches and outputs at a distance from the face from which the face is reached too."""
    distances = np.array([distance_m, 0.0])
    p = p_R_m[:, None] - approach_R[:, None] * distances
    found = inverse_kinematics(config.arm, tool, p, np.tile(approach_R[:, None], 2), gravity)
    valid = np.all(found.verdict == BranchVerdict.VALID, axis=-1)
    return [(BRANCHES[k % len(BRANCHES)], found.output_rad[:, k, 0]) for k in np.flatnonzero(valid)]


def _follow(
    config: Config,
    tool: str,
    p_R_m: Array,
    approach_R: Array,
    gravity: Array,
    distance_m: float,
    near_rad: Array,
    onward: bool = False,
) -> Array | None:
    """Return outputs (5, n) on the line away from the face, or onward to it, from a pose; None if it ends."""
    distances = np.linspace(0.0, distance_m, LINE_POSES)
    poses = [near_rad]
    for away in distances[::-1] if onward else distances:
        found = inverse_kinematics(config.arm, tool, p_R_m - away * approach_R, approach_R, gravity)
        valid = found.verdict == BranchVerdict.VALID
        if not valid.any():
            return None
        far = np.abs(found.output_rad - poses[-1][:, None]).max(axis=0)
        nearest = int(np.where(valid, far, np.inf).argmin())
        if far[nearest] > 0.6:
            return None
        poses.append(found.output_rad[:, nearest])
    return np.array(poses[1:]).T


def _between(start: Array, end: Array) -> Array:
    count = int(np.abs(end - start).max() / SPACING_RAD) + 2
    return start[:, None] + np.linspace(0.0, 1.0, count) * (end - start)[:, None]


def _is_clear(plant: Plant, config: Config, gravity: Array, outputs: Array, touching: str | None) -> bool:
    """Return whether no geoms but those of the touching tool are closer than the padding at these poses."""
    at_rest = settle_output(config.arm, outputs, gravity)
    for output, strain in zip(outputs.T, np.moveaxis(at_rest.strain, -1, 0), strict=True):
        plant.show(output, strain)
        mujoco.mj_collision(plant.model, plant.data)
        if any(_matters(plant, contact, touching) for contact in plant.data.contact):
            return False
    return True


def _matters(plant: Plant, contact: Any, touching: str | None) -> bool:
    """Return whether a close pair of geoms counts; upper arm and forearm may be near the endless plane."""
    model = plant.model
    bodies = {model.body(model.geom_bodyid[geom]).name for geom in contact.geom}
    if touching is not None and touching.lower() in bodies:
        return False
    with_face = "rock_face" in {model.geom(geom).name for geom in contact.geom}
    return not (with_face and bodies & UNCHECKED)
