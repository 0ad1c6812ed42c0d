"""Carries out the campaign and keeps its logs, and beside each what a laser tracker saw."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array, Pose, stack_poses
from ground.calibration.survey import TooFewTargets, measure_pose
from ground.common.progress import Progress
from ground.diagnosis.arm.tracked import Tracked, none_tracked, write_tracked
from ground.telemetry.header import SESSION, flight_header
from ground.telemetry.json_codec import record_to_json
from ground.telemetry.recorder import Recorder
from sim.arms import BuiltArm
from sim.diagnosis_campaign import DiagnosisSession, run_session, start_session
from sim.effects.effect import Effect
from sim.loop import ClosedLoop
from sim.tracker import TYPICAL_TRACKER, turret_pose


def record_campaign(
    folder: Path,
    sessions: Sequence[DiagnosisSession],
    arm: BuiltArm,
    reference: Reference,
    seed: int,
    progress: Progress,
    effects: tuple[Effect, ...] = (),
) -> list[Path]:
    """A log of each session, without the truth: nothing in it says what the plant was made of.

    Raises:
        SessionFailed: a motion did not come to its end.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, session in enumerate(sessions):
        progress(number, len(sessions), session.name)
        loop = start_session(
            session, arm, reference, int(np.random.default_rng([seed, number]).integers(2**31)), effects
        )
        paths.append(_record(folder / f"{session.name}.mcap", session, loop, seed + number))
    return paths


def _record(path: Path, session: DiagnosisSession, loop: ClosedLoop, seed: int) -> Path:
    rng = np.random.default_rng([seed, 7])
    header = {**flight_header(loop, session.commands), SESSION: conditions(session)}
    rows: list[tuple[int, Pose, Array]] = []
    with Recorder(path, header) as recorder:
        for moment in run_session(loop, session):
            recorder.write(moment.record)
            if moment.rested and session.tracked:
                rows += _looked(loop, session, moment.record.tick, rng)
    if session.tracked:
        write_tracked(path.with_suffix(".tracker.csv"), _stacked(rows))
    return path


def conditions(session: DiagnosisSession) -> str:
    """What those who did it know of a session, in JSON."""
    known = {"name": session.name, "block": session.block, "temperature_C": session.temperature_C}
    return json.dumps({**known, "world": record_to_json(session.world)})


def _looked(
    loop: ClosedLoop, session: DiagnosisSession, tick: int, rng: np.random.Generator
) -> list[tuple[int, Pose, Array]]:
    """The turret as the tracker sees it at the start of the next cycle; nothing if it does not."""
    loop.plant.truth()  # brings the kinematics up to date
    try:
        seen = measure_pose(
            TYPICAL_TRACKER, loop.plant, session.world.tilt_roll_rad, turret_pose(loop.plant), rng
        )
    except TooFewTargets:
        return []
    return [(tick, seen.X_RT, np.sqrt(np.diag(seen.covariance)))]


def _stacked(rows: list[tuple[int, Pose, Array]]) -> Tracked:
    if not rows:
        return none_tracked()
    ticks, poses, sigmas = zip(*rows, strict=True)
    return Tracked(np.array(ticks, np.int64), stack_poses(poses), np.stack(sigmas, -1))
