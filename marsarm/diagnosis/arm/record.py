"""Recording of a diagnosis campaign with a simulated arm: logs and tracker poses. Motions planned for it."""

import json
import os
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path
from typing import Annotated, Final, Literal
from zlib import crc32

import numpy as np
from pydantic import Field, field_validator

from fsw.dictionary.commands import Command, MoveJoint, MoveJoints
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array, Pose, stack_poses
from marsarm.calibration.campaign import TooFewTargets, measure_pose
from marsarm.common.requests import fit_effects, parse_effects, select_arm
from marsarm.diagnosis.arm.logs import TrackerPoses, write_tracker_poses
from marsarm.diagnosis.arm.request import RecordRequest
from marsarm.telemetry.events import record_to_json
from marsarm.telemetry.recorder import SESSION, Recorder, flight_header
from sim import diagnosis_campaign as plans
from sim.arms import BuiltArm, effects_of_run
from sim.effects.effect import Effect
from sim.initialisation import true_reference
from sim.loop import ClosedLoop
from sim.params import params_toml
from sim.plant import PlantDiverged
from sim.scenario.records import did_you_mean
from sim.setting import WARM_C, World
from sim.tracker import TYPICAL_TRACKER, turret_pose
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_path, check_new_path
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress
from simgap.common.toml import Record, parse_record, read_toml, toml_text

ALL: Final = "all"
"""Name in place of a joint: all joints turn at once."""
TURNS_DEG: Final = (-1.0, -5.0, -15.0)
POSES_DEG: Final = [[*pose] for pose in (plans.OUTSTRETCHED, plans.HELD_OUT_POSE, plans.TOUCHING_DEG)]
TRACKED_DEG: Final = [[*start] for start, _ in plans.TILTED_POSES]
HOLD_S: Final = 30.0
"""Rest that shows what creeps."""
COUNT: Final = 2
"""Times that a joint goes there and back: the second time shows what the first has left behind."""

LEAST_TURN_DEG: Final = 0.1
"""A joint that turns by less does not move, for a diagnosis: its set-point moves by few encoder counts."""
DECIMALS: Final = 6
"""Decimals of the angles in the file of a motion, in degrees."""

Degrees = Annotated[float, Field(ge=-720.0, le=720.0)]


class PlannedMotion(Record):
    """One motion: a joint, or all, goes there and back from a pose."""

    format: Literal["arm motion 1"] = "arm motion 1"
    """Name and version of the file."""
    name: Annotated[str, Field(pattern=r"^[\w-]+$")]
    """Name of the session and of its log."""
    start_deg: Annotated[list[Degrees], Field(min_length=5, max_length=5)]
    """Output angles at the start."""
    joint: Literal["all", "azimuth", "elevation", "elbow", "wrist", "turret"]
    """Joint that turns."""
    turn_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    """Turn of the joint; of all joints, that of the elbow's share of a coordinated turn."""
    speed_share: Annotated[float, Field(ge=0.02, le=1.0)]
    """Speed in the nominal one."""
    count: Annotated[int, Field(ge=1, le=20)]
    """Times that it goes there and back."""
    roll_deg: Annotated[float, Field(ge=-30.0, le=30.0)]
    """Roll of the rover."""
    temperature_C: Annotated[float, Field(ge=-130.0, le=50.0)]
    """Temperature of the arm."""
    tracked: bool
    """True if a tracker measures the turret at rest; then the motion is not compared."""
    hold_s: Annotated[float, Field(ge=1.0, le=600.0)] = plans.SESSION_REST_S
    """Rest before and after each way."""

    @field_validator("turn_deg")
    @classmethod
    def _check_turn(cls, turn_deg: float) -> float:
        if abs(turn_deg) < LEAST_TURN_DEG:
            raise ValueError(f"is {turn_deg:g}: nothing moves; at least {LEAST_TURN_DEG:g} deg is right")
        return turn_deg

    def ends_deg(self) -> Array:
        """Return the output angles at the start and after the turn, (2, 5)."""
        share = np.array(plans.COORDINATED_TURN) / plans.COORDINATED_TURN[Joint.ELBOW]
        if self.joint != ALL:
            share = np.eye(len(Joint))[Joint[self.joint.upper()]]
        return np.array([self.start_deg, self.start_deg + share * self.turn_deg])

    def describe(self) -> str:
        """Return the motion in words."""
        pose = ", ".join(f"{one:g}" for one in self.start_deg)
        turning = "all joints" if self.joint == ALL else self.joint
        seen = ", with a tracker" if self.tracked else ""
        return (
            f"{turning} by {self.turn_deg:g} deg and back {self.count} times at {self.speed_share:g} of the "
            f"nominal speed, from ({pose}) deg, roll {self.roll_deg:g} deg, {self.temperature_C:g} degC, "
            f"at rest for {self.hold_s:g} s before and after each way{seen}"
        )


