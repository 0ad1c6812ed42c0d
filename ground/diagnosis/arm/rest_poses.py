"""Rest poses by static equilibrium with any effects: turret poses, and outputs relative to motors.

Motors are at their encoder angles. Friction drags each output within its gear from one turning point of the
motor to the next (fsw.estimate.gear). No dynamics are simulated, except for STEPPED_EFFECTS.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, Config, configure
from fsw.dictionary.enums import Joint
from fsw.estimate.gear import bound_gear
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, stack_poses
from ground.diagnosis.arm.logs import Recording
from ground.diagnosis.arm.open_loop import simulate_open_loop
from ground.diagnosis.arm.segments import find_rests, find_segments
from ground.diagnosis.arm.tracker_poses import no_tracker_poses
from sim.disturbance import NO_DISTURBANCE, Disturbance
from sim.effects.effect import Effect, Hardware, evaluate_cycle_effects, nominal_hardware
from sim.effects.gears import GearHysteresis
from sim.effects.numerics import Numerics
from sim.effects.structure import LinkCreep
from sim.open_loop import scale_shift_rad
from sim.params import nominal_params
from sim.plant import Plant
from sim.world import World, build

MEAN_TICKS = CYCLE_HZ // 4
"""Number of ticks at the end of a rest over which resolvers are averaged."""
STEPPED_EFFECTS: Final = (GearHysteresis, LinkCreep, Numerics)
"""Effects that need dynamic simulation: hysteresis inside a gear, creep of a link, and numerics that
influence creep."""


@dataclass(frozen=True, slots=True, eq=False)
class TurningPoints:
    """Turning points and rests of the motors in one recording, k of them."""

    recording: Recording
    motor_rad: Array
    """Motor angles by encoders and reference zeros, shape (5, k)."""
    tick: tuple[int, ...]
    rests: tuple[int, ...]
    """Indices of the rests among the turning points, ascending."""


@dataclass(frozen=True, slots=True, eq=False)
class RestPoses:
    """Equilibria of the r rests of one recording."""

    resolver_rad: Array
    """Resolvers minus motor angles by encoders, shape (5, r)."""
    X_RF: Pose
    """Pose of the turret interface in RMECH, batch (r,)."""


NO_RESTS: Final = RestPoses(np.zeros((len(Joint), 0)), no_tracker_poses().X_RF)
"""Result for a recording without rests."""


def find_turning_points(recording: Recording) -> TurningPoints:
    """Find the rests, and the starts and ends of motions."""
    rests = find_rests(recording)
    turns = {tick for s in find_segments(recording) for tick in (s.first, s.end - 1)}
    ticks = sorted({*rests, *turns})
    motor = recording.motor_rad()[:, ticks]
    return TurningPoints(recording, motor, tuple(ticks), tuple(ticks.index(tick) for tick in rests))


def read_resolvers(turning_points: TurningPoints) -> Array:
    """Compute the recorded resolvers minus motor angles at the rests.

    Args:
        turning_points: Turning points of a recording with r rests.

    Returns:
        Differences in rad, shape (5, r).
    """
    recording = turning_points.recording
    ends = [turning_points.tick[k] + 1 for k in turning_points.rests]
    difference_rad = recording.sensors["resolver_rad"].T - recording.motor_rad()
    means = [difference_rad[:, max(end - MEAN_TICKS, 0) : end].mean(axis=1) for end in ends]
    return np.stack(means, axis=-1) if means else NO_RESTS.resolver_rad


def solve_rests(turning_points: Sequence[TurningPoints], effects: Sequence[Effect]) -> list[RestPoses]:
    """Solve the equilibria of each recording, for the nominal arm with these effects."""
    if any(isinstance(effect, STEPPED_EFFECTS) for effect in effects):
        return [_simulate_rests(one, effects) if one.rests else NO_RESTS for one in turning_points]
    hardware, params = nominal_hardware(), nominal_params()
    for effect in effects:
        before = hardware.counter_zero_rad
        hardware = effect.on_hardware(hardware)
        if np.array_equal(before, hardware.counter_zero_rad):
            params = effect.on_params(params)
        # else the effect is applied once, as hardware: on_params would apply the shifted zero again
    config = configure(params)
    return [
        _solve_statics(one, config, hardware, effects) if one.rests else NO_RESTS for one in turning_points
    ]


def _simulate_rests(turning_points: TurningPoints, effects: Sequence[Effect]) -> RestPoses:
    """Simulate the rests under the recorded drive, without noise."""
    recording = turning_points.recording
    ticks = [turning_points.tick[k] for k in turning_points.rests]
    found = simulate_open_loop(recording, effects, pose_ticks=frozenset(ticks))
    differences_rad = []
    for reading in (found.readings[tick] for tick in ticks):
        motor = reading.encoder_count * recording.rad_per_count + recording.start.zero_rad
        differences_rad.append(reading.resolver_rad - motor)
    return RestPoses(np.stack(differences_rad, -1), stack_poses([found.X_RF[tick] for tick in ticks]))


def _solve_statics(
    turning_points: TurningPoints, config: Config, hardware: Hardware, effects: Sequence[Effect]
) -> RestPoses:
    recording = turning_points.recording
    gravity = recording.world.gravity_N_m_s2
    hardstop_error_rad = recording.start.hardstop_rad - config.hardstop_rad
    counter_error_rad = nominal_hardware().counter_zero_rad - hardware.counter_zero_rad
    motor = turning_points.motor_rad - (hardstop_error_rad + counter_error_rad)[:, None]
    motor += scale_shift_rad(hardware, turning_points.motor_rad, recording.start.hardstop_rad)
    plant = _plant_with(recording.world, tuple(effects)) if hardware.each_cycle else None
    half_backlash_rad = config.half_backlash_rad
    load = settle_output(config.arm, motor, gravity).torque_Nm
    gear, driven = np.zeros(5), motor[:, 0]
    outputs = np.zeros_like(motor)
    for k, motor_rad in enumerate(motor.T):
        hardware, disturbance = (
            (hardware, NO_DISTURBANCE) if plant is None else _act_at(plant, hardware, motor_rad, gear)
        )
        before, driven = driven, motor_rad + disturbance.gear_rad
        bounds = bound_gear(config, half_backlash_rad, load[:, k] + disturbance.output_Nm)
        gear = np.clip(gear - (driven - before), bounds.lowest_rad, bounds.highest_rad)
        outputs[:, k] = driven + gear
    at_rest = list(turning_points.rests)
    outputs = outputs[:, at_rest]
    frames = settle_output(config.arm, outputs, gravity).frames
    resolver = outputs + hardware.resolver_bias_rad[:, None]
    for error in hardware.resolver_errors:
        resolver += np.stack([error.error_rad(output) for output in outputs.T], axis=-1)
    return RestPoses(resolver - turning_points.motor_rad[:, at_rest], frames.X_RF[5])


@lru_cache(maxsize=4)
def _plant_with(world: World, effects: tuple[Effect, ...]) -> Plant:
    """Build the plant with effects; recordings of a campaign often share a world."""
    spec = build(world)
    for effect in effects:
        effect.on_model(spec)
    return Plant(spec.compile())


def _act_at(
    plant: Plant, hardware: Hardware, motor_rad: Array, gear_rad: Array
) -> tuple[Hardware, Disturbance]:
    """Evaluate the effects of a cycle at a pose: new hardware, gear shifts and output torques."""
    plant.data.qpos[plant.at.motor], plant.data.qpos[plant.at.gear] = motor_rad, gear_rad
    return evaluate_cycle_effects(plant, hardware)
