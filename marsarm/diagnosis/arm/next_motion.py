"""Command `gap next`: diagnoses logs, simulates planned motions, and proposes the best one."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from marsarm.diagnosis.arm.campaign_sensitivities import compute_sensitivities
from marsarm.diagnosis.arm.diagnose_logs import (
    diagnose_logs,
    drawing,
    flight_params,
    prepare_diagnosis,
)
from marsarm.diagnosis.arm.planned_motion import PlannedMotion, list_motions, make_session, motion_text
from marsarm.diagnosis.arm.record import record_campaign
from marsarm.diagnosis.arm.request import NextRequest
from marsarm.diagnosis.next_motion import propose_motion
from marsarm.diagnosis.selection import FeatureEffect
from sim.arms import BuiltArm
from sim.initialisation import true_reference
from simgap.common.files import cache_folder, file_sha256, json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin
from simgap.common.progress import Progress, no_progress, part_of
from simgap.next_motion.proposal import Proposal
from simgap.next_motion.rivals import choose_rivals
from simgap.report.next_motion import save_next_files

DIAGNOSED: Final = 0.4
"""Share of the time that the diagnosis takes, for the progress, if the campaign is not cached."""
RECORDED: Final = 0.5
"""Share after the planned motions are recorded."""


@dataclass(frozen=True, slots=True)
class NextArmMotion:
    """A proposal with what its files need."""

    request: NextRequest
    proposal: Proposal
    motion: PlannedMotion
    """The best motion."""
    origin: Origin


def propose_next(request: NextRequest, progress: Progress = no_progress) -> NextArmMotion:
    """Diagnose logs and propose a motion; write no file but caches.

    BadRequest and NotForDiagnosis as in `diagnose`, RobotError if nothing is left to tell apart, and
    PlantDiverged if a simulated arm broke.
    """
    job = prepare_diagnosis(request)
    case = diagnose_logs(job, part_of(progress, 0.0, DIAGNOSED))
    assert case.model is not None
    group = choose_rivals(case.diagnosis.rivals)
    acting = [one for rival in group for one in rival.effects if isinstance(one, FeatureEffect)]
    kinds = tuple(dict.fromkeys(one.hypothesis.effect for one in acting))
    places = {rival.effect.partition(".")[0].partition(":")[0] for rival in group}
    motions = {one.name: one for one in list_motions(places)}
    params = flight_params(job)
    sessions = [make_session(one, params) for one in motions.values()]
    arm = BuiltArm(job.arm, (), params, drawing(job))
    with TemporaryDirectory() as scratch:
        recording = part_of(progress, DIAGNOSED, RECORDED)
        logs = record_campaign(Path(scratch), sessions, arm, true_reference(arm), job.seed, recording)
        kept_in, rest = cache_folder("marsarm", "sensitivities"), part_of(progress, RECORDED, 1.0)
        planned = compute_sensitivities(logs, kept_in, job.run, rest, kinds, (), job.arm)
    words = {name: one.describe() for name, one in motions.items()}
    made = propose_motion(case.model, case.diagnosis.rivals, planned, words)
    name = next(one for one in motions if words[one] == made.motions[made.choice.motions[0]])
    digests = {"logs": json_sha256({"sha256": sorted(map(file_sha256, job.logs))})}
    origin = Origin(command_text("marsarm gap next", request), digests)
    return NextArmMotion(request, made, motions[name], origin)


def save_files(made: NextArmMotion) -> list[str]:
    """Write the files of a request, and return a line about each; BadOutput if one cannot be written."""
    request = made.request
    return save_next_files(
        made.proposal,
        {"motion": request.out},
        lambda: motion_text(made.motion),
        request.report,
        made.origin,
    )
