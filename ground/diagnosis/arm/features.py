"""What is compared of a recording in motion: the same numbers from recorded and from simulated sensors."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ, Config
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from ground.diagnosis.arm.logs import Recording
from ground.diagnosis.arm.segments import BIN_TICKS, Segment, bin_means, find_segments

CHANNELS: Final = ("current", "following", "resolver-encoder", "imu", "screw-turn", "screw-shift")
UNITS: Final = ("A", "rad", "rad", "m/s^2", "rad", "m")
CURRENT, FOLLOWING, RESOLVER, IMU, SCREW_TURN, SCREW_SHIFT = range(len(CHANNELS))
CONDITIONS: Final = ("temperature_C", "load_Nm", "speed_rad_s", "sin_angle", "cos_angle", "way")

SensorColumns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Feature:
    """One number that is compared."""

    channel: int
    place: str
    regime: str
    block: str
    condition: tuple[float, ...]
    key: str
    """What the same feature is called in every log of its session: motion, channel, number."""
    doubt: float = 0.0
    """One sigma of what nobody knows of it beside noise, in its channel's unit."""


def feature_channel(feature: Feature) -> str:
    """As people are told it: what was measured, and where."""
    return f"{feature.place} {CHANNELS[feature.channel]}"


@dataclass(frozen=True, slots=True, eq=False)
class MotionFeatures:
    """What is looked at of one recording, and where."""

    recording: Recording
    segments: tuple[Segment, ...]
    features: tuple[Feature, ...]


def list_motion_features(recording: Recording, config: Config) -> MotionFeatures:
    """Its features: three channels of every moving joint bin by bin before a tool touches, and the IMU."""
    segments, block = tuple(find_segments(recording)), recording.block
    features: list[Feature] = []
    for number, load_Nm in enumerate(_loads(recording, config, segments)):
        features += _segment_features(recording, config, segments, number, float(load_Nm))
    still = (recording.temperature_C, 0.0, 0.0, 0.0, 0.0, 0.0)
    for axis in "xyz":
        features.append(Feature(IMU, f"imu.{axis}", "rest", block, still, f"imu/{axis}"))
    return MotionFeatures(recording, segments, tuple(features))


def _segment_features(
    recording: Recording, config: Config, segments: tuple[Segment, ...], number: int, load_Nm: float
) -> Iterator[Feature]:
    """Of one of the segments, channel by channel; in doubt are beginnings, most of all a joint's first."""
    segment = segments[number]
    j, motor = segment.joint, recording.motor_rad()[segment.joint]
    is_first = not any(s.joint is j and s.first < segment.first for s in segments)
    backlash_rad = 2.0 * float(config.half_gap_rad[j])
    touch = _touch_tick(recording)
    for channel in (CURRENT, FOLLOWING, RESOLVER):
        for bin_number, first, end in _compared_bins(recording, segment, channel, touch):
            speed = float(recording.drive["setpoint_rate_rad_s"][first:end, j].mean())
            angle = float(motor[(first + end) // 2])
            sine, cosine = float(np.sin(angle)), float(np.cos(angle))
            condition = (recording.temperature_C, load_Nm, speed, sine, cosine, float(segment.direction))
            doubt = START_DOUBT[channel] if first - segment.first < START_S * CYCLE_HZ else 0.0
            turned_rad = abs(float(motor[first] - motor[segment.first]))
            if channel == RESOLVER and is_first and turned_rad < BACKLASH_MARGIN * backlash_rad:
                doubt = backlash_rad
            yield Feature(
                channel,
                j.name.lower(),
                segment.regime(first),
                recording.block,
                condition,
                f"motion {number}/{CHANNELS[channel]}/{bin_number}",
                doubt,
            )


def evaluate_features(here: MotionFeatures, sensors: SensorColumns) -> Array:
    """The features' numbers in sensors by tick, recorded or simulated, (m,)."""
    recording, values = here.recording, []
    touch = _touch_tick(recording)
    encoder = sensors["encoder_count"].T * recording.rad_per_count[:, None]
    setpoint = recording.drive["setpoint_count"].T * recording.rad_per_count[:, None]
    resolver = sensors["resolver_rad"].T - encoder - recording.start.zero_rad[:, None]
    for segment in here.segments:
        j = segment.joint
        for channel, read in (
            (CURRENT, sensors["current_A"][:, j]),
            (FOLLOWING, encoder[j] - setpoint[j]),
            (RESOLVER, resolver[j]),
        ):
            bins = _compared_bins(recording, segment, channel, touch)
            values.append(bin_means(read, [(first, end) for _, first, end in bins]))
    values.append(sensors["gravity_R_m_s2"].mean(axis=0))
    return np.concatenate(values)


def assumed_sigma(feature: Feature) -> float:
    """One sigma of a feature by the noise of the drawing's sensors: what is assumed without repeats."""
    return ASSUMED_SIGMA[feature.channel]


_MEAN: Final = 1.0 / float(np.sqrt(BIN_TICKS))
ASSUMED_SIGMA: Final = (
    0.02 * _MEAN,
    4e-6,
    float(np.hypot(1e-4, 9.6e-5 / np.sqrt(12.0))) * _MEAN,
    0.005 * 0.03,
    2e-5,
    3e-5,
)
"""By channel, in its unit: noise of current sensors and resolvers, counts, the IMU for ten seconds."""


START_DOUBT: Final = (0.02, 2e-5, 0.0)
"""Doubt about current, following and resolver while a motion begins: it hangs on the plant's own numerics."""
START_S: Final = 1.0
TOUCH_MARGIN_S: Final = 2.0
"""So long before a touch nothing is compared any more: another arm may have touched by then, and under the
recorded drive it would push as the real one never did."""
BACKLASH_MARGIN: Final = 1.5
"""Gaps that a joint must turn before it is sure where its output lies: nobody saw how it came there."""


def _compared_bins(
    recording: Recording, segment: Segment, channel: int, touch: int
) -> list[tuple[int, int, int]]:
    """Number, first tick and end of its bins that are compared: none once a tool may touch something.

    A motor that is to turn by less than a count in a cycle is driven by counts: what its servo asks for then
    hangs on where in a count it lies.
    """
    j = segment.joint
    rate = np.abs(recording.drive["setpoint_rate_rad_s"][:, j])
    least = 0.0 if channel == RESOLVER else CYCLE_HZ * abs(float(recording.rad_per_count[j]))
    return [
        (number, first, end)
        for number, (first, end) in enumerate(segment.bins())
        if end <= touch and rate[first:end].mean() >= least
    ]


def _touch_tick(recording: Recording) -> int:
    """The tick from which on a tool may touch something."""
    closed = recording.sensors["switch_closed"]
    at = np.flatnonzero((closed & ~closed[0]).any(axis=1))
    return int(at[0]) - round(TOUCH_MARGIN_S * CYCLE_HZ) if at.size else recording.ticks + 1


def _loads(recording: Recording, config: Config, segments: tuple[Segment, ...]) -> Array:
    """Modelled load of the moving joint of each segment, in its middle."""
    if not segments:
        return np.zeros(0)
    mids = np.array([(s.first + s.end) // 2 for s in segments])
    poses = recording.motor_rad()[:, mids]
    torque = settle_output(config.arm, poses, recording.world.gravity_N_m_s2).torque_Nm
    return np.array([torque[s.joint, k] for k, s in enumerate(segments)])
