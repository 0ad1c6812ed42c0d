"""Command `gap next`: diagnoses logs, simulates planned motions, and proposes the best one.

The best motion tells the rivals of a finding apart, by sensitivities of planned motions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.common.pool import select_runner
from marsarm.common.requests import select_arm
from marsarm.diagnosis.arm import record
from marsarm.diagnosis.arm.campaign_sensitivities import compute_sensitivities
from marsarm.diagnosis.arm.diagnose_logs import diagnose
from marsarm.diagnosis.arm.request import NextRequest
from marsarm.diagnosis.model import DiagnosisModel, build_whitener, whiten_nuisances
from marsarm.diagnosis.problem import Departures, Hypothesis, Ints, Sensitivities
from sim.initialisation import true_reference
from simgap.common.errors import RobotError
from simgap.common.files import cache_folder
from simgap.common.options import command_text
from simgap.common.page import Origin
from simgap.common.progress import Progress, as_guess, no_progress, part_of
from simgap.next_motion.proposal import Curve, Proposal
from simgap.next_motion.rivals import choose_rivals, is_sure
from simgap.next_motion.separation import Slopes, choose_motion, find_deviations
from simgap.report.next_motion import save_next_files
from simgap.report.sentences import verdict_lines
from simgap.result import Diagnosis, Rival

DIAGNOSED: Final = 0.4
"""Share of the time that the diagnosis takes, for the progress, if the campaign is not cached."""
RECORDED: Final = 0.5
"""Share after the planned motions are recorded."""
MOST_DRAWN: Final = 4
"""Channels that are drawn at most."""


@dataclass(frozen=True, slots=True)
class NextArmMotion:
    """A proposal with what its files need."""

    request: NextRequest
    proposal: Proposal
    motion: record.PlannedMotion
    """The best motion."""
    origin: Origin


def propose_next(request: NextRequest, progress: Progress = no_progress) -> NextArmMotion:
    """Diagnose logs and propose a motion; write no file but caches.

    BadRequest and NotForDiagnosis as in `diagnose`, RobotError if nothing is left to tell apart, and
    PlantDiverged if a simulated arm broke.
    """
    progress = as_guess(progress)
    case = diagnose(request, part_of(progress, 0.0, DIAGNOSED))
    assert case.model is not None
    assert case.params is not None
    group = _choose_rivals(case.diagnosis)
    kinds = tuple(dict.fromkeys(one.name for rival in group for one in rival.effects))
    places = {rival.effect.partition(".")[0].partition(":")[0] for rival in group}
    known = (*case.diagnosis.fitted_motions, *case.diagnosis.judged_motions)
    motions = {one.name: one for one in record.list_motions(case.params, places, known)}
    arm = replace(select_arm(request.arm, None), effects=(), params=case.params)
    sessions = [record.make_session(one, arm.params) for one in motions.values()]
    with TemporaryDirectory() as scratch:
        recording = part_of(progress, DIAGNOSED, RECORDED)
        made_of = arm, true_reference(arm), request.seed
        logs = record.record_campaign(Path(scratch), sessions, *made_of, recording)
        kept_in, rest = cache_folder("marsarm", "sensitivities"), part_of(progress, RECORDED, 1.0)
        run = select_runner(request.workers, request.cluster)
        planned = compute_sensitivities(logs, kept_in, run, rest, kinds, (), request.arm)
    origin = Origin(command_text("marsarm gap next", request), case.digests)
    return NextArmMotion(request, *propose_motion(case.model, group, planned, motions), origin)


def _choose_rivals(diagnosis: Diagnosis) -> list[Rival]:
    """Return the finding in most doubt and its rivals; RobotError says what was found if there is none."""
    try:
        return choose_rivals(diagnosis.rivals)
    except RobotError as error:
        raise RobotError("\n".join([f"{error}; these logs say:", *verdict_lines(diagnosis)])) from error


def propose_motion(
    model: DiagnosisModel,
    group: Sequence[Rival],
    planned: Sensitivities,
    motions: Mapping[str, record.PlannedMotion],
) -> tuple[Proposal, record.PlannedMotion]:
    """Propose the motion that tells the rivals of a finding apart, the finding first; return it too.

    Calibration errors and sizes of effects are fitted again, with what the earlier motions say of them. The
    sensitivities of planned motions have the effects of these rivals; each is a block with its name.
    """
    settings = [_departures(one) for one in group]
    changes = np.array([planned.change(own) for own in settings])
    white = build_whitener(planned)(changes.T).T
    new = [_slopes(planned, own) for own in settings]
    old = [_slopes(model.sensitivities, own) for own in settings]
    q = len(planned.shared_nuisances)
    priors = [np.where(np.arange(one.shape[1]) < q, 1.0, np.inf) for one in new]
    slopes = [one @ find_deviations(*known) for one, *known in zip(new, old, priors, strict=True)]
    blocks = [*dict.fromkeys(planned.layout.block.tolist())]
    rows = [np.flatnonzero(planned.layout.block == block) for block in blocks]

    def differentiate(some: Sequence[int]) -> list[Slopes]:
        return [[one[rows[m]] for one in slopes] for m in some]

    choice = choose_motion([white[:, own] for own in rows], differentiate, [one.p for one in group])
    words = tuple(motions[block].describe() for block in blocks)
    curves = tuple(_draw(planned, changes, rows[choice.motions[0]]))
    keys = tuple(one.effect for one in group)
    made = Proposal(group[0].finding, keys, is_sure(group), words, choice, curves)
    return made, motions[blocks[choice.motions[0]]]


def _departures(rival: Rival) -> Departures:
    pairs = zip(rival.effects, rival.sizes, strict=True)
    return {one: np.array(size) for one, size in pairs if isinstance(one, Hypothesis)}


def _slopes(sensitivities: Sensitivities, settings: Departures) -> Array:
    """Return whitened changes by shared nuisances, in their sigmas, and by effects, in typical sizes."""
    owners = [sensitivities.index(one.key) for one in settings]
    columns: Ints = np.concatenate([np.flatnonzero(sensitivities.owner == k) for k in owners])
    reach = sensitivities.reach[columns]
    at = np.clip(np.concatenate([*settings.values()]), -reach, reach)  # beyond, it goes on as a line
    slope = sensitivities.effect[:, columns] + 2.0 * at * sensitivities.curve[:, columns]
    whiten = build_whitener(sensitivities)
    return np.hstack([whiten_nuisances(sensitivities, whiten), whiten(slope)])


def _draw(planned: Sensitivities, changes: Array, rows: Ints) -> list[Curve]:
    """Draw what rivals predict in the channels in which they differ most, and by more than the noise."""
    layout, curves = planned.layout, []
    for channel in dict.fromkeys(layout.channel[rows].tolist()):
        own = rows[layout.channel[rows] == channel]
        own = own[np.argsort(layout.time_s[own])]
        if own.size == 1:  # a reading at rest
            continue
        predicted, noise = changes[:, own], float(np.mean(layout.sigma[own]))
        differing = predicted - predicted.mean(axis=0)
        curves.append(Curve(channel, str(layout.unit[own[0]]), layout.time_s[own], differing, noise))
    peaks = [float(np.max(np.abs(one.values))) / one.noise for one in curves]
    order = sorted(range(len(curves)), key=lambda k: -peaks[k])[:MOST_DRAWN]
    return [curves[k] for k in order if peaks[k] > 1.0]


def save_files(made: NextArmMotion) -> list[str]:
    """Write the files of a request, and return a line about each; BadOutput if one cannot be written."""
    out, report = {"motion": made.request.out}, made.request.report
    return save_next_files(made.proposal, out, lambda: record.motion_text(made.motion), report, made.origin)
