"""Recordings for a diagnosis: drive and sensors of the same ticks, start state, world and tracker poses.

Tracker poses are a CSV table by tick, beside a log. Segments of motion and rests are found from the drive
alone, so that imported logs work too.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import FiniteFloat, TypeAdapter, ValidationError
from scipy.spatial.transform import Rotation

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array, Pose
from fsw.messages import ActuatorCommand, Sensors
from marsarm.replaying.inputs import NotReplayable, inputs_from_log
from marsarm.telemetry.format import LogError
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import SESSION
from sim.arm_model.load import ArmModel, default_arm
from sim.loop import RecordedStart
from sim.setting import GRAVITY_M_S2, MAX_TILT_RAD, Scene, World
from simgap.checks.records import runs
from simgap.common.errors import BadRequest, RobotError
from simgap.common.toml import describe_first_problem
from simgap.files.log_file import open_log
from simgap.files.robot_file import CsvTable

DRIVE: Final = "/drive"
COUNTS: Final = "setpoint_count"

TRACKER_COLUMNS: Final = (
    *("tick", "rx_rad", "ry_rad", "rz_rad", "x_m", "y_m", "z_m"),
    *("rx_sigma_rad", "ry_sigma_rad", "rz_sigma_rad", "x_sigma_m", "y_sigma_m", "z_sigma_m"),
)

BIN_TICKS: Final = CYCLE_HZ // 4
"""Width of a bin in ticks: a quarter of a second."""
STILL_COUNTS: Final = 50
"""Least range of the set-point in a motion."""
SLOW_SHARE: Final = 0.5
"""Share of the nominal speed below which a motion is slow."""
REVERSAL_S: Final = 1.0
"""Time after a reversal that belongs to the regime "reversal"."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackerPoses:
    """Poses of the turret interface in RMECH, n of them, in the order of ticks."""

    tick: NDArray[np.int64]
    X_RF: Pose
    sigma: Array
    """Standard deviation of the screw from true to measured, turret axes, rotation first, shape (6, n)."""


NO_TRACKER_POSES: Final = TrackerPoses(
    np.zeros(0, np.int64), Pose(np.zeros((3, 3, 0)), np.zeros((3, 0))), np.zeros((6, 0))
)


def write_tracker_poses(path: Path, seen: TrackerPoses) -> None:
    """Write a CSV file: tick, rotation vector, position, and standard deviations."""
    turn = Rotation.from_matrix(np.moveaxis(seen.X_RF.R, -1, 0)).as_rotvec()
    numbers = np.concatenate([turn.T, seen.X_RF.p, seen.sigma]).T.tolist()
    rows = (",".join(map(repr, (tick, *row))) for tick, row in zip(seen.tick.tolist(), numbers, strict=True))
    path.write_text("\n".join([",".join(TRACKER_COLUMNS), *rows, ""]), encoding="utf-8")


def read_tracker_poses(path: Path) -> TrackerPoses:
    """Read a table; RobotError if a column or a number is missing, or a number is wrong or repeated."""
    log = open_log(path, TRACKER_COLUMNS, (), CsvTable())
    numbers = np.array([log.numbers(name).value for name in TRACKER_COLUMNS])
    if not np.isfinite(numbers).all() or (numbers[7:] <= 0).any():
        raise RobotError(f"{path}: every number must be finite, and every sigma above 0")
    tick = numbers[0].astype(np.int64)
    if np.any(tick != numbers[0]) or np.unique(tick).size != tick.size:
        raise RobotError(f"{path}: ticks must be whole numbers, each there once")
    R = np.moveaxis(Rotation.from_rotvec(numbers[1:4].T).as_matrix(), 0, -1)
    return TrackerPoses(tick, Pose(R, numbers[4:7]), numbers[7:])


class NotForDiagnosis(BadRequest):
    """Log that cannot be compared with the simulator; the message says what it lacks."""


