"""Features of all recordings of a campaign: their list, their measured values and their simulated values.

Features of motions come from sensor readings bin by bin (`features`). Features of rests come from static
equilibrium (`rest_poses`): resolver angles, and turret poses as screws relative to nominal. The noise floor
is that of repeats. A touch says how high the tool is over the surface, as the session describes it.

In all functions, features and their changes are arrays (m,) in the units of their channels.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.enums import Joint
from fsw.kinematics.chain import joint_jacobian
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose, inverse, rotate_back
from fsw.messages import Sensors
from marsarm.diagnosis.arm import rest_poses
from marsarm.diagnosis.arm.contact import PressFeature, TouchFeature, list_presses, list_touches
from marsarm.diagnosis.arm.features import (
    ASSUMED_SIGMA,
    CHANNELS,
    RESOLVER,
    ROTATION,
    TRANSLATION,
    UNITS,
    Feature,
    MotionFeatures,
    SensorColumns,
    evaluate_features,
    list_motion_features,
    name_channel,
    still,
)
from marsarm.diagnosis.arm.logs import Recording
from marsarm.diagnosis.problem import CONDITIONS, FeatureLayout
from sim.arm_model.load import ArmModel
from sim.effects.effect import Effect, Hardware, apply_sensor_errors, nominal_hardware, params_with_effects
from sim.effects.environment import FARTHEST_SURFACE_M, SurfacePosition
from sim.effects.gears import OutputFriction
from sim.plant import SCREW_AXES
from simgap import screw_log

READING_FIELDS: Final = frozenset({"resolver_bias_rad", "resolver_errors", "sensor_errors"})
"""Fields of the hardware that influence only readings."""
FRICTION_MARGIN: Final = 0.3
"""Change of the output friction, as a share, for the sensitivity of rests to friction. Near the friction
limit, the side of the backlash is ambiguous."""
MIN_PAIRS: Final = 8
"""Least number of pairs of repeats that estimate the noise floor of a channel."""
DOUBT_SIGMAS: Final = 3.0
"""Doubt above this many sigmas of the noise is added to the noise floor."""


@dataclass(frozen=True, slots=True, eq=False)
class RestFeatures:
    """Rests of one recording, their nominal equilibrium, and those with a tracker pose."""

    turning_points: rest_poses.TurningPoints
    nominal: rest_poses.RestPoses
    tracked: list[int]
    """Indices of the rests with a tracker pose."""
    poses: list[int]
    """Index of each of them among the tracker poses."""
    features: tuple[Feature, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """Features of a campaign's recordings: the motions first, then rests, touches and presses."""

    motions: tuple[MotionFeatures, ...]
    rests: tuple[RestFeatures, ...]
    touches: tuple[TouchFeature, ...] = ()
    presses: tuple[PressFeature, ...] = ()

    @property
    def n_moving(self) -> int:
        """Number of features of the motions."""
        return sum(len(one.features) for one in self.motions)

    @property
    def arm(self) -> ArmModel:
        """Drawing of the arm."""
        return (self.motions[0].recording if self.motions else self.rests[0].turning_points.recording).arm

    def list_features(self) -> tuple[Feature, ...]:
        """List the features of the motions, of the rests, the touches and the presses."""
        return (
            *(feature for one in self.motions for feature in one.features),
            *(feature for one in self.rests for feature in one.features),
            *(one.feature for one in self.touches),
            *(one.feature for one in self.presses),
        )


def build_feature_set(recordings: Sequence[Recording]) -> FeatureSet:
    """List the features: rests in free air, and motions without tracker poses or with a surface."""
    config = configure(recordings[0].arm.params)
    every = (rest_poses.find_turning_points(one) for one in recordings if one.world.surface is None)
    turning_points = [one for one in every if one.rests]
    moving = [one for one in recordings if one.world.surface or not one.tracker_poses.tick.size]
    step_Nm = (FRICTION_MARGIN * config.output_friction_Nm).tolist()
    frictions = ([OutputFriction(joint, by * step_Nm[joint]) for joint in Joint] for by in (0.0, -1.0, 1.0))
    nominal, less, more = (rest_poses.solve_rests(turning_points, some) for some in frictions)
    found = FeatureSet(
        tuple(list_motion_features(one, config) for one in moving),
        tuple(_list_rest_features(*one) for one in zip(turning_points, nominal, less, more, strict=True)),
        tuple(list_touches(recordings)),
    )
    # a switch that closes farther above the surface than any surface may be did not touch it
    is_near = simulate_touches(found, ()) <= FARTHEST_SURFACE_M
    near = tuple(one for one, is_one in zip(found.touches, is_near, strict=True) if is_one)
    return replace(found, touches=near, presses=tuple(list_presses(near)))


