"""One case: an arm's recordings beside a campaign whose sensitivities are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.arm.at_tool import tool_gap
from ground.diagnosis.arm.audit import audit
from ground.diagnosis.arm.bound import Bound, bound
from ground.diagnosis.arm.campaign import compared
from ground.diagnosis.arm.floor import floor_of
from ground.diagnosis.arm.logs import NotForDiagnosis, Recording
from ground.diagnosis.arm.reference import Reference
from ground.diagnosis.arm.settled import settled
from ground.diagnosis.arm.simulator import CALMLY, ArmSimulator, arm_simulator
from ground.diagnosis.closure import Closure, apart_from
from ground.diagnosis.diagnose import Diagnosis, diagnose
from ground.diagnosis.duel import Duel
from ground.diagnosis.held_out import left_on, settings_of
from ground.diagnosis.layout import Evidence
from ground.diagnosis.next_motion import again
from ground.diagnosis.ready import Ready, ready
from ground.diagnosis.result import Result, ToolGap
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect

LEAST_SHARE: Final = 0.5
"""Of the campaign's features that a case must have, else there is too little motion."""
NOISIER: Final = 1.2
"""Repeats that differ by so many times the floor of the campaign make a floor of their own."""


class TooLittleMotion(NotForDiagnosis):
    """A case that lacks most of the campaign; the message says which motions."""


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A case in the campaign's features, the simulator asked about the nuisances that it has."""

    known: Ready
    """Of the campaign, in the features that the case has."""
    case: Bound
    gap: Array
    """Measured less simulated with nuisances at 0, in straight lines from where they are, (m,)."""
    duel: Duel | None
    """Between what explains it best and what does so nearly as well, if anything does."""
    held_out: Bound | None
    held_out_gap: Array
    """The same of motion that takes no part."""
    notes: tuple[str, ...]
    """Of the audit."""
    floor: tuple[str, ...]
    """Where the floor is from."""


def solved(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    against: Reference,
    seed: int,
    patch: tuple[Effect, ...] = (),
) -> Result:
    """Of a case's recordings, beside a simulator with the effects of a patch.

    Raises:
        TooLittleMotion: most motions of the campaign are missing.
    """
    return said_of(asked(recordings, held_out, against, patch), against, seed)


def asked(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    against: Reference,
    patch: tuple[Effect, ...] = (),
) -> Asked:
    """What a diagnosis is made of; TooLittleMotion as `solved`."""
    if not recordings:
        raise TooLittleMotion("there is no log that a diagnosis could be made of")
    recordings, held_out = (sorted(some, key=attrgetter("name")) for some in (recordings, held_out))
    layout = against.ready.found.layout
    arm, floor = _simulator(recordings, against, patch)
    # without a patch the simulator has what it had of the campaign
    first = bound(arm, layout, against.keys, None if patch else against.ready.found.nominal)
    _check_motion(first, against)
    known = _ready(against.ready, first)
    notes = (*audit(recordings), *_lacking(first, against), *_borrowed(known, against))
    best = settled(known, first, patch)
    apart = _held_out_part(held_out, against, best.case.arm.patch)
    there = np.zeros(0)
    if apart is not None and against.held_out is not None:
        there = apart.gap() + against.held_out.nuisance[apart.rows] @ best.nuisance
    return Asked(known, best.case, best.gap, best.duel, apart, there, notes, floor)


def said_of(here: Asked, against: Reference, seed: int) -> Result:
    """The diagnosis."""
    evidence = Evidence(here.known.found.layout, here.gap)
    told = diagnose(here.known, evidence, seed, here.case, here.duel)
    shut, at_tool = _tried(told, here, against, seed)
    return Result(here.known, told, shut, at_tool, again(here.known, told), here.notes, here.floor)


def _held_out_part(
    recordings: Sequence[Recording], against: Reference, patch: tuple[Effect, ...]
) -> Bound | None:
    """What it is tried on; None if nothing is held out.

    Raises:
        TooLittleMotion: nothing of it is comparable.
    """
    if against.held_out is None or not recordings:
        return None
    arm, _ = _simulator(recordings, against, patch)
    found = bound(arm, against.held_out.layout, against.held_out_keys)
    if not found.rows.size:
        names = ", ".join(one.name for one in recordings)
        raise TooLittleMotion(f"held out: nothing in {names} can be compared with the campaign")
    return found


def _simulator(
    recordings: Sequence[Recording], against: Reference, patch: tuple[Effect, ...]
) -> tuple[ArmSimulator, tuple[str, ...]]:
    campaign = compared(recordings)
    floor = floor_of(campaign)
    raced = dict.fromkeys(hypothesis.effect for hypothesis in against.ready.found.hypotheses)
    kinds = {name: catalogue()[name] for name in raced}
    return arm_simulator(campaign, floor.sigma, kinds, CALMLY, patch), floor.notes


def _ready(against: Ready, case: Bound) -> Ready:
    """Of the features that the case has, with its own floor where that is higher."""
    found = against.found.of(case.rows)
    higher = np.maximum(found.layout.sigma, case.layout.sigma)
    if len(case.rows) == against.found.layout.size and np.all(higher < NOISIER * found.layout.sigma):
        return against
    layout = replace(found.layout, sigma=higher)
    return ready(replace(found, layout=layout), 0, thresholds=against.thresholds)


def _tried(
    told: Diagnosis, here: Asked, against: Reference, seed: int
) -> tuple[Closure | None, ToolGap | None]:
    """On held-out motion, as a share and at the tools; None if there is none, or no tracker looked."""
    case = here.held_out
    if against.held_out is None or case is None:
        return None, None
    settings, zero = settings_of(told), np.zeros(len(case.nuisances))
    change = case.predict(settings, zero) - case.predict({}, zero)
    apart = apart_from(here.known.prepared, against.held_out.of(case.rows))
    left = left_on(told, apart, here.held_out_gap, change)
    keys = [against.held_out_keys[row] for row in case.rows]
    return left.closure(seed), tool_gap(keys, left.before, left.after, apart.sigma)


def _check_motion(case: Bound, against: Reference) -> None:
    layout = against.ready.found.layout
    if case.rows.size >= LEAST_SHARE * layout.size:
        return
    raise TooLittleMotion(
        f"{case.rows.size} of the campaign's {layout.size} features are in these logs; "
        f"nothing comparable is there of: {', '.join(_missing(case, against))}"
    )


def _lacking(case: Bound, against: Reference) -> list[str]:
    """What is to be said of sessions that the campaign has and the case has not."""
    missing = _missing(case, against)
    return (
        [f"of the campaign's motions nothing comparable is there of {', '.join(missing)}"] if missing else []
    )


def _borrowed(known: Ready, against: Reference) -> list[str]:
    """What is to be said of thresholds that were found for other features, or for a lower floor."""
    if known is against.ready:
        return []
    return ["thresholds are those of the whole campaign with its own floor, which this is not"]


def _missing(case: Bound, against: Reference) -> list[str]:
    return sorted(set(_sessions(against.keys)) - set(_sessions([against.keys[k] for k in case.rows])))


def _sessions(keys: Sequence[str]) -> list[str]:
    return [key.split("/", 1)[0] for key in keys]
