"""All recordings of a campaign as features: what they are, what was measured, what a simulator predicts."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array, Pose, inverse
from fsw.messages import Sensors
from ground.calibration.screws import screw_log
from ground.diagnosis.arm.features import RESOLVER, SHIFT, TURN, Columns, Feature, Moving, measured, moving
from ground.diagnosis.arm.logs import Recording
from ground.diagnosis.arm.poses import Knots, Resting, knots_in, read_resolvers, resting
from ground.diagnosis.arm.stepped import columns, stepped, stepped_once
from sim.effects.effect import Effect, Hardware, apply_sensor_errors, nominal_hardware
from sim.effects.gears import OutputFriction
from sim.open_loop import SimulationOptions
from sim.params import nominal_params
from sim.plant import SCREW_AXES

READ: Final = frozenset({"resolver_bias_rad", "resolver_errors", "sensor_errors"})
"""Of hardware, what nothing but readings hangs on."""
UNSURE: Final = 0.3
"""Share of the outputs' friction: a load so near to it may or may not have dragged an output over its gap."""


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """A recording's rests, what statics make of them by the drawing, and which of them the tracker saw."""

    knots: Knots
    nominal: Resting
    seen: tuple[tuple[int, int], ...]
    """Number among the rests, and among the tracker's poses."""
    features: tuple[Feature, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A campaign's recordings, ready to be compared: the moving ones, then the rests of all."""

    moving: tuple[Moving, ...]
    posed: tuple[Posed, ...]

    @property
    def features(self) -> tuple[Feature, ...]:
        """Of the moving recordings, then of the rests."""
        return (
            *(feature for one in self.moving for feature in one.features),
            *(feature for one in self.posed for feature in one.features),
        )

    @property
    def sessions(self) -> tuple[str, ...]:
        """The recording that each feature is of, by name."""
        return (
            *(one.recording.name for one in self.moving for _ in one.features),
            *(one.knots.recording.name for one in self.posed for _ in one.features),
        )


def compared(recordings: Sequence[Recording]) -> Compared:
    """Recordings with a tracker are looked at where they rest, the others in motion as well."""
    config = configure(nominal_params())
    knots = [knots_in(one) for one in recordings if one.world.surface is None]
    unsure_Nm = UNSURE * config.output_friction_Nm
    nominal, less, more = (resting(knots, _more_friction(by * unsure_Nm)) for by in (0.0, -1.0, 1.0))
    return Compared(
        tuple(moving(one, config) for one in recordings if not one.tracked.tick.size),
        tuple(_posed(*one) for one in zip(knots, nominal, less, more, strict=True)),
    )


def _more_friction(torque_Nm: Array) -> tuple[Effect, ...]:
    return tuple(OutputFriction(joint, float(torque_Nm[joint])) for joint in Joint)


def measured_values(campaign: Compared) -> Array:
    """What the logs say, (m,)."""
    values = [measured(one, one.recording.sensors) for one in campaign.moving]
    for one in campaign.posed:
        tracked = one.knots.recording.tracked
        values.append(
            _rest_values(one, read_resolvers(one.knots), _at(tracked.X_RF, [k for _, k in one.seen]))
        )
    return np.concatenate(values)


def all_of(_: Moving) -> bool:
    """Every moving recording."""
    return True


def none_of(_: Moving) -> bool:
    """Rests alone."""
    return False


def predicted_values(
    campaign: Compared,
    effects: Sequence[Effect],
    manner: SimulationOptions,
    wanted: Callable[[Moving], bool] = all_of,
) -> Array:
    """What the simulator has with these effects, (m,); NaN for moving recordings that are not wanted.

    Raises:
        PlantDiverged: MuJoCo counted a warning.
    """
    values = [
        measured(one, driven(one.recording, effects, manner))
        if wanted(one)
        else np.full(len(one.features), np.nan)
        for one in campaign.moving
    ]
    rests = resting([one.knots for one in campaign.posed], effects)
    values += [_by_statics(one, found) for one, found in zip(campaign.posed, rests, strict=True)]
    return np.concatenate(values)


def driven(recording: Recording, effects: Sequence[Effect], manner: SimulationOptions) -> Columns:
    """The sensors of an arm with these effects under the recorded drive, by tick; a manner without noise."""
    readers = [effect for effect in effects if only_reads(effect)]
    acting = tuple(effect for effect in effects if effect not in readers)
    readings = (stepped_once if readers else stepped)(recording, acting, manner).readings
    return columns(list(_reread(readings, readers)) if readers else readings)


def only_reads(effect: Effect) -> bool:
    """Whether it changes nothing but what is read: then the plant need not be stepped again."""
    if type(effect).on_model is not Effect.on_model:
        return False
    before = nominal_hardware()
    after = effect.on_hardware(before)
    other = {f.name for f in fields(Hardware) if getattr(before, f.name) is not getattr(after, f.name)}
    return bool(other) and other <= READ


def _reread(readings: Sequence[Sensors], readers: Sequence[Effect]) -> Iterator[Sensors]:
    """The same readings, without noise, as avionics with these effects would have sensed them."""
    hardware, rng = nominal_hardware(), np.random.default_rng(0)
    for effect in readers:
        hardware = effect.on_hardware(hardware)
    sensor_errors = hardware.sensor_errors
    for one in readings:
        sensors, sensor_errors = apply_sensor_errors(sensor_errors, _resolved(one, hardware), rng)
        yield sensors


def _resolved(sensors: Sensors, hardware: Hardware) -> Sensors:
    """Without noise a resolver reads its output, with what is wrong with it."""
    output_rad = sensors.resolver_rad
    resolver_rad = output_rad + hardware.resolver_bias_rad
    for error in hardware.resolver_errors:
        resolver_rad = resolver_rad + error.error_rad(output_rad)
    return replace(sensors, resolver_rad=resolver_rad)


def _posed(knots: Knots, nominal: Resting, *others: Resting) -> Posed:
    """Doubt is by how much a feature would differ if friction of the outputs were a little more or less."""
    recording = knots.recording
    rest_of = {knots.tick[k]: r for r, k in enumerate(knots.rests)}
    seen = tuple((rest_of[t], k) for k, t in enumerate(recording.tracked.tick.tolist()) if t in rest_of)
    features: list[Feature] = []
    for joint in Joint:
        for r, k in enumerate(knots.rests):
            angle = float(knots.motor_rad[joint, k])
            condition = (recording.temperature_C, 0.0, 0.0, float(np.sin(angle)), float(np.cos(angle)), 0.0)
            name = joint.name.lower()
            features.append(Feature(RESOLVER, name, "rest", recording.block, condition, f"rest {r}/{name}"))
    condition = (recording.temperature_C, 0.0, 0.0, 0.0, 0.0, 0.0)
    for axis, named in enumerate(SCREW_AXES):
        channel = TURN if axis < 3 else SHIFT
        for r, _ in seen:
            features.append(
                Feature(channel, "turret", "pose", recording.block, condition, f"rest {r}/{named}")
            )
    made = Posed(knots, nominal, seen, tuple(features))
    apart = np.abs([_by_statics(made, one) - _by_statics(made, nominal) for one in others]).max(axis=0)
    doubted = zip(features, apart, strict=True)
    return replace(made, features=tuple(replace(feature, doubt=float(by)) for feature, by in doubted))


def _by_statics(one: Posed, found: Resting) -> Array:
    return _rest_values(one, found.resolver_rad, _at(found.X_RF, [r for r, _ in one.seen]))


def _rest_values(one: Posed, resolver_rad: Array, X_RF: Pose) -> Array:
    nominal = _at(one.nominal.X_RF, [r for r, _ in one.seen])
    screw = screw_log(inverse(nominal) @ X_RF) if one.seen else np.zeros((6, 0))
    return np.concatenate([resolver_rad.ravel(), screw.ravel()])


def _at(X: Pose, rows: list[int]) -> Pose:
    return Pose(X.R[:, :, rows], X.p[:, rows])
