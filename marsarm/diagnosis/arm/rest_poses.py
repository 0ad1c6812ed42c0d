"""Rest poses by static equilibrium with any effects: turret poses, and outputs relative to motors.

Motors are at their encoder angles. Friction drags each output within its gear from one turning point of the
motor to the next (fsw.estimate.gear). A link that creeps bends further by a share of its load that follows
from the times between turning points. No dynamics are simulated, except for what `is_stepped` tells.

In all functions, `motor` are true motor angles [rad], and `load_Nm` torques of the load, at k turning points,
(5, k).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, Config, configure
from fsw.estimate.gear import bound_gear
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, inverse, screw_exp, stack_poses
from fsw.messages import Sensors
from marsarm.diagnosis.arm.features import SensorColumns
from marsarm.diagnosis.arm.logs import BIN_TICKS, Recording, find_rests, find_segments
from sim.arm_model.load import ArmModel
from sim.arms import effects_of_run
from sim.effects.effect import Effect, Hardware, evaluate_cycle_effects, nominal_hardware
from sim.effects.environment import Ambient, Numerics, StructureTemperature
from sim.effects.gears import GearHysteresis
from sim.effects.structure import LinkBending, LinkCreep
from sim.loop import OpenLoopArm, scale_shift_rad
from sim.plant import Plant
from sim.setting import World
from sim.tracker import turret_pose
from sim.world import build
from simgap import screw_log

STEP_NUMERICS: Final = Numerics("implicit", 2)
"""Numerics whose rests are simulated: those of other time steps and schemes agree with them to a hundredth of
the noise floor, and take three times as long."""


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


def is_stepped(effect: Effect) -> bool:
    """Check that rests with an effect need a dynamic simulation: hysteresis inside a gear, or numerics."""
    return isinstance(effect, GearHysteresis) or effect == STEP_NUMERICS


def find_turning_points(recording: Recording, touch: int | None = None) -> TurningPoints:
    """Find the rests, and the starts and ends of motions; with a touch, those before, and it as the rest."""
    rests = find_rests(recording) if touch is None else [touch]
    turns = {tick for s in find_segments(recording) for tick in (s.first, s.end - 1)}
    ticks = [tick for tick in sorted({*rests, *turns}) if touch is None or tick <= touch]
    motor = recording.motor_rad()[:, ticks]
    return TurningPoints(recording, motor, tuple(ticks), tuple(ticks.index(tick) for tick in rests))


def read_resolvers(turning_points: TurningPoints) -> Array:
    """Compute the recorded resolvers minus motor angles [rad], averaged over a bin, at the rests, (5, r)."""
    recording = turning_points.recording
    ends = [turning_points.tick[k] + 1 for k in turning_points.rests]
    difference_rad = recording.sensors["resolver_rad"].T - recording.motor_rad()
    means = [difference_rad[:, max(end - BIN_TICKS, 0) : end].mean(axis=1) for end in ends]
    return np.stack(means, axis=-1)


def solve_rests(turning_points: Sequence[TurningPoints], effects: Sequence[Effect]) -> list[RestPoses]:
    """Solve the equilibria of recordings with rests, for the drawing of their arm with these effects."""
    if not turning_points:
        return []
    creep = next((effect for effect in effects if isinstance(effect, LinkCreep)), None)
    if creep is not None:
        return _solve_creep(turning_points, creep, [effect for effect in effects if effect is not creep])
    if any(map(is_stepped, effects)):
        return [_simulate_rests(one, effects) for one in turning_points]
    arm = turning_points[0].recording.arm
    hardware, params = nominal_hardware(arm.description), arm.params
    for effect in effects:
        before = hardware.counter_zero_rad
        hardware = effect.on_hardware(hardware)
        if effect.built_in:  # homing has found the zeros, wherever the counters started
            hardware = replace(hardware, counter_zero_rad=before)
        if np.array_equal(before, hardware.counter_zero_rad):
            params = effect.on_params(params)
        # else the effect is applied once, as hardware: on_params would apply the shifted zero again
    return _solve_statics(turning_points, configure(params), hardware, effects)


def _solve_creep(
    turning_points: Sequence[TurningPoints], creep: LinkCreep, others: Sequence[Effect]
) -> list[RestPoses]:
    """Solve the equilibria with a creeping link: between those of the link and of one that has crept wholly.

    The bending of a link is linear in its load, so that the angle at a rest is a share of the whole one.
    """
    whole = LinkBending(creep.frame, creep.axis, creep.compliance_rad_Nm)
    every = [replace(one, rests=tuple(range(len(one.tick)))) for one in turning_points]
    before, after = (solve_rests(every, effects) for effects in (others, (*others, whole)))
    found = []
    for one, rigid, bent in zip(turning_points, before, after, strict=True):
        screw, at = screw_log(inverse(rigid.X_RF) @ bent.X_RF), list(one.rests)
        share = creep_shares(np.array(one.tick) / CYCLE_HZ, screw[:3], creep.time_s)[at]
        resolver_rad = rigid.resolver_rad[:, at]
        resolver_rad += share * (bent.resolver_rad[:, at] - resolver_rad)
        found.append(RestPoses(resolver_rad, rigid.X_RF[at] @ screw_exp(share * screw[:, at])))
    return found


def creep_shares(time_s: Array, angle_rad: Array, creep_s: float) -> Array:
    """Compute the share (k,) of its whole bending that a creeping link has; 0 without a load.

    The angle a follows creep_s a' = whole - a from 0 at time 0. The load, and with it the whole angle, is
    constant up to the first time and linear between times, (k,). The angle is a rotation, (3, k).
    """
    largest = angle_rad[:, int(np.argmax(np.sum(angle_rad**2, axis=0)))]
    whole = largest @ angle_rad
    shares, a, last_s, last = np.zeros(time_s.size), 0.0, 0.0, whole[0]
    for k, (now_s, now) in enumerate(zip(time_s, whole, strict=True)):
        span_s = now_s - last_s
        left = float(np.exp(-span_s / creep_s))
        # solution of the differential equation for a load that changes linearly
        a = a * left + now - last * left - (now - last) * creep_s / max(span_s, 1e-9) * (1.0 - left)
        shares[k] = a / now if now else 0.0
        last_s, last = now_s, now
    return shares


def _simulate_rests(turning_points: TurningPoints, effects: Sequence[Effect]) -> RestPoses:
    """Simulate the rests under the recorded drive, without noise."""
    recording = turning_points.recording
    ticks = [turning_points.tick[k] for k in turning_points.rests]
    readings, X_RF = simulate_open_loop(recording, effects, pose_ticks=frozenset(ticks), ticks=max(ticks) + 1)
    differences_rad = []
    for reading in (readings[tick] for tick in ticks):
        motor = reading.encoder_count * recording.rad_per_count + recording.start.zero_rad
        differences_rad.append(reading.resolver_rad - motor)
    return RestPoses(np.stack(differences_rad, -1), stack_poses([X_RF[tick] for tick in ticks]))


def _solve_statics(
    turning_points: Sequence[TurningPoints], config: Config, hardware: Hardware, effects: Sequence[Effect]
) -> list[RestPoses]:
    """Solve the equilibria of all recordings, which have one arm and one drawing, at once."""
    recordings = [one.recording for one in turning_points]
    start, drawing = recordings[0].start, recordings[0].arm.description
    seen = np.concatenate([one.motor_rad for one in turning_points], axis=1)
    sizes = [one.motor_rad.shape[1] for one in turning_points]
    gravity = np.repeat([one.world.gravity_N_m_s2 for one in recordings], sizes, axis=0).T
    hardstop_error_rad = start.hardstop_rad - config.hardstop_rad
    counter_error_rad = nominal_hardware(drawing).counter_zero_rad - hardware.counter_zero_rad
    motor = seen - (hardstop_error_rad + counter_error_rad)[:, None]
    motor += scale_shift_rad(hardware, seen, start.hardstop_rad, drawing)
    load = settle_output(config.arm, motor, gravity).torque_Nm
    ends = np.cumsum([0, *sizes])
    spans = [slice(*pair) for pair in pairwise(ends.tolist())]
    paths = [
        _drag_outputs(one, config, hardware, effects, motor[:, span], load[:, span])
        for one, span in zip(recordings, spans, strict=True)
    ]
    begins = zip(ends[:-1], turning_points, strict=True)
    rests = np.concatenate([begin + np.array(one.rests, int) for begin, one in begins])
    outputs = np.concatenate([path for path, _ in paths], axis=1)[:, rests]
    X_RF = settle_output(config.arm, outputs, gravity[:, rests]).frames.X_RF
    found, begin = [], 0
    for (_, hardware), one in zip(paths, turning_points, strict=True):
        here = slice(begin, begin := begin + len(one.rests))
        resolver = outputs[:, here] + hardware.resolver_bias_rad[:, None]
        for error in hardware.resolver_errors:
            resolver += np.stack([error.error_rad(output) for output in outputs[:, here].T], axis=-1)
        found.append(RestPoses(resolver - one.motor_rad[:, list(one.rests)], X_RF[5, here]))
    return found


def _drag_outputs(
    recording: Recording,
    config: Config,
    hardware: Hardware,
    effects: Sequence[Effect],
    motor: Array,
    load_Nm: Array,
) -> tuple[Array, Hardware]:
    """Drag each output within its gear from one turning point to the next.

    Return output angles [rad], (5, k), and the hardware after the last effect of a cycle.
    """
    plant = _plant_with(recording.arm, recording.world, tuple(effects)) if hardware.each_cycle else None
    half_backlash_rad = config.half_backlash_rad
    gear, driven, outputs = np.zeros(5), motor[:, 0], np.zeros_like(motor)
    bounds = bound_gear(config, half_backlash_rad, load_Nm)
    for k, motor_rad in enumerate(motor.T):
        low_rad, high_rad = bounds.lowest_rad[:, k], bounds.highest_rad[:, k]
        before, driven = driven, motor_rad
        if plant is not None:
            plant.data.qpos[plant.at.motor], plant.data.qpos[plant.at.gear] = motor_rad, gear
            hardware, disturbance = evaluate_cycle_effects(plant, hardware)
            driven = motor_rad + disturbance.gear_rad
            loaded = bound_gear(config, half_backlash_rad, load_Nm[:, k] + disturbance.output_Nm)
            low_rad, high_rad = loaded.lowest_rad, loaded.highest_rad
        gear = np.clip(gear - (driven - before), low_rad, high_rad)
        outputs[:, k] = driven + gear
    return outputs, hardware


@lru_cache(maxsize=4)
def _plant_with(arm: ArmModel, world: World, effects: tuple[Effect, ...]) -> Plant:
    """Build the plant with effects; recordings of a campaign often share a world."""
    spec = build(world, arm)
    for effect in effects:
        effect.on_model(spec)
    return Plant(spec.compile())


def simulate_open_loop(
    recording: Recording,
    effects: Sequence[Effect],
    pose_ticks: frozenset[int] = frozenset(),
    ticks: int | None = None,
) -> tuple[list[Sensors], dict[int, Pose]]:
    """Simulate an arm with these effects under the recorded drive, for some ticks, by default all.

    Return its readings, and the pose of the turret interface in RMECH after the cycles `pose_ticks`.
    PlantDiverged if MuJoCo counted a warning.
    """
    # temperatures follow the built-in effects, whose friction the cold changes
    built = (effect for effect in effects if effect.built_in)
    temperatures = (Ambient(recording.temperature_C), StructureTemperature(recording.structure_C))
    arm = OpenLoopArm(recording.start, (*built, *temperatures, *effects_of_run(effects)))
    readings: list[Sensors] = []
    poses: dict[int, Pose] = {}
    for reading in arm.readings(recording.drives[:ticks]):
        if len(readings) in pose_ticks:
            arm.plant.truth()  # updates the kinematics
            poses[len(readings)] = turret_pose(arm.plant)
        readings.append(reading)
    return readings, poses


simulate_open_loop_cached = lru_cache(maxsize=64)(simulate_open_loop)
"""The same, and runs that several effects share are kept."""


def stack_readings(readings: Sequence[Sensors]) -> SensorColumns:
    """Stack readings by field, ticks first."""
    return {name: np.array([getattr(one, name) for one in readings]) for name in Sensors.__dataclass_fields__}