def list_motions(
    params: Params, places: Collection[str] = (), known: Collection[str] = ()
) -> Iterator[PlannedMotion]:
    """Yield the motions of the family for an arm, of joints that turn alone; of all if no place is a joint.

    They stay within the limits of the arm. Their numbers follow those of known motions, so that no two
    motions of a campaign have one name.
    """
    numbers = [int(one.group(1)) for one in map(re.compile(r"next-(\d+)").match, known) if one]
    roll_deg, names = float(np.degrees(plans.ROLL_RAD)), [one.name.lower() for one in Joint]
    moving = [one for one in names if one in places] or names
    rest, cold = (plans.SESSION_REST_S,), (plans.SESSION_COLD_C,)
    fields = "joint", "turn_deg", "speed_share", "start_deg", "roll_deg", "temperature_C", "tracked", "hold_s"
    family = [
        *product(moving, TURNS_DEG, (1.0, plans.SLOW_FRACTION), POSES_DEG, (0.0,), (WARM_C,), (False,), rest),
        *product((ALL,), TURNS_DEG, (1.0,), POSES_DEG, (roll_deg,), cold, (False,), rest),
        *product(
            *((ALL,), TURNS_DEG[-1:], (1.0,), TRACKED_DEG, (0.0, -roll_deg), (WARM_C,), (True,)),
            (*rest, HOLD_S),
        ),
    ]
    for number, values in enumerate(family, 1 + max(numbers, default=0)):
        content = {"name": f"next-{number}", "count": COUNT, **dict(zip(fields, values, strict=True))}
        motion = PlannedMotion.model_validate(content)
        start_deg = np.round(np.degrees(make_session(motion, params).start_rad), DECIMALS)
        yield motion.model_copy(update={"start_deg": start_deg.tolist()})


def make_session(motion: PlannedMotion, params: Params) -> plans.DiagnosisSession:
    """Return the session of a motion, for an arm with these flight parameters; it stays within the limits."""
    joints = [*Joint] if motion.joint == ALL else [Joint[motion.joint.upper()]]
    here, there = plans.within_limits(params, *motion.ends_deg())
    ways: list[Command] = [MoveJoints(joints5(pose), "off") for pose in (there, here)]
    if motion.joint != ALL:
        ways = [MoveJoint(joints[0], pose[joints[0]], "off") for pose in (there, here)]
    speeds = [plans.set_speed(params, one, motion.speed_share) for one in joints if motion.speed_share != 1.0]
    world, commands = World("mars", float(np.radians(motion.roll_deg))), (*speeds, *(ways * motion.count))
    return plans.DiagnosisSession(
        motion.name, motion.name, world, motion.temperature_C, here, commands, motion.tracked, motion.hold_s
    )


def motion_text(motion: PlannedMotion) -> str:
    """Return the text of the file of a motion."""
    return toml_text(motion.model_dump(), [motion.describe(), "`marsarm gap record --motion` records it."])


