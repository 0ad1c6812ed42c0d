"""The arm's campaign and cases in the terms of the robot-agnostic part."""

from functools import cache
from pathlib import Path

import numpy as np

from ground.common.pool import Runner, local_runner
from ground.common.progress import Progress
from ground.common.requests import BadRequest
from ground.diagnosis.arm.case import Asked
from ground.diagnosis.arm.reference import Reference, reference
from ground.diagnosis.blind.evidence import Features, Kept, Measured
from sim.diagnosis_campaign import HELD_OUT_SESSIONS


def split(folder: Path) -> tuple[list[Path], list[Path]]:
    """A folder's logs: those that a diagnosis is made of, and those that are held out."""
    logs = sorted(folder.glob("*.mcap"))
    return [log for log in logs if log.stem not in HELD_OUT_SESSIONS], [
        log for log in logs if log.stem in HELD_OUT_SESSIONS
    ]


def known(campaign: Path, run: Runner, progress: Progress) -> Reference:
    """All that is known of a campaign before cases; kept beside its logs, computed where it is not.

    Raises:
        BadRequest: its logs are not there, or what is kept cannot be read.
    """
    fitted, held = split(campaign)
    if not fitted or not held:
        raise BadRequest(f"{campaign}: lacks the campaign's logs; `marsarm gap blind make` records them")
    return reference(fitted, held, campaign, run, progress)


def kept_campaign(campaign: Path) -> Kept:
    """Its sensitivities."""
    found = reference_campaign(campaign)
    assert found.held_out is not None  # `known` refuses a campaign without
    return Kept(found.ready.found, found.held_out)


@cache
def reference_campaign(campaign: Path) -> Reference:
    """All that is known of it, read once in each process."""
    return known(campaign, local_runner(1), lambda *_: None)


def features(here: Asked) -> Features:
    """What a case's logs say, as its diagnosis has it."""
    apart = here.held_out
    rows = np.zeros(0, np.intp) if apart is None else apart.rows
    return Features(Measured(here.case.rows, here.gap), Measured(rows, here.held_out_gap))
