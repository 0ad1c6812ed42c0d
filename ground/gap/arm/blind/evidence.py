"""The arm's campaign and cases in the terms of the robot-agnostic part."""

from functools import cache
from pathlib import Path

import numpy as np

from ground.gap.arm.bound import Bound
from ground.gap.arm.case import fitted_part, held_out_part
from ground.gap.arm.logs import recording_in
from ground.gap.arm.reference import Reference, reference
from ground.gap.arm.sensitivities import arm_sensitivities
from ground.gap.blind.evidence import Features, Kept, Measured
from ground.pool import Runner, on_this_machine
from ground.progress import Progress
from sim.diagnosis.campaign import HELD_OUT
from sim.params import nominal_params


def split(folder: Path) -> tuple[list[Path], list[Path]]:
    """A folder's logs: those that a diagnosis is made of, and those that are held out."""
    logs = sorted(folder.glob("*.mcap"))
    return [log for log in logs if log.stem not in HELD_OUT], [log for log in logs if log.stem in HELD_OUT]


def known(campaign: Path, run: Runner, progress: Progress) -> tuple[Reference, Kept]:
    """All that is known of a campaign before cases; kept beside its logs, computed where it is not."""
    fitted, held = split(campaign)
    found = reference(fitted, held, campaign, run, progress)
    return found, Kept(found.ready.found, arm_sensitivities(held, campaign, run, progress))


def kept_campaign(campaign: Path) -> Kept:
    """Its sensitivities, read once in each process."""
    return _known(campaign)[1]


def reference_campaign(campaign: Path) -> Reference:
    """All else that is known of it, likewise."""
    return _known(campaign)[0]


def features(case: Path, campaign: Path) -> Features:
    """What a case's logs say less what the nominal simulator predicts under the same drive."""
    against, base = reference_campaign(campaign), nominal_params()
    fitted, held = ([recording_in(log) for log in logs] for logs in split(case))
    here, _ = fitted_part(fitted, against, base)
    return Features(_measured(here), _measured(held_out_part(held, against, base)))


def _measured(part: Bound | None) -> Measured:
    return Measured(np.zeros(0, np.intp), np.zeros(0)) if part is None else Measured(part.rows, part.gap())


@cache
def _known(campaign: Path) -> tuple[Reference, Kept]:
    return known(campaign, on_this_machine(1), lambda *_: None)
