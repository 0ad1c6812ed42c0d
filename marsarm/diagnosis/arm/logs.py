"""Recordings for a diagnosis: drive and sensors of the same ticks, start state, world and tracker poses."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array
from fsw.messages import ActuatorCommand, Sensors
from marsarm.diagnosis.arm.tracker_poses import TrackerPoses, no_tracker_poses, read_tracker_poses
from marsarm.replay.inputs import NotReplayable, inputs_from_log
from marsarm.telemetry.errors import LogError
from marsarm.telemetry.header import SESSION
from marsarm.telemetry.read import Log, read_log
from sim.loop import RecordedStart
from sim.world import GRAVITY_M_S2, MAX_TILT_RAD, Scene, World
from simgap.common.errors import BadRequest
from simgap.common.json_file import describe_first_problem

DRIVE: Final = "/drive"
COUNTS: Final = "setpoint_count"


class NotForDiagnosis(BadRequest):
    """Log that cannot be compared with the simulator; the message says what it lacks."""


@dataclass(frozen=True, slots=True)
class _SessionHeader:
    """Description of the session in the header of a log; None where it is silent."""

    name: str | None = None
    block: str | None = None
    world: World | None = None
    temperature_C: float | None = None


_SESSION_ADAPTER: Final = TypeAdapter(_SessionHeader)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Recorded session of n ticks; arrays by field, ticks first."""

    name: str
    block: str
    world: World
    temperature_C: float
    """Temperature of the actuators."""
    structure_C: float
    """Temperature of links and tools."""
    params: Params
    start: RecordedStart
    rad_per_count: Array
    drive: Mapping[str, NDArray[Any]]
    drives: tuple[ActuatorCommand, ...]
    """Drive as one command for each tick; unchanged values share one array, as flight software shares
    them."""
    sensors: Mapping[str, NDArray[Any]]
    tracker_poses: TrackerPoses
    notes: tuple[str, ...] = ()
    """Notes on lost messages of the log."""

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return len(self.drive[COUNTS])

    def motor_rad(self) -> Array:
        """Convert the counts of the encoders to motor angles.

        Returns:
            Motor angles on the output side [rad], shape (5, n).
        """
        rad: Array = self.sensors["encoder_count"].T * self.rad_per_count[:, None]
        return rad + self.start.zero_rad[:, None]

    def setpoint_rad(self) -> Array:
        """Convert the set-points from counts to angles.

        Returns:
            Commanded motor angles on the output side [rad], shape (5, n).
        """
        rad: Array = self.drive[COUNTS].T * self.rad_per_count[:, None]
        return rad + self.start.zero_rad[:, None]


def load_recording(path: Path) -> Recording:
    """Load a log of this project, or an imported one.

    Raises:
        NotForDiagnosis: The log lacks data that a comparison needs.
    """
    try:
        log = read_log(path)
        inputs = inputs_from_log(log)
        tracker = path.with_suffix(".tracker.csv")
        tracked = read_tracker_poses(tracker) if tracker.exists() else no_tracker_poses()
        session = _read_session(log.header.get(SESSION, "{}"), path)
    except (LogError, NotReplayable, ValueError) as error:
        raise NotForDiagnosis(str(error)) from error
    if inputs.reference is None:
        raise NotForDiagnosis(
            f"log {path}: its header holds no zeros of the joints, so counts cannot be converted "
            f"to angles; record it after an initialisation, or give boot.reference in the [start] of the "
            f"import"
        )
    ticks = min(inputs.ticks, len(_drive_packets(log)))
    drive = {f.name: _drive_packets(log)[f.name][:ticks] for f in fields(ActuatorCommand)}
    sensors = {f.name: inputs.sensors[f.name][:ticks] for f in fields(Sensors)}
    joints = inputs.params.joints.in_order()
    rad_per_count = np.array([2 * np.pi / (j.encoder_counts_per_turn * j.gear_ratio) for j in joints])
    reference: Reference = inputs.reference
    world = session.world or world_from_imu(inputs.sensors["gravity_R_m_s2"].mean(axis=0), path)
    start = RecordedStart(
        world,
        sensors["encoder_count"][0] * rad_per_count + reference.zero_rad,
        reference.zero_rad,
        np.array([j.hardstop_rad for j in joints]),
    )
    warm_C = float(np.mean(sensors["winding_C"][0]))
    name = session.name or path.stem
    return Recording(
        name=name,
        block=session.block or name,
        world=world,
        temperature_C=warm_C if session.temperature_C is None else session.temperature_C,
        structure_C=float(np.mean(sensors["structure_C"])),
        params=inputs.params,
        start=start,
        rad_per_count=rad_per_count,
        drive=drive,
        drives=tuple(_split_drive(drive)),
        sensors=sensors,
        tracker_poses=tracked,
        notes=inputs.notes,
    )


def _read_session(text: str, path: Path) -> _SessionHeader:
    where = f"log {path}: {SESSION} in its header"
    try:
        session = _SESSION_ADAPTER.validate_json(text)
    except ValidationError as error:
        raise NotForDiagnosis(f"{where}: {describe_first_problem(error)}") from error
    if session.temperature_C is not None and not np.isfinite(session.temperature_C):
        raise NotForDiagnosis(f"{where}: temperature_C is {session.temperature_C}; it must be finite")
    world = session.world or World()
    most = float(np.max(np.abs([world.tilt_roll_rad, world.tilt_pitch_rad])))
    if not most <= MAX_TILT_RAD:
        raise NotForDiagnosis(
            f"{where}: tilts the rover by {most:.3g} rad; at most {MAX_TILT_RAD:.3g} is right"
        )
    return session


def world_from_imu(gravity_R_m_s2: Array, path: Path) -> World:
    """Derive the world from gravity, for logs without a description: scene and tilt, no rock.

    Args:
        gravity_R_m_s2: Mean reading of the IMU in the rover frame, shape (3,).
        path: Log, for the error.

    Returns:
        World with the scene of the nearest gravity.

    Raises:
        NotForDiagnosis: The IMU reads no gravity.
    """
    strength = float(np.linalg.norm(gravity_R_m_s2))
    if not 0.0 < strength < np.inf:
        raise NotForDiagnosis(f"log {path}: its header does not say its world, and its IMU reads no gravity")
    scene = min(GRAVITY_M_S2, key=lambda one: abs(GRAVITY_M_S2[one] - strength))
    x, y, z = gravity_R_m_s2 / strength
    return World(cast(Scene, scene), float(np.arctan2(y, z)), float(np.arcsin(np.clip(-x, -1.0, 1.0))))


def _split_drive(drive: Mapping[str, NDArray[Any]]) -> Iterator[ActuatorCommand]:
    anew = {name: _changes(values) for name, values in drive.items()}
    last: dict[str, Any] = {}
    for tick in range(len(drive[COUNTS])):
        for name, values in drive.items():
            if anew[name][tick]:
                value = values[tick]
                last[name] = value.copy() if isinstance(value, np.ndarray) else value.item()
        yield ActuatorCommand(**last)


def _changes(values: NDArray[Any]) -> list[bool]:
    """Return for every tick whether a value changed; True for the first."""
    other = (values[1:] != values[:-1]).any(axis=tuple(range(1, values.ndim)))
    return [True, *other.tolist()]


def _drive_packets(log: Log) -> NDArray[np.void]:
    if DRIVE not in log.packets:
        raise NotForDiagnosis(
            f"log {log.path}: has no {DRIVE}, so the commands to the motor controllers are unknown; "
            f"map set-points, power, brakes and limits to {DRIVE} in the import"
        )
    return log[DRIVE]
