"""Features of a recording in motion: the same numbers from recorded and from simulated sensors.

Each motion of a joint is divided into bins of a quarter of a second, over which three channels are averaged:

    motor current
    following error: encoder minus set-point
    resolver minus encoder

The mean gravity reading of the IMU is added. In all functions, features are arrays (m,) in the units of their
channels.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.enums import Joint
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.logs import BIN_TICKS, Recording, Segment, find_segments, find_touch
from marsarm.diagnosis.problem import CONDITIONS

CHANNELS: Final = (
    *("current", "following-error", "resolver-encoder", "imu", "rotation", "translation", "touch"),
)
UNITS: Final = ("A", "rad", "rad", "m/s^2", "rad", "m", "m")
CURRENT, FOLLOWING_ERROR, RESOLVER, IMU, ROTATION, TRANSLATION, TOUCH = range(len(CHANNELS))
MOTION_CHANNELS: Final = (CURRENT, FOLLOWING_ERROR, RESOLVER)

SensorColumns = Mapping[str, NDArray[Any]]
"""Readings by field, each of shape (n, ...) with n ticks."""
_MEAN: Final = 1.0 / float(np.sqrt(BIN_TICKS))
ASSUMED_SIGMA: Final = (
    0.02 * _MEAN,
    4e-6,
    float(np.hypot(1e-4, 9.6e-5 / np.sqrt(12.0))) * _MEAN,
    0.005 * 0.03,
    2e-5,
    3e-5,
    1e-4,
)
"""Standard deviation by channel in its unit, from noise of current sensors and resolvers, encoder counts, the
IMU over ten seconds, the tracker, and the way of a tool in a cycle."""
START_DOUBT: Final = (0.02, 2e-5, 0.0)
"""Doubt of current, following error and resolver at the start of a motion, which depends on numerics."""
START_S: Final = 1.0
"""Duration of the start of a motion."""
TOUCH_MARGIN_S: Final = 2.0
"""Time before a touch from which on nothing is compared. Another arm may touch earlier, and the recorded
drive would then push it against the rock."""
BACKLASH_MARGIN: Final = 1.5
"""Multiples of its backlash that a joint must turn before the side of its backlash is known."""


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """Number that is compared between measurement and simulation."""

    recording: Recording
    channel: int
    place: str
    regime: str
    condition: tuple[float, ...]
    key: str
    """Key of the same feature in every log of its session: motion, channel, number."""
    doubt: float = 0.0
    """Standard deviation of its error beside noise, in the unit of its channel."""
    sigma: float | None = None
    """Standard deviation of its noise; None for that which is assumed of the channel."""
    span: tuple[int, int] | None = None
    """First tick and end of its bin; None if it is of no bin."""
    time_s: float = 0.0
    """Time since the start of the log; 0 for what is of all of it."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionFeatures:
    """Segments and features of one recording in motion."""

    recording: Recording
    segments: tuple[Segment, ...]
    features: tuple[Feature, ...]
    """Those of bins, then the three of the IMU."""

    @property
    def compared_ticks(self) -> int:
        """Number of ticks up to the end of the last bin that is compared; at least one."""
        return max((one.span[1] for one in self.features if one.span), default=1)


def name_channel(place: str, channel: int) -> str:
    """Return the name of a channel with its place."""
    return f"{place} {CHANNELS[channel]}"


def still(recording: Recording) -> tuple[float, ...]:
    """Return the conditions of an arm at rest."""
    return (recording.temperature_C, *(0.0,) * (len(CONDITIONS) - 1))


def list_motion_features(recording: Recording, config: Config) -> MotionFeatures:
    """List the features of a recording: three channels of every moving joint by bin, and the IMU.

    Bins after a possible touch are left out.
    """
    segments = tuple(find_segments(recording))
    moving = (_segment_features(recording, config, segments, number) for number in range(len(segments)))
    imu = [Feature(recording, IMU, f"imu.{axis}", "rest", still(recording), f"imu/{axis}") for axis in "xyz"]
    return MotionFeatures(recording, segments, (*chain.from_iterable(moving), *imu))


def _segment_features(
    recording: Recording, config: Config, segments: tuple[Segment, ...], number: int
) -> Iterator[Feature]:
    """Yield the features of one segment by channel; the start of a motion has doubt.

    There are none after a possible touch. A motor slower than one count per cycle is driven count by count.
    Its servo then depends on the position within a count, so only its resolver is compared. The load is that
    in the middle of the segment.
    """
    segment = segments[number]
    j, motor_rad = segment.joint, recording.motor_rad()
    motor, middle = motor_rad[j], (segment.first + segment.end) // 2
    at_middle = settle_output(config.arm, motor_rad[:, [middle]], recording.world.gravity_N_m_s2)
    load_Nm = float(at_middle.torque_Nm[j, 0])
    is_first = not any(s.joint is j and s.first < segment.first for s in segments)
    backlash_rad = 2.0 * float(config.half_backlash_rad[j])
    touch, rate_rad_s = find_touch(recording), recording.drive["setpoint_rate_rad_s"][:, j]
    last = recording.ticks if touch is None else touch - round(TOUCH_MARGIN_S * CYCLE_HZ)
    least_rad_s = CYCLE_HZ * abs(float(recording.rad_per_count[j]))
    for channel in MOTION_CHANNELS:
        for bin_number, (first, end) in enumerate(segment.bins()):
            is_slow = np.abs(rate_rad_s[first:end]).mean() < least_rad_s
            if end > last or (is_slow and channel != RESOLVER):
                continue
            speed, angle = float(rate_rad_s[first:end].mean()), float(motor[(first + end) // 2])
            sine, cosine = float(np.sin(angle)), float(np.cos(angle))
            condition = (recording.temperature_C, load_Nm, speed, sine, cosine, float(segment.direction))
            doubt = START_DOUBT[channel] if first - segment.first < START_S * CYCLE_HZ else 0.0
            turned_rad = abs(float(motor[first] - motor[segment.first]))
            if channel == RESOLVER and is_first and turned_rad < BACKLASH_MARGIN * backlash_rad:
                doubt = backlash_rad
            key = f"motion {number}/{CHANNELS[channel]}/{bin_number}"
            regime = segment.regime(first)
            place, time_s = j.name.lower(), (first + end) / 2 / CYCLE_HZ
            yield Feature(
                recording, channel, place, regime, condition, key, doubt, span=(first, end), time_s=time_s
            )


def evaluate_features(motion: MotionFeatures, sensors: SensorColumns) -> Array:
    """Compute the features from recorded or simulated sensors, of at least `compared_ticks`."""
    recording = motion.recording
    encoder = sensors["encoder_count"].T * recording.rad_per_count[:, None]
    setpoint_count = recording.drive["setpoint_count"][: encoder.shape[1]]
    read = {
        CURRENT: sensors["current_A"].T,
        FOLLOWING_ERROR: encoder - setpoint_count.T * recording.rad_per_count[:, None],
        RESOLVER: sensors["resolver_rad"].T - encoder - recording.start.zero_rad[:, None],
    }
    spans = [(read[one.channel][Joint[one.place.upper()]], one.span) for one in motion.features if one.span]
    values = [channel[first:end].mean() for channel, (first, end) in spans]
    return np.concatenate([values, sensors["gravity_R_m_s2"].mean(axis=0)])