def simulate_touches(feature_set: FeatureSet, effects: Sequence[Effect]) -> Array:
    """Compute the heights of tools over the surface at touches, then the ways of presses [m], shape (t,)."""
    shift_m = sum(effect.offset_m for effect in effects if isinstance(effect, SurfacePosition))
    X_FT = configure(params_with_effects(tuple(effects), feature_set.arm.params)).arm.X_FT
    found = []
    rests = rest_poses.solve_rests([one.turning_points for one in feature_set.touches], effects)
    for one, rest in zip(feature_set.touches, rests, strict=True):
        found.append(one.find_height(rest.X_RF[0] @ X_FT[one.tool]) - shift_m)
    return np.array([*found, *(one.predict(effects) for one in feature_set.presses)])


def measure_features(feature_set: FeatureSet) -> Array:
    """Compute the measured features."""
    values = [evaluate_features(one, one.recording.sensors) for one in feature_set.motions]
    for one in feature_set.rests:
        X_RF = one.turning_points.recording.tracker_poses.X_RF[one.poses]
        values.append(_rest_values(one, rest_poses.read_resolvers(one.turning_points), X_RF))
    ways_m = [one.measured_m for one in feature_set.presses]
    return np.concatenate([*values, np.zeros(len(feature_set.touches)), ways_m])


def simulate_features(
    feature_set: FeatureSet,
    effects: Sequence[Effect],
    wanted: Callable[[MotionFeatures], bool] = lambda _: True,
) -> Array:
    """Predict the features.

    Repeats of a motion have those of the first one. They are NaN for motions that are not wanted, and where
    the first repeat lacks them. PlantDiverged if MuJoCo counted a warning.
    """
    known: dict[str, dict[str, float]] = {}
    for one in feature_set.motions:
        if one.recording.block not in known:
            found = evaluate_features(one, simulate_motion(one, effects)) if wanted(one) else ()
            known[one.recording.block] = {f.key: v for f, v in zip(one.features, found, strict=False)}
    values = [
        np.array([known[one.recording.block].get(feature.key, np.nan) for feature in one.features])
        for one in feature_set.motions
    ]
    rests = rest_poses.solve_rests([one.turning_points for one in feature_set.rests], effects)
    values += [_static_values(one, found) for one, found in zip(feature_set.rests, rests, strict=True)]
    return np.concatenate([*values, simulate_touches(feature_set, effects)])


def simulate_motion(motion: MotionFeatures, effects: Sequence[Effect]) -> SensorColumns:
    """Simulate the sensors of an arm with these effects under the recorded drive, without noise, by tick.

    What follows the last compared bin is left out: the end of every motion, and all from a touch on.
    """
    readers = [effect for effect in effects if changes_readings_only(effect)]
    acting = tuple(effect for effect in effects if effect not in readers)
    simulate = rest_poses.simulate_open_loop_cached if readers else rest_poses.simulate_open_loop
    readings, _ = simulate(motion.recording, acting, ticks=motion.compared_ticks)
    return rest_poses.stack_readings(list(_apply_readers(readings, readers)) if readers else readings)


def changes_readings_only(effect: Effect) -> bool:
    """Check that an effect changes only readings, so that the plant need not be simulated again."""
    if type(effect).on_model is not Effect.on_model:
        return False
    before = nominal_hardware()
    after = effect.on_hardware(before)
    other = {f.name for f in fields(Hardware) if getattr(before, f.name) is not getattr(after, f.name)}
    return bool(other) and other <= READING_FIELDS


def _apply_readers(readings: Sequence[Sensors], readers: Sequence[Effect]) -> Iterator[Sensors]:
    """Yield the readings that avionics with these effects would sense, without noise."""
    hardware, rng = nominal_hardware(), np.random.default_rng(0)
    for effect in readers:
        hardware = effect.on_hardware(hardware)
    sensor_errors = hardware.sensor_errors
    for one in readings:
        resolver_rad = one.resolver_rad + hardware.resolver_bias_rad
        for error in hardware.resolver_errors:
            resolver_rad = resolver_rad + error.error_rad(one.resolver_rad)
        read = replace(one, resolver_rad=resolver_rad)
        sensors, sensor_errors = apply_sensor_errors(sensor_errors, read, rng)
        yield sensors


def _list_rest_features(
    turning_points: rest_poses.TurningPoints, nominal: rest_poses.RestPoses, *others: rest_poses.RestPoses
) -> RestFeatures:
    """List the features of rests; `doubt` is their change with a little more or less output friction."""
    recording = turning_points.recording
    rest_of = {turning_points.tick[k]: r for r, k in enumerate(turning_points.rests)}
    ticks = recording.tracker_poses.tick.tolist()
    poses = [k for k, tick in enumerate(ticks) if tick in rest_of]
    tracked = [rest_of[ticks[k]] for k in poses]
    features: list[Feature] = []
    for joint in Joint:
        for r, k in enumerate(turning_points.rests):
            angle = float(turning_points.motor_rad[joint, k])
            condition = (recording.temperature_C, 0.0, 0.0, float(np.sin(angle)), float(np.cos(angle)), 0.0)
            name = joint.name.lower()
            time_s, key = turning_points.tick[k] / CYCLE_HZ, f"rest {r}/{name}"
            features.append(Feature(recording, RESOLVER, name, "rest", condition, key, time_s=time_s))
    for axis, named in enumerate(SCREW_AXES):
        channel = ROTATION if axis < 3 else TRANSLATION
        for r, k in zip(tracked, poses, strict=True):
            sigma, time_s = float(recording.tracker_poses.sigma[axis, k]), ticks[k] / CYCLE_HZ
            about = recording, channel, "turret", "pose", still(recording), f"rest {r}/{named}"
            features.append(Feature(*about, sigma=sigma, time_s=time_s))
    found = RestFeatures(turning_points, nominal, tracked, poses, tuple(features))
    without, *with_others = (_static_values(found, one) for one in (nominal, *others))
    doubts = np.abs([one - without for one in with_others]).max(axis=0).tolist()
    doubted = (replace(feature, doubt=by) for feature, by in zip(features, doubts, strict=True))
    return replace(found, features=tuple(doubted))