@dataclass(frozen=True, slots=True)
class _SessionHeader:
    """Description of the session in the header of a log; None where it is silent."""

    name: str | None = None
    block: str | None = None
    world: World | None = None
    temperature_C: FiniteFloat | None = None


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
    press_N: float
    """Greatest force with which a tool was commanded to press; 0 for none."""
    notes: tuple[str, ...] = ()
    """Notes on lost messages of the log."""

    @property
    def arm(self) -> ArmModel:
        """Drawing of the arm."""
        return self.start.arm

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return len(self.drive[COUNTS])

    def motor_rad(self) -> Array:
        """Return the motor angles by the encoders, on the output side [rad], shape (5, n)."""
        counts = self.sensors["encoder_count"].T
        return np.asarray(counts * self.rad_per_count[:, None] + self.start.zero_rad[:, None])


def load_recording(path: Path, arm: ArmModel | None = None) -> Recording:
    """Load a log of this project, or an imported one, of an arm of a drawing; None for the default one.

    NotForDiagnosis if the log lacks data that a comparison needs.
    """
    try:
        log = read_log(path)
        inputs = inputs_from_log(log)
        tracker = path.with_suffix(".tracker.csv")
        tracked = read_tracker_poses(tracker) if tracker.exists() else NO_TRACKER_POSES
        session = _read_session(log.header.get(SESSION, "{}"), path)
    except (LogError, NotReplayable, RobotError, ValueError) as error:
        raise NotForDiagnosis(str(error)) from error
    reference: Reference | None = inputs.reference
    if reference is None:
        raise NotForDiagnosis(
            f"log {path}: its header holds no zeros of the joints, so counts cannot be converted "
            f"to angles; record it after an initialisation, or give the [reference] of the import"
        )
    if DRIVE not in log.packets:
        raise NotForDiagnosis(
            f"log {path}: has no {DRIVE}, so the commands to the motor controllers are unknown; "
            f"map set-points, power, brakes and limits to {DRIVE} in the import"
        )
    ticks = min(inputs.ticks, len(log[DRIVE]))
    drive = {f.name: log[DRIVE][f.name][:ticks] for f in fields(ActuatorCommand)}
    sensors = {f.name: inputs.sensors[f.name][:ticks] for f in fields(Sensors)}
    config = configure(inputs.params)
    world = session.world or world_from_imu(inputs.sensors["gravity_R_m_s2"].mean(axis=0), path)
    begin_rad = sensors["encoder_count"][0] * config.rad_per_count + reference.zero_rad
    commands = json.loads(log.header.get("commands", "[]"))
    warm_C, given_C = float(np.mean(sensors["winding_C"][0])), session.temperature_C
    name = session.name or path.stem
    return Recording(
        name=name,
        block=session.block or name,
        world=world,
        temperature_C=warm_C if given_C is None else given_C,
        structure_C=float(np.mean(sensors["structure_C"])),
        params=inputs.params,
        start=RecordedStart(world, begin_rad, reference.zero_rad, config.hardstop_rad, arm or default_arm()),
        rad_per_count=config.rad_per_count,
        drive=drive,
        drives=tuple(_split_drive(drive)),
        sensors=sensors,
        tracker_poses=tracked,
        press_N=max((one["fields"]["force_N"] for one in commands if one["type"] == "Preload"), default=0.0),
        notes=inputs.notes,
    )


def _read_session(text: str, path: Path) -> _SessionHeader:
    where = f"log {path}: {SESSION} in its header"
    try:
        session = _SESSION_ADAPTER.validate_json(text)
    except ValidationError as error:
        raise NotForDiagnosis(f"{where}: {describe_first_problem(error)}") from error
    world = session.world or World()
    most = float(np.max(np.abs([world.tilt_roll_rad, world.tilt_pitch_rad])))
    if not most <= MAX_TILT_RAD:
        raise NotForDiagnosis(
            f"{where}: tilts the rover by {most:.3g} rad; at most {MAX_TILT_RAD:.3g} is right"
        )
    return session


