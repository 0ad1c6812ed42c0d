"""One arm of a Monte Carlo: its errors drawn, moved to places of the workspace, measured at the tool."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.commands import Backlash, MoveTool
from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.joints import Tool
from fsw.dictionary.params import Params
from fsw.dictionary.tuples import joints5, vector3
from fsw.estimate.reference import Reference, no_reference
from fsw.kinematics.arm import arm_from
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array, Pose
from ground.accuracy.drawn import drawn_effects, is_compensated
from ground.accuracy.poses import workspace_poses
from ground.accuracy.sources import Case, ErrorModel
from sim.arms import BuiltArm, arm_named
from sim.avionics import move_rng
from sim.effects.effect import EachMove, drawn_scatter
from sim.effects.environment import Ambient, NothingToTouch
from sim.initialisation import initial_reference, true_reference
from sim.loop import ClosedLoop, Setup, hardware_rng
from sim.sequence import run_sequence
from sim.settled import settled_move
from sim.trials import TEMPERATURE_C
from sim.world import World

How = Literal["closed-loop", "statics"]
AWAY_RAD: Final = 0.05
"""From where a move to a place begins, each joint to one side or the other: farther than any gap is wide."""
OF_THE_ARM: Final = ("assembly", "calibration", "deflection", "zero_offset", "backlash")
"""Sources that an arm has which was built, calibrated and initialised."""
INSIDE_RAD: Final = 0.01
"""How far from the soft limits."""
ENOUGH: Final = 20
"""Times as many poses as places, of which places are picked at random."""
REST_S: Final = 2.0
"""On the brakes, before anything is looked at."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a tool is to be, and how."""

    tool: Tool
    start_rad: Array
    output_rad: Array
    X_RT: Pose
    seed: int
    """Of what the move leaves to chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """By how much a tool misses its place."""

    tool: Tool
    output_rad: Array
    """Of the commanded pose, (5,)."""
    error: Array
    """Screw in tool axes, from commanded to true, (6,); a turn about x is not commanded, and left out."""
    gap: Array
    """Where the outputs lie in their gaps: -1 and +1 are the flanks, (5,)."""


Moved = Callable[[Place], tuple[Pose, Array]]
"""From a place to where the tool came to rest, and to where the outputs lie in their gaps."""


def drawn_trial(
    model: ErrorModel, case: Case, params: Params, places: int, how: How, seed: np.random.SeedSequence
) -> list[Measured]:
    """An arm of a case, drawn from this seed, at so many places.

    Raises:
        RuntimeError: a move in the closed loop did not come to its end.
    """
    draw, own = seed.spawn(2)
    rng = np.random.default_rng(draw)
    tool = Tool(int(rng.integers(len(Tool))))
    effects = drawn_effects(model, case, tool, rng)
    backlash: Backlash = "on" if is_compensated(case.sources.get("backlash", 0.0)) else "off"
    arm = BuiltArm("drawn", effects, params)
    moved = by_statics(arm, backlash) if how == "statics" else by_closed_loop(arm, _believed(arm), backlash)
    return measured(moved, random_places(params, tool, places, own))


def built_trial(
    model: ErrorModel,
    case: Case,
    name: str,
    params: Params,
    places: int,
    how: How,
    seed: np.random.SeedSequence,
) -> list[Measured]:
    """An arm with errors of its own, initialised at its hardstops, in the cold, with what the case adds.

    Raises:
        RuntimeError: it was not initialised, or a move in the closed loop did not come to its end.
    """
    draw, own = seed.spawn(2)
    rng = np.random.default_rng(draw)
    tool = Tool(int(rng.integers(len(Tool))))
    added = {name: factor for name, factor in case.sources.items() if name not in OF_THE_ARM}
    cold = Ambient(float(rng.uniform(*TEMPERATURE_C)))
    arm = arm_named(name, params)
    effects = (cold, *drawn_effects(model, replace(case, sources=added), tool, rng))
    there = replace(arm, effects=(*arm.effects, *effects))
    moved = (
        by_statics(there, "on") if how == "statics" else by_closed_loop(there, initial_reference(arm), "on")
    )
    return measured(moved, random_places(arm.params, tool, places, own))


def measured(moved: Moved, places: list[Place]) -> list[Measured]:
    """What came of moves to these places."""
    found = []
    for place in places:
        X_RT, gap = moved(place)
        found.append(Measured(place.tool, place.output_rad, error_in_tool(place.X_RT, X_RT), gap))
    return found


def random_places(params: Params, tool: Tool, count: int, seed: np.random.SeedSequence) -> list[Place]:
    """Poses over workspace and branches, as flight software believes the arm to hang on Mars."""
    arm, gravity = arm_from(params), World().gravity_N_m_s2
    rng = np.random.default_rng(seed)
    poses = workspace_poses(arm, tool, gravity, ENOUGH * count, int(rng.integers(2**31)))
    # neighbours are branches of one target
    output = poses.output_rad[:, rng.choice(ENOUGH * count, count, replace=False)]
    X_RT = tool_pose(arm, rest(arm, output, gravity).frames, tool)
    away = AWAY_RAD * rng.choice([-1.0, 1.0], output.shape)
    low, high = (limit[:, None] for limit in (arm.soft_min_rad + INSIDE_RAD, arm.soft_max_rad - INSIDE_RAD))
    start = np.clip(output + away, low, high)
    seeds = rng.integers(2**31, size=count)
    return [Place(tool, start[:, k], output[:, k], X_RT[k], int(seeds[k])) for k in range(count)]


def by_closed_loop(arm: BuiltArm, reference: Reference, backlash: Backlash) -> Moved:
    """Plant and flight software, in free air."""
    free = NothingToTouch()
    arm = replace(arm, params=free.on_params(arm.params))

    def moved(place: Place) -> tuple[Pose, Array]:
        loop = ClosedLoop(Setup(arm, World(), joints5(place.start_rad), place.seed, reference, (free,)))
        _rest(loop, 1.0)
        X_RT = place.X_RT
        command = MoveTool(place.tool, vector3(X_RT.p), vector3(X_RT.R[:, 0]), backlash=backlash)
        evrs = [evr for record in run_sequence(loop, (command,)) for evr in record.outputs.evrs]
        if CommandCompleted("MoveTool") not in evrs:
            raise RuntimeError(
                f"{arm.name}: no way to {np.degrees(place.output_rad)} deg: {evrs[-1].message}"
            )
        _rest(loop, REST_S)
        truth, plant = loop.truth(), loop.plant
        X_RT = Pose(truth.R_RT[place.tool], truth.p_RoTo_R_m[place.tool])
        return X_RT, plant.gap_rad() / plant.half_gap_rad

    return moved


def by_statics(arm: BuiltArm, backlash: Backlash) -> Moved:
    """The equilibrium of the arm, its gears as the move leaves them."""
    known = arm.params
    for effect in arm.effects:
        known = effect.on_params(known)
    believed, true = configure(arm.params), configure(known)
    off_rad = np.array(
        [
            t.hardstop_rad - b.hardstop_rad
            for t, b in zip(known.joints.in_order(), arm.params.joints.in_order(), strict=True)
        ]
    )
    by_chance = [effect for effect in arm.effects if isinstance(effect, EachMove)]
    reference, gravity = no_reference(believed), World().gravity_N_m_s2

    def moved(place: Place) -> tuple[Pose, Array]:
        scatter = drawn_scatter(by_chance, move_rng(hardware_rng(place.seed)))
        settled = settled_move(
            believed,
            true,
            reference,
            off_rad,
            place.start_rad,
            place.output_rad,
            place.tool,
            gravity,
            backlash,
            scatter,
        )
        return settled.X_RT, settled.gap_rad / true.half_gap_rad

    return moved


def error_in_tool(commanded: Pose, true: Pose) -> Array:
    """The screw from commanded to true in tool axes, (6,), without the turn about x."""
    turn = true.R.T @ np.cross(commanded.R[:, 0], true.R[:, 0])
    return np.concatenate([turn, true.R.T @ (true.p - commanded.p)])


def _believed(arm: BuiltArm) -> Reference:
    """Zeros as a faultless initialisation would find them, gaps as the parameters have them."""
    half_gap = np.array([0.5 * joint.backlash_rad for joint in arm.params.joints.in_order()])
    return replace(true_reference(arm), half_gap_rad=half_gap)


def _rest(loop: ClosedLoop, duration_s: float) -> None:
    for _ in range(round(duration_s * CYCLE_HZ)):
        loop.cycle()