def _static_values(one: RestFeatures, found: rest_poses.RestPoses) -> Array:
    return _rest_values(one, found.resolver_rad, found.X_RF[one.tracked])


def _rest_values(one: RestFeatures, resolver_rad: Array, X_RF: Pose) -> Array:
    screw = screw_log(inverse(one.nominal.X_RF[one.tracked]) @ X_RF) if one.tracked else np.zeros((6, 0))
    return np.concatenate([resolver_rad.ravel(), screw.ravel()])


def rests_moved_by(feature_set: FeatureSet, change: Array, joint: Joint, turns: bool = True) -> Array:
    """Return the part of a change that one joint alone makes at rests, where all joints turn.

    That is the change of its resolver, and of the poses to first order by the turn that the resolver shows;
    0 elsewhere. If the joint does not turn, only the reading of its resolver changes.
    """
    config = configure(feature_set.arm.params)
    found, begin = np.zeros_like(change), feature_set.n_moving
    for one in feature_set.rests:
        n_rests, n_tracked = len(one.turning_points.rests), len(one.tracked)
        own = slice(begin + joint * n_rests, begin + (joint + 1) * n_rests)
        found[own] = change[own]
        if n_tracked and turns:
            motor_rad = one.turning_points.motor_rad[:, [one.turning_points.rests[r] for r in one.tracked]]
            gravity = one.turning_points.recording.world.gravity_N_m_s2
            frames = settle_output(config.arm, motor_rad, gravity).frames
            X_RF = frames.X_RF[5]
            screw_R = joint_jacobian(frames, X_RF.p)[:, joint] * change[own][one.tracked]
            parts = [rotate_back(X_RF.R, half) for half in (screw_R[:3], screw_R[3:])]
            first = begin + len(Joint) * n_rests
            found[first : first + 6 * n_tracked] = np.concatenate(parts).ravel()
        begin += len(one.features)
    return found


def lay_out(feature_set: FeatureSet) -> tuple[FeatureLayout, tuple[str, ...]]:
    """Return the layout of features with their noise floor, and notes on its origin.

    Every place has its own channels. The floor is estimated by channel from repeats; it is never below the
    assumed sensor noise.
    """
    features, values = feature_set.list_features(), measure_features(feature_set)
    sigma = np.array([ASSUMED_SIGMA[one.channel] if one.sigma is None else one.sigma for one in features])
    known: dict[tuple[str, str], int] = {}
    pairs: list[tuple[int, int]] = []
    for k, feature in enumerate(features):
        first = known.setdefault((feature.recording.block, feature.key), k)
        if first != k:
            pairs.append((first, k))
    doubt = np.array([feature.doubt for feature in features])
    doubted = doubt > DOUBT_SIGMAS * sigma
    notes = []
    channel = np.array([feature.channel for feature in features])
    for number, name in enumerate(CHANNELS):
        mine = [(a, b) for a, b in pairs if features[a].channel == number and not doubted[a]]
        if not (channel == number).any():
            continue
        if len(mine) < MIN_PAIRS:
            notes.append(f"{name}: {len(mine)} repeats, so its floor is assumed to be the sensors' noise")
            continue
        a, b = np.array(mine).T
        ratio = float(np.sqrt(np.mean(((values[a] - values[b]) / sigma[a]) ** 2) / 2.0))
        sigma[channel == number] *= max(ratio, 1.0)
        notes.append(f"{name}: {len(mine)} pairs of repeats differ by {ratio:.2f} times the sensors' noise")
    if doubted.any():
        notes.append(
            f"{int(doubted.sum())} of {doubted.size} features have little weight: the arm rests near the "
            f"friction limit, a joint has not yet turned through its backlash, or a tool is about to touch"
        )
    layout = FeatureLayout(
        sigma=np.where(doubted, np.hypot(sigma, doubt), sigma),
        block=np.array([one.recording.block for one in features], str),
        channel=np.array([name_channel(one.place, one.channel) for one in features], str),
        unit=np.array([UNITS[one.channel] for one in features], str),
        regime=np.array([one.regime for one in features], str),
        condition=np.array([one.condition for one in features]).reshape(-1, len(CONDITIONS)),
        time_s=np.array([one.time_s for one in features], float),
        key=np.array([f"{one.recording.name}/{one.key}" for one in features], str),
    )
    return layout, tuple(notes)