def read_motion(path: Path, params: Params) -> PlannedMotion:
    """Read the file of a motion of an arm; BadRequest or RobotError if it is wrong, or no motion for it."""
    content = read_toml(path)
    if "start_deg" not in content:
        raise BadRequest(f"{path}: is no motion; give a file that `gap next --out` wrote")
    motion = parse_record(PlannedMotion, content, path)
    if motion.name in {one.name for one in plans.campaign_sessions(params)}:
        raise BadRequest(f"{path}: name: the campaign has a session {motion.name}; give another name")
    ends = np.sort(motion.ends_deg(), axis=0)
    for joint, limits, low, high in zip(Joint, params.joints.in_order(), *ends, strict=True):
        least, most = np.round(np.degrees((limits.soft_min_rad, limits.soft_max_rad)), DECIMALS)
        if round(low, DECIMALS) < least or round(high, DECIMALS) > most:
            raise BadRequest(
                f"{path}: start_deg, turn_deg: {joint.name.lower()} goes from {low:g} to {high:g} deg; "
                f"its limits are {least:g} and {most:g} deg"
            )
    return motion


HELD_OUT_FOLDER: Final = "held-out"
"""Name of the folder of held-out logs, inside the folder of logs."""
NOT_COMPLETED: Final = (plans.SessionFailed, PlantDiverged)
"""Errors of a session that the arm does not complete."""
PARAMS_FILE: Final = "flight-params.toml"
"""Name of the file of flight parameters beside the logs, in the form of --params."""


def record_campaign(
    folder: Path,
    sessions: Sequence[plans.DiagnosisSession],
    arm: BuiltArm,
    reference: Reference,
    seed: int,
    progress: Progress,
    effects: tuple[Effect, ...] = (),
) -> list[Path]:
    """Record a log of each session, without the state of the plant; none where the arm does not complete it.

    Flight software starts with the zeros of the reference. The effects begin with the run.
    """
    paths = []
    for number, session in enumerate(sessions):
        progress(number, len(sessions), session.name)
        with suppress(*NOT_COMPLETED):
            paths.append(record_session(folder, session, arm, reference, (seed, number), effects))
    return paths


def record_session(
    folder: Path,
    session: plans.DiagnosisSession,
    arm: BuiltArm,
    reference: Reference,
    seeds: tuple[int, int],
    effects: tuple[Effect, ...],
) -> Path:
    """Record one session as `record_campaign` does; raise one of NOT_COMPLETED if the arm does not."""
    folder.mkdir(parents=True, exist_ok=True)
    noise = int(np.random.default_rng(seeds).integers(2**31))
    loop = plans.start_session(session, arm, reference, noise, effects)
    path = folder / f"{session.name}.mcap"
    try:
        _write_session(path, session, loop, sum(seeds))
    except NOT_COMPLETED:
        path.unlink(missing_ok=True)
        raise
    return path


def _write_session(path: Path, session: plans.DiagnosisSession, loop: ClosedLoop, seed: int) -> None:
    rng = np.random.default_rng([seed, 7])
    header = {**flight_header(loop, session.commands), SESSION: session_json(session)}
    rows: list[tuple[int, Pose, Array]] = []
    with Recorder(path, header, loop.config.params) as recorder:
        for moment in plans.run_session(loop, session):
            recorder.write(moment.record)
            if moment.rested and session.tracked:
                loop.plant.truth()  # updates the kinematics
                roll_rad, X_RF = session.world.tilt_roll_rad, turret_pose(loop.plant)
                with suppress(TooFewTargets):
                    one = measure_pose(TYPICAL_TRACKER, loop.plant, roll_rad, X_RF, rng)
                    rows.append((moment.record.tick, one.X_RT, np.sqrt(np.diag(one.covariance))))
    if rows:
        ticks, poses, sigmas = zip(*rows, strict=True)
        seen = TrackerPoses(np.array(ticks, np.int64), stack_poses(poses), np.stack(sigmas, -1))
        write_tracker_poses(path.with_suffix(".tracker.csv"), seen)


