"""Recording of a diagnosis campaign with a simulated arm: logs and tracker poses."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final

import numpy as np

from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array, Pose, stack_poses
from marsarm.calibration.campaign import TooFewTargets, measure_pose
from marsarm.common.effects import fit_effects, parse_effects
from marsarm.common.requests import select_arm
from marsarm.diagnosis.arm.logs import TrackerPoses, write_tracker_poses
from marsarm.diagnosis.arm.planned_motion import make_session, read_motion
from marsarm.diagnosis.arm.request import RecordRequest
from marsarm.telemetry.events import record_to_json
from marsarm.telemetry.recorder import SESSION, Recorder, flight_header
from sim.arms import BuiltArm, effects_of_run
from sim.diagnosis_campaign import (
    HELD_OUT_SESSIONS,
    DiagnosisSession,
    SessionFailed,
    campaign_sessions,
    run_session,
    start_session,
)
from sim.effects.effect import Effect
from sim.initialisation import true_reference
from sim.loop import ClosedLoop
from sim.params import params_toml
from sim.plant import PlantDiverged
from sim.scenario.records import did_you_mean
from sim.tracker import TYPICAL_TRACKER, turret_pose
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_path, check_new_path
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress

HELD_OUT_FOLDER: Final = "held-out"
"""Name of the folder of held-out logs, inside the folder of logs."""
PARAMS_FILE: Final = "flight-params.toml"
"""Name of the file of flight parameters beside the logs, in the form of --params."""


def record_campaign(
    folder: Path,
    sessions: Sequence[DiagnosisSession],
    arm: BuiltArm,
    reference: Reference,
    seed: int,
    progress: Progress,
    effects: tuple[Effect, ...] = (),
) -> list[Path]:
    """Record a log of each session, without the state of the plant; none where the arm does not complete it.

    Flight software starts with the zeros of the reference. The effects begin with the run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, session in enumerate(sessions):
        progress(number, len(sessions), session.name)
        loop = start_session(
            session, arm, reference, int(np.random.default_rng([seed, number]).integers(2**31)), effects
        )
        path = folder / f"{session.name}.mcap"
        try:
            _record_session(path, session, loop, seed + number)
            paths.append(path)
        except (SessionFailed, PlantDiverged):
            path.unlink(missing_ok=True)
    return paths


def _record_session(path: Path, session: DiagnosisSession, loop: ClosedLoop, seed: int) -> None:
    rng = np.random.default_rng([seed, 7])
    header = {**flight_header(loop, session.commands), SESSION: session_json(session)}
    rows: list[tuple[int, Pose, Array]] = []
    with Recorder(path, header, loop.config.params) as recorder:
        for moment in run_session(loop, session):
            recorder.write(moment.record)
            if moment.rested and session.tracked:
                rows += _measure_turret(loop, session, moment.record.tick, rng)
    if rows:
        ticks, poses, sigmas = zip(*rows, strict=True)
        seen = TrackerPoses(np.array(ticks, np.int64), stack_poses(poses), np.stack(sigmas, -1))
        write_tracker_poses(path.with_suffix(".tracker.csv"), seen)


def session_json(session: DiagnosisSession) -> str:
    """Return the description of a session for the header of its log."""
    known = {"name": session.name, "block": session.block, "temperature_C": session.temperature_C}
    return json.dumps({**known, "world": record_to_json(session.world)})


def _measure_turret(
    loop: ClosedLoop, session: DiagnosisSession, tick: int, rng: np.random.Generator
) -> list[tuple[int, Pose, Array]]:
    """Measure the turret pose with the tracker; nothing if too few targets are visible."""
    loop.plant.truth()  # updates the kinematics
    try:
        seen = measure_pose(
            TYPICAL_TRACKER, loop.plant, session.world.tilt_roll_rad, turret_pose(loop.plant), rng
        )
    except TooFewTargets:
        return []
    return [(tick, seen.X_RT, np.sqrt(np.diag(seen.covariance)))]


def split_logs(folder: Path) -> tuple[list[Path], list[Path]]:
    """Split the logs of a folder into those that are fitted and those that are held out."""
    logs = sorted(folder.glob("*.mcap"))
    return [log for log in logs if log.stem not in HELD_OUT_SESSIONS], [
        log for log in logs if log.stem in HELD_OUT_SESSIONS
    ]


def _choose_sessions(request: RecordRequest, arm: BuiltArm) -> list[DiagnosisSession]:
    """Return the sessions of the campaign that a request asks for.

    BadRequest if there is none, RobotError if the file of a motion is wrong.
    """
    if request.motion is not None:
        return [make_session(read_motion(request.motion), arm.params)]
    every = campaign_sessions(arm.params)
    chosen = [session for session in every if fnmatchcase(session.name, request.sessions)]
    if not chosen:
        raise BadRequest(
            f"sessions: nothing is called {request.sessions!r}; "
            f"{did_you_mean(request.sessions, [session.name for session in every])}"
        )
    return chosen


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
    reference, paths, left_out = true_reference(arm), [], []
    try:
        with atomic_path(request.out.resolve()) as part:
            part.mkdir(parents=True, exist_ok=True)
            comments = ["Flight parameters of these logs; all others are nominal."]
            (part / PARAMS_FILE).write_text(params_toml(arm.model.params, arm.params, comments))
            for number, session in enumerate(wanted):
                progress(number, len(wanted), session.name)
                folder = part / HELD_OUT_FOLDER if session.name in HELD_OUT_SESSIONS else part
                seed = request.seed + number
                made = record_campaign(folder, [session], arm, reference, seed, lambda *_: None, begun)
                paths += [request.out / log.relative_to(part) for log in made]
                left_out += [] if made else [session.name]
            if not paths:
                raise BadRequest("effect: the arm completes no session; with smaller effects it may")
    except OSError as error:
        raise BadRequest(f"out {request.out}: cannot be written ({error.strerror or error})") from error
    progress(len(wanted), len(wanted), "recorded")
    return RecordedLogs(tuple(paths), tuple(left_out))