def world_from_imu(gravity_R_m_s2: Array, path: Path) -> World:
    """Derive the scene of the nearest gravity and the tilt, for logs without a description.

    The mean reading of the IMU has shape (3,). NotForDiagnosis if it is no gravity.
    """
    strength = float(np.linalg.norm(gravity_R_m_s2))
    if not 0.0 < strength < np.inf:
        raise NotForDiagnosis(f"log {path}: its header does not say its world, and its IMU reads no gravity")
    scene = min(GRAVITY_M_S2, key=lambda one: abs(GRAVITY_M_S2[one] - strength))
    x, y, z = gravity_R_m_s2 / strength
    return World(cast(Scene, scene), float(np.arctan2(y, z)), float(np.arcsin(np.clip(-x, -1.0, 1.0))))


def _split_drive(drive: Mapping[str, NDArray[Any]]) -> Iterator[ActuatorCommand]:
    changed = {
        name: [True, *(values[1:] != values[:-1]).any(axis=tuple(range(1, values.ndim))).tolist()]
        for name, values in drive.items()
    }
    last: dict[str, Any] = {}
    for tick in range(len(drive[COUNTS])):
        last |= {name: values[tick] for name, values in drive.items() if changed[name][tick]}
        yield ActuatorCommand(**last)


@dataclass(frozen=True, slots=True)
class Segment:
    """Motion of a powered joint, from tick `first` to before `end`."""

    joint: Joint
    first: int
    end: int
    direction: int
    """+1 or -1."""
    slow: bool
    reversed: bool
    """Motion against the previous motion of the joint in this recording."""

    def bins(self) -> list[tuple[int, int]]:
        """Return the first tick, and the one after the last, of each whole bin."""
        return [(k, k + BIN_TICKS) for k in range(self.first, self.end - BIN_TICKS + 1, BIN_TICKS)]

    def regime(self, first: int) -> str:
        """Return the regime of a bin that begins at this tick."""
        early = first - self.first < REVERSAL_S * CYCLE_HZ
        return "reversal" if self.reversed and early else "slow" if self.slow else "fast"


def find_segments(recording: Recording) -> list[Segment]:
    """Find the segments in the order of joints, then of time."""
    found = []
    for joint in Joint:
        before = 0
        for first, end in runs(recording.drive["power_on"][:, joint]):
            moved = recording.drive["setpoint_count"][first:end, joint]
            if np.ptp(moved) < STILL_COUNTS:
                continue
            direction = int(np.sign(moved[-1] - moved[0])) or 1
            most = float(np.abs(recording.drive["setpoint_rate_rad_s"][first:end, joint]).max())
            slow = most < SLOW_SHARE * recording.params.joints.in_order()[joint].speed_rad_s
            found.append(Segment(joint, first, end, direction, slow, before * direction < 0))
            before = direction
    return found


def find_touch(recording: Recording) -> int | None:
    """Find the first tick at which a contact switch has closed; None if none closes."""
    closed = recording.sensors["switch_closed"]
    at = np.flatnonzero((closed & ~closed[0]).any(axis=1))
    return int(at[0]) if at.size else None


def find_rests(recording: Recording) -> list[int]:
    """Find a tick of every rest on the brakes of at least half a second.

    It is that of a tracker pose after this time, or else the last one: the next move may be planned after the
    pose was measured.
    """
    still = np.asarray(~(recording.drive["power_on"] | recording.drive["brake_release"]).any(axis=1))
    least, measured = CYCLE_HZ // 2, recording.tracker_poses.tick
    rests = []
    for first, end in runs(still):
        if end - first >= least:
            here = measured[(measured >= first + least - 1) & (measured < end)]
            rests.append(int(here[-1]) if here.size else end - 1)
    return rests