def session_json(session: plans.DiagnosisSession) -> str:
    """Return the description of a session for the header of its log."""
    known = {"name": session.name, "block": session.block, "temperature_C": session.temperature_C}
    return json.dumps({**known, "world": record_to_json(session.world)})


def split_logs(folder: Path) -> tuple[list[Path], list[Path]]:
    """Split the logs of a folder into those that are fitted and those that are held out."""
    logs, apart = sorted(folder.glob("*.mcap")), plans.HELD_OUT_SESSIONS
    return [log for log in logs if log.stem not in apart], [log for log in logs if log.stem in apart]


def _choose_sessions(request: RecordRequest, arm: BuiltArm) -> list[plans.DiagnosisSession]:
    """Return the sessions of the campaign that a request asks for.

    BadRequest if there is none, that or RobotError if the file of a motion is wrong.
    """
    if request.motion is not None and request.sessions != "*":
        raise BadRequest("motion, sessions: they exclude each other; give one of the two")
    if request.motion is not None:
        return [make_session(read_motion(request.motion, arm.params), arm.params)]
    every = plans.campaign_sessions(arm.params)
    chosen = [session for session in every if fnmatchcase(session.name, request.sessions)]
    if not chosen:
        raise BadRequest(
            f"sessions: nothing is called {request.sessions!r}; "
            f"{did_you_mean(request.sessions, [session.name for session in every])}"
        )
    return chosen


def draw_seed(seed: int, name: str, names: Sequence[str]) -> int:
    """Return another seed for each seed and session, whatever else is recorded: logs share no noise."""
    own = names.index(name) if name in names else len(names) + crc32(name.encode())
    return seed * 2**33 + own


@dataclass(frozen=True, slots=True)
class RecordedLogs:
    """Recorded logs, and the names of the sessions that the arm did not complete."""

    logs: tuple[Path, ...]
    left_out: tuple[str, ...]


def record_logs(request: RecordRequest, progress: Progress = no_progress) -> RecordedLogs:
    """Record all sessions, held-out ones in their own folder.

    BadRequest if the request is wrong, or the arm completes no session with these effects; BadOutput if the
    folder cannot be written.
    """
    check_options(request)
    arm = select_arm(request.arm, request.params, request.mismatch)
    effects = parse_effects(request.effects, arm.params.tool_names)
    arm, begun, wanted = fit_effects(arm, effects), effects_of_run(effects), _choose_sessions(request, arm)
    if os.path.exists(request.out) and (not os.path.isdir(request.out) or os.listdir(request.out)):
        raise BadRequest(f"out {request.out}: is there and is no empty folder; name a new or empty one")
    check_new_path(request.out, "out")
    reference, paths, left_out = true_reference(arm), list[Path](), dict[str, str]()
    names = [session.name for session in plans.campaign_sessions(arm.params)]
    try:
        with atomic_path(request.out.resolve()) as part:
            part.mkdir(parents=True, exist_ok=True)
            comments = ["Flight parameters of these logs; all others are nominal."]
            (part / PARAMS_FILE).write_text(params_toml(arm.model.params, arm.params, comments))
            for number, session in enumerate(wanted):
                progress(number, len(wanted), session.name)
                folder = part / HELD_OUT_FOLDER if session.name in plans.HELD_OUT_SESSIONS else part
                seeds = draw_seed(request.seed, session.name, names), 0
                try:
                    log = record_session(folder, session, arm, reference, seeds, begun)
                    paths.append(request.out / log.relative_to(part))
                except NOT_COMPLETED as error:
                    left_out[session.name] = str(error)
            if not paths:
                raise BadRequest(
                    "the arm completes no session; with smaller effects, or another motion, it may. "
                    f"{[*left_out.values()][-1]}"
                )
    except OSError as error:
        raise BadRequest(f"out {request.out}: cannot be written ({error.strerror or error})") from error
    progress(len(wanted), len(wanted), "recorded")
    return RecordedLogs(tuple(paths), tuple(left_out))
