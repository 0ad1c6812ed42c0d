"""The arm's campaign and cases in the terms of the robot-agnostic part."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

from ground.gap.arm.bound import bound
from ground.gap.arm.campaign import compared
from ground.gap.arm.floor import floor_of
from ground.gap.arm.logs import Recording, recording_in
from ground.gap.arm.reference import Reference, reference
from ground.gap.arm.sensitivities import arm_sensitivities
from ground.gap.arm.simulator import CALMLY, ArmSimulator
from ground.gap.blind.evidence import Features, Kept, Measured
from ground.gap.layout import Layout
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
    against = reference_campaign(campaign)
    kept = kept_campaign(campaign)
    fitted, held = ([recording_in(log) for log in logs] for logs in split(case))
    return Features(
        _measured(fitted, kept.fitted.layout, against.keys),
        _measured(held, kept.held.layout, against.held_out_keys),
    )


def _measured(recordings: list[Recording], layout: Layout, keys: Iterable[str]) -> Measured:
    if not recordings:
        return Measured(np.zeros(0, np.intp), np.zeros(0))
    there = compared(recordings, nominal_params())
    arm = ArmSimulator(there, nominal_params(), floor_of(there).sigma, manner=CALMLY)
    here = bound(arm, layout, tuple(keys))
    return Measured(here.rows, here.gap())


@cache
def _known(campaign: Path) -> tuple[Reference, Kept]:
    return known(campaign, on_this_machine(1), lambda *_: None)
