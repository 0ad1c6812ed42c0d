"""Where the arm rests by statics, with any effects: the turret's pose, and outputs against motors.

Motors are where encoders say. Each output is dragged along in its gear from one knot of the motors' way
to the next, as friction lets it (fsw.estimate.gear); nothing is stepped.
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
from sim.params import nominal_params
from sim.plant import Plant
from sim.world import World, build

MEAN_TICKS = CYCLE_HZ // 4
"""Resolvers are averaged over the end of a rest."""


@dataclass(frozen=True, slots=True, eq=False)
class TurningPoints:
    """Where motors turned or rested in one recording, k of them; those at rest are looked at."""

    recording: Recording
    motor_rad: Array
    """By encoders and believed zeros, (5, k)."""
    tick: tuple[int, ...]
    rests: tuple[int, ...]
    """Which knots are rests, ascending."""


@dataclass(frozen=True, slots=True, eq=False)
class RestPoses:
    """What statics say of the rests of one recording, r of them."""

    resolver_rad: Array
    """Resolvers less motor angles by encoders, (5, r)."""
    X_RF: Pose
    """The turret's interface in RMECH, batch (r,)."""


STEPPED_EFFECTS: Final = (GearHysteresis, Numerics)
"""Effects that statics cannot have: friction within a gear takes its output along, and how a plant creeps
hangs on how it is computed. The arm is stepped."""
NO_RESTS: Final = RestPoses(np.zeros((len(Joint), 0)), no_tracker_poses().X_RF)
"""Of a recording in which the arm never rests."""


def find_turning_points(recording: Recording) -> TurningPoints:
    """The rests, and where motions end and begin."""
    rests = find_rests(recording)
    turns = {tick for s in find_segments(recording) for tick in (s.first, s.end - 1)}
    ticks = sorted({*rests, *turns})
    motor = recording.motor_rad()[:, ticks]
    return TurningPoints(recording, motor, tuple(ticks), tuple(ticks.index(tick) for tick in rests))


def read_resolvers(knots: TurningPoints) -> Array:
    """The same of the sensors as they were recorded, (5, r)."""
    recording = knots.recording
    ends = [knots.tick[k] + 1 for k in knots.rests]
    apart = recording.sensors["resolver_rad"].T - recording.motor_rad()
    means = [apart[:, max(end - MEAN_TICKS, 0) : end].mean(axis=1) for end in ends]
    return np.stack(means, axis=-1) if means else NO_RESTS.resolver_rad


def solve_rests(knots: Sequence[TurningPoints], effects: Sequence[Effect]) -> list[RestPoses]:
    """The rests of each recording, of the arm of the drawing with these effects."""
    if any(isinstance(effect, STEPPED_EFFECTS) for effect in effects):
        return [_simulate_rests(one, effects) if one.rests else NO_RESTS for one in knots]
    hardware, params = nominal_hardware(), nominal_params()
    for effect in effects:
        before = hardware.counter_zero_rad
        hardware = effect.on_hardware(hardware)
        if np.array_equal(before, hardware.counter_zero_rad):
            params = effect.on_params(params)
        # else flight software's word for the shifted zero is a turned link: one of both is enough
    config = configure(params)
    return [_solve_statics(one, config, hardware, effects) if one.rests else NO_RESTS for one in knots]


def _simulate_rests(knots: TurningPoints, effects: Sequence[Effect]) -> RestPoses:
    """Under the recorded drive, without noise."""
    recording = knots.recording
    ticks = [knots.tick[k] for k in knots.rests]
    found = simulate_open_loop(recording, effects, pose_ticks=frozenset(ticks))
    apart = []
    for reading in (found.readings[tick] for tick in ticks):
        motor = reading.encoder_count * recording.rad_per_count + recording.start.zero_rad
        apart.append(reading.resolver_rad - motor)
    return RestPoses(np.stack(apart, -1), stack_poses([found.X_RF[tick] for tick in ticks]))


def _solve_statics(
    knots: TurningPoints, config: Config, hardware: Hardware, effects: Sequence[Effect]
) -> RestPoses:
    recording = knots.recording
    gravity = recording.world.gravity_N_m_s2
    off_rad = recording.start.hardstop_rad - config.hardstop_rad
    lost_rad = nominal_hardware().counter_zero_rad - hardware.counter_zero_rad
    motor = knots.motor_rad - (off_rad + lost_rad)[:, None]
    plant = _plant_with(recording.world, tuple(effects)) if hardware.each_cycle else None
    half = config.half_gap_rad
    load = settle_output(config.arm, motor, gravity).torque_Nm
    gear, driven = np.zeros(5), motor[:, 0]
    outputs = np.zeros_like(motor)
    for k, at in enumerate(motor.T):
        hardware, more = (hardware, NO_DISTURBANCE) if plant is None else _act_at(plant, hardware, at, gear)
        before, driven = driven, at + more.gear_rad
        bounds = bound_gear(config, half, load[:, k] + more.output_Nm)
        gear = np.clip(gear - (driven - before), bounds.lowest_rad, bounds.highest_rad)
        outputs[:, k] = driven + gear
    at_rest = list(knots.rests)
    outputs = outputs[:, at_rest]
    frames = settle_output(config.arm, outputs, gravity).frames
    resolver = outputs + hardware.resolver_bias_rad[:, None]
    for error in hardware.resolver_errors:
        resolver += np.stack([error.error_rad(output) for output in outputs.T], axis=-1)
    return RestPoses(resolver - knots.motor_rad[:, at_rest], frames.X_RF[5])


@lru_cache(maxsize=4)
def _plant_with(world: World, effects: tuple[Effect, ...]) -> Plant:
    """What effects ask; of the recordings of a campaign many are of one world."""
    spec = build(world)
    for effect in effects:
        effect.on_model(spec)
    return Plant(spec.compile())


def _act_at(
    plant: Plant, hardware: Hardware, motor_rad: Array, gear_rad: Array
) -> tuple[Hardware, Disturbance]:
    """What acts in every cycle, asked at a knot: how far it shifts gears, and its torque on outputs."""
    plant.data.qpos[plant.at.motor], plant.data.qpos[plant.at.gear] = motor_rad, gear_rad
    return evaluate_cycle_effects(plant, hardware)
