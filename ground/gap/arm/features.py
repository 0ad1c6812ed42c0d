"""What is compared of a recording in motion: the same numbers from recorded and from simulated sensors."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.joints import Switch
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array
from ground.gap.arm.logs import Recording
from ground.gap.arm.segments import BIN_TICKS, Segment, binned, segments_in

CHANNELS: Final = ("current", "following", "resolver-encoder", "contact", "imu", "screw-turn", "screw-shift")
UNITS: Final = ("A", "rad", "rad", "s", "m/s^2", "rad", "m")
CURRENT, FOLLOWING, RESOLVER, CONTACT, IMU, TURN, SHIFT = range(len(CHANNELS))
CONDITIONS: Final = ("temperature_C", "load_Nm", "speed_rad_s", "sin_angle", "cos_angle", "way")

Columns = Mapping[str, NDArray[Any]]


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


def channel_of(feature: Feature) -> str:
    """As people are told it: what was measured, and where."""
    return f"{feature.place} {CHANNELS[feature.channel]}"


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """What is looked at of one recording, and where."""

    recording: Recording
    segments: tuple[Segment, ...]
    features: tuple[Feature, ...]


def moving(recording: Recording, config: Config) -> Moving:
    """Its features: three channels of every moving joint bin by bin, the switches' first touch, the IMU."""
    segments, block = tuple(segments_in(recording)), recording.block
    features: list[Feature] = []
    for number, load_Nm in enumerate(_loads(recording, config, segments)):
        features += _in_motion(recording, config, segments, number, float(load_Nm))
    still = (recording.temperature_C, 0.0, 0.0, 0.0, 0.0, 0.0)
    for axis in "xyz":
        features.append(Feature(IMU, f"imu.{axis}", "rest", block, still, f"imu/{axis}"))
    for switch in _touched(recording):
        named = Switch(switch).name.lower()
        features.append(Feature(CONTACT, named, "contact", block, still, f"contact/{named}"))
    return Moving(recording, segments, tuple(features))


def _in_motion(
    recording: Recording, config: Config, segments: tuple[Segment, ...], number: int, load_Nm: float
) -> Iterator[Feature]:
    """Of one of the segments, channel by channel; in doubt are a joint's first, and those near a touch."""
    segment, touch = segments[number], _touch(recording)
    j, motor = segment.joint, recording.motor_rad()[segment.joint]
    is_first = not any(s.joint is j and s.first < segment.first for s in segments)
    gap_rad = 2.0 * float(config.half_gap_rad[j])
    for channel in (CURRENT, FOLLOWING, RESOLVER):
        for bin_number, (first, end) in enumerate(segment.bins()):
            speed = float(recording.drive["setpoint_rate_rad_s"][first:end, j].mean())
            angle = float(motor[(first + end) // 2])
            sine, cosine = float(np.sin(angle)), float(np.cos(angle))
            condition = (recording.temperature_C, load_Nm, speed, sine, cosine, float(segment.way))
            touching = end > touch
            doubt = IN_CONTACT[channel] if touching else 0.0
            turned_rad = abs(float(motor[first] - motor[segment.first]))
            if channel == RESOLVER and is_first and turned_rad < TAKEN_UP * gap_rad:
                doubt = gap_rad
            yield Feature(
                channel,
                j.name.lower(),
                "contact" if touching else segment.regime(first),
                recording.block,
                condition,
                f"motion {number}/{CHANNELS[channel]}/{bin_number}",
                doubt,
            )


def measured(here: Moving, sensors: Columns) -> Array:
    """The features' numbers in sensors by tick, recorded or simulated, (m,)."""
    recording, values = here.recording, []
    encoder = sensors["encoder_count"].T * recording.rad_per_count[:, None]
    setpoint = recording.drive["setpoint_count"].T * recording.rad_per_count[:, None]
    resolver = sensors["resolver_rad"].T - encoder - recording.start.zero_rad[:, None]
    for segment in here.segments:
        j, bins = segment.joint, segment.bins()
        values.append(binned(sensors["current_A"][:, j], bins))
        values.append(binned(encoder[j] - setpoint[j], bins))
        values.append(binned(resolver[j], bins))
    values.append(sensors["gravity_R_m_s2"].mean(axis=0))
    values.append(np.array([_first(sensors["switch_closed"][:, switch]) for switch in _touched(recording)]))
    return np.concatenate(values)


def assumed_sigma(feature: Feature) -> float:
    """One sigma of a feature by the noise of the drawing's sensors: what is assumed without repeats."""
    return ASSUMED[feature.channel]


_MEAN: Final = 1.0 / float(np.sqrt(BIN_TICKS))
ASSUMED: Final = (
    0.02 * _MEAN,
    4e-6,
    float(np.hypot(1e-4, 9.6e-5 / np.sqrt(12.0))) * _MEAN,
    0.5 / CYCLE_HZ,
    0.005 * 0.03,
    2e-5,
    3e-5,
)
"""By channel, in its unit: noise of current sensors and resolvers, counts, ticks, the IMU for ten seconds."""


IN_CONTACT: Final = (0.5, 2e-4, 5e-4)
"""Doubt about current, following and resolver from just before a touch on: how it begins is chance, and under
the recorded drive an arm that touches elsewhere pushes as the real one never did."""
TOUCH_S: Final = 2.0
"""Before a touch: another arm may have touched by then."""
TAKEN_UP: Final = 1.5
"""Gaps that a joint must turn before it is sure where its output lies: nobody saw how it came there."""


def _touch(recording: Recording) -> int:
    """The tick from which on a tool may touch something."""
    closed = recording.sensors["switch_closed"]
    at = np.flatnonzero((closed & ~closed[0]).any(axis=1))
    return int(at[0]) - round(TOUCH_S * CYCLE_HZ) if at.size else recording.ticks + 1


def _touched(recording: Recording) -> list[int]:
    """Switches that close at some time of the recording."""
    closed = recording.sensors["switch_closed"]
    return [int(k) for k in np.flatnonzero(closed.any(axis=0) & ~closed[0])]


def _first(closed: NDArray[np.bool_]) -> float:
    """When a switch closes first [s]; the end of the recording if it does not."""
    at = np.flatnonzero(closed)
    return float(at[0] if at.size else closed.size) / CYCLE_HZ


def _loads(recording: Recording, config: Config, segments: tuple[Segment, ...]) -> Array:
    """Modelled load of the moving joint of each segment, in its middle."""
    if not segments:
        return np.zeros(0)
    mids = np.array([(s.first + s.end) // 2 for s in segments])
    poses = recording.motor_rad()[:, mids]
    torque = rest(config.arm, poses, recording.world.gravity_N_m_s2).torque_Nm
    return np.array([torque[s.joint, k] for k, s in enumerate(segments)])
