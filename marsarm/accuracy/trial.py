"""Trial of one arm of a Monte Carlo: sample its errors, move it to placements, measure at the tool."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config, configure, configure_at
from fsw.dictionary.commands import BacklashMode, MoveTool
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5, row6, vector3
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import heat_arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose
from marsarm.accuracy.propagation import (
    BudgetCase,
    Distribution,
    ErrorModel,
    ErrorSource,
    is_compensated,
    workspace_poses,
)
from marsarm.accuracy.request import MoveModel
from sim.arms import BuiltArm, arm_named
from sim.avionics import move_rng
from sim.effects.effect import (
    EachMove,
    Effect,
    Hardware,
    draw_move_disturbance,
    hardware_with_effects,
    nominal_hardware,
    params_with_effects,
)
from sim.effects.environment import Ambient, StructureTemperature
from sim.effects.geometry import Expansion, FrameError, FramePlay
from sim.effects.joints import BacklashWidth, GearStiffness, HardstopAngle, ServoError, Windup
from sim.effects.structure import LinkStiffness
from sim.initialisation import RANDOM_TEMPERATURE_C, initial_reference, true_reference
from sim.loop import Setup, hardware_rng
from sim.pose_sequence import describe_no_way, free_air_loop, run_and_rest, solve_quasi_static_move
from sim.setting import WARM_C, World

START_OFFSET_RAD: Final = 0.05
"""Offset of the start of a move from its end, each joint to a random side; wider than any backlash."""
LIMIT_MARGIN_RAD: Final = 0.01
"""Distance of the start from the soft limits."""
POSES_PER_PLACEMENT: Final = 20
"""Number of drawn poses for each placement, from which the placement is picked at random."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedMove:
    """Commanded placement of a tool."""

    tool: str
    start_rad: Array
    output_rad: Array
    X_RT: Pose
    seed: int
    """Seed of the random errors of the move."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlacement:
    """Error of a tool at a placement."""

    tool: str
    output_rad: Array
    """Commanded joint angles, shape (5,)."""
    error: Array
    """Screw [rad, m] from commanded to true pose in tool axes, shape (6,).

    The rotation about x is not commanded, and is 0.
    """
    backlash_position: Array
    """Positions of the outputs in their backlash, -1 and +1 at the flanks, shape (5,)."""


TrueMove = Callable[[PlannedMove], tuple[Pose, Array]]
"""Function from a placement to the true tool pose and the positions of the outputs in their backlash."""


def configure_believed(arm: BuiltArm) -> Config:
    """Configure flight software of an arm for the temperature that its sensor reads."""
    hardware = _hardware(arm)
    return configure_at(configure(arm.params), hardware.structure_C + hardware.structure_offset_K)


def configure_true(arm: BuiltArm) -> Config:
    """Configure flight software that knows an arm exactly, with the arm as it is at its temperature."""
    drawn = arm.model.params
    cold = configure(params_with_effects(arm.effects, drawn))
    return replace(cold, arm=heat_arm(cold.arm, _hardware(arm).structure_C - drawn.heat.calibration_C))


def _hardware(arm: BuiltArm) -> Hardware:
    """Return avionics and sensors without the effects of each move, which draw their own errors."""
    lasting = (effect for effect in arm.effects if not isinstance(effect, EachMove))
    return hardware_with_effects(lasting, nominal_hardware(arm.model.description))


def random_placements(
    believed: Config, tool: str, count: int, seed: np.random.SeedSequence
) -> list[PlannedMove]:
    """Draw placements over workspace and branches, for the arm as flight software knows it."""
    arm, gravity = believed.arm, World().gravity_N_m_s2
    rng = np.random.default_rng(seed)
    poses = workspace_poses(arm, tool, gravity, POSES_PER_PLACEMENT * count, int(rng.integers(2**31)))
    # neighbouring poses are branches of one target, so draw at random
    output = poses.output_rad[:, rng.choice(POSES_PER_PLACEMENT * count, count, replace=False)]
    X_RT = [tool_pose(arm, settle_output(arm, q_rad, gravity).frames, tool) for q_rad in output.T]
    offset = START_OFFSET_RAD * rng.choice([-1.0, 1.0], output.shape)
    low, high = (
        limit[:, None] for limit in (arm.soft_min_rad + LIMIT_MARGIN_RAD, arm.soft_max_rad - LIMIT_MARGIN_RAD)
    )
    start = np.clip(output + offset, low, high)
    seeds = rng.integers(2**31, size=count)
    return [PlannedMove(tool, start[:, k], output[:, k], X_RT[k], int(seeds[k])) for k in range(count)]


def measure_placements(move: TrueMove, places: Sequence[PlannedMove]) -> list[MeasuredPlacement]:
    """Move to each placement and measure the error."""
    found = []
    for place in places:
        X_RT, position = move(place)
        found.append(
            MeasuredPlacement(place.tool, place.output_rad, error_in_tool(place.X_RT, X_RT), position)
        )
    return found


def error_in_tool(commanded: Pose, true: Pose) -> Array:
    """Compute the screw [rad, m], (6,), from commanded to true pose in tool axes, without turns about x."""
    turn = true.R.T @ np.cross(commanded.R[:, 0], true.R[:, 0])
    return np.concatenate([turn, true.R.T @ (true.p - commanded.p)])


def closed_loop_model(arm: BuiltArm, reference: Reference, backlash: BacklashMode) -> TrueMove:
    """Build the move model of plant and flight software in free air; RuntimeError if a move fails."""

    def move(place: PlannedMove) -> tuple[Pose, Array]:
        loop = free_air_loop(Setup(arm, World(), joints5(place.start_rad), place.seed, reference))
        X_RT = place.X_RT
        command = MoveTool(place.tool, vector3(X_RT.p), vector3(X_RT.R[:, 0]), backlash=backlash)
        problem = run_and_rest(loop, command)
        if problem is not None:
            raise RuntimeError(describe_no_way(arm, place.output_rad, problem))
        truth, plant = loop.truth(), loop.plant
        index = plant.tools.index(place.tool)
        X_RT = Pose(truth.R_RT[index], truth.p_RoTo_R_m[index])
        return X_RT, plant.backlash_rad() / plant.half_backlash_rad

    return move


def statics_model(arm: BuiltArm, believed: Config, backlash: BacklashMode) -> TrueMove:
    """Build the move model of static equilibrium, with an initialisation without errors.

    The gears have the wind-up and the side of the backlash that the move leaves.
    """
    true = configure_true(arm)
    random_effects = [effect for effect in arm.effects if isinstance(effect, EachMove)]
    gravity = World().gravity_N_m_s2

    def move(place: PlannedMove) -> tuple[Pose, Array]:
        disturbance = draw_move_disturbance(random_effects, move_rng(hardware_rng(place.seed)))
        X_RT, backlash_rad = solve_quasi_static_move(
            believed, true, place.start_rad, place.output_rad, place.tool, gravity, backlash, disturbance
        )
        return X_RT, backlash_rad / true.half_backlash_rad

    return move


Z_TURN = 2
"""Index of the rotation about z in a screw."""
ARM_SOURCES: Final = (
    "assembly",
    "calibration",
    "deflection",
    "rover_stiffness",
    "zero_offset",
    "backlash",
    "distortion_bulk",
)
"""Sources that a built, calibrated and initialised arm has itself."""


def sample_effects(
    model: ErrorModel, case: BudgetCase, tool: str, rng: np.random.Generator
) -> tuple[Effect, ...]:
    """Sample an arm with all sources of a case; errors of tool frames apply to this tool."""
    effects: list[Effect] = []
    for name, factor in case.sources.items():
        effects.extend(sample_source(model.source[name], factor, tool, rng))
    return tuple(effects)


def sample_source(
    source: ErrorSource, factor: float, tool: str, rng: np.random.Generator
) -> Iterator[Effect]:
    """Sample the effects of one source with a factor of its magnitude.

    Backlash without compensation keeps its width. With compensation, the factor is the error of the width.
    """
    theta, share = factor * source.theta, factor * source.share_by_frame
    match source.effect:
        case "frame error":
            for frame in _frames(theta):
                yield FrameError(
                    frame,
                    row6(theta[:, frame] * sample_errors(source.distribution, 6, rng)),
                    _tool_of(frame, tool),
                )
        case "frame play":
            for frame in _frames(theta):
                yield FramePlay(frame, row6(theta[:, frame]), _tool_of(frame, tool))
        case "servo error":
            yield from (ServoError(joint, float(theta[Z_TURN, joint])) for joint in Joint)
        case "windup":
            yield from (Windup(joint, float(theta[Z_TURN, joint])) for joint in Joint)
        case "hardstop angle":
            shift = theta[Z_TURN, : len(Joint)] * sample_errors(source.distribution, len(Joint), rng)
            yield from (HardstopAngle(joint, float(shift[joint])) for joint in Joint)
        case "backlash":
            width_factor = 1 + factor * sample_errors(source.distribution, len(Joint), rng) * is_compensated(
                factor
            )
            yield from (BacklashWidth(joint, float(width_factor[joint])) for joint in Joint)
        case "stiffness":
            stiffness_factor = 1 / (1 + share[:5] * sample_errors(source.distribution, len(Joint), rng))
            for joint in [joint for joint in Joint if share[joint]]:
                yield LinkStiffness(Frame(joint), float(stiffness_factor[joint]))
                yield GearStiffness(joint, float(stiffness_factor[joint]))
        case "warming":
            yield StructureTemperature(WARM_C - source.warming_K)
            expansion = 1 + share * sample_errors(source.distribution, len(Frame), rng)
            yield from (Expansion(frame, float(expansion[frame]), _tool_of(frame, tool)) for frame in Frame)


def sample_errors(distribution: Distribution, count: int, rng: np.random.Generator) -> Array:
    """Sample errors of magnitude 1, (count,)."""
    match distribution:
        case "normal":
            return rng.standard_normal(count) / 3
        case "uniform":
            return rng.uniform(-1.0, 1.0, count)
        case "either side":
            return rng.choice([-1.0, 1.0], count)


def _frames(theta: Array) -> list[Frame]:
    return [frame for frame in Frame if theta[:, frame].any()]


def _tool_of(frame: Frame, tool: str) -> str | None:
    return tool if frame is Frame.TOOL else None


def run_trial(
    model: ErrorModel,
    case: BudgetCase,
    built: str | None,
    params: Params,
    places: int,
    move_model: MoveModel,
    seed: np.random.SeedSequence,
) -> list[MeasuredPlacement]:
    """Measure an arm at random placements.

    Args:
        built: Name of a built arm, which was initialised at its hardstops. It has errors of its own, and
            those that the case adds. None for an arm with all sources, initialised without errors.

    Raises:
        RuntimeError: The arm was not initialised, or a move in the closed loop failed.
    """
    sample_seed, placement_seed = seed.spawn(2)
    rng = np.random.default_rng(sample_seed)
    tool = params.tool_names[int(rng.integers(len(params.tools)))]
    backlash: BacklashMode = "on"
    if built is None:
        tested = initialised = BuiltArm("drawn", sample_effects(model, case, tool, rng), params)
        backlash = "on" if is_compensated(case.sources.get("backlash", 0.0)) else "off"
    else:
        added = {name: factor for name, factor in case.sources.items() if name not in ARM_SOURCES}
        cold = Ambient(float(rng.uniform(*RANDOM_TEMPERATURE_C)))
        initialised = arm_named(built, params)
        effects = sample_effects(model, replace(case, sources=added), tool, rng)
        tested = replace(initialised, effects=(*initialised.effects, *effects, cold))
    believed = configure_believed(tested)
    if move_model == "statics":
        move = statics_model(tested, believed, backlash)
    else:
        reference = initial_reference(initialised) if built else true_reference(initialised)
        if built is None:  # an initialisation without errors, with the nominal backlash
            nominal = configure(initialised.params)
            reference = replace(reference, half_backlash_rad=nominal.half_backlash_rad)
        move = closed_loop_model(tested, reference, backlash)
    return measure_placements(move, random_placements(believed, tool, places, placement_seed))
