"""Sealed cases of a servo that swings a weight, with the poor model that people have of one.

The robot plug-in with another truth (`servo_truth`), other shares of kinds, and the bars of poor models.

Cases of the next motion: a proposed motion settles what a verdict left open. Each case is diagnosed. Where
the finding in most doubt is a set or a place, or another effect is named, a motion is proposed. The true
servo makes it, and the case is diagnosed again with its log. The truth takes part in solving as the servo
does: it makes the motion, and says which cases count.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from marsarm.common.rates import check_rate, clopper_pearson
from simgap.catalogue.catalogue import catalogue
from simgap.checks.audit import audit
from simgap.common.errors import RobotError
from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.logs import JointLog, Logs, Motion, Signal, Usable
from simgap.next_motion.proposal import propose_motion
from simgap.next_motion.rivals import choose_rivals
from simgap.result import Diagnosis
from simgap.robot import Robot
from validation.campaigns import Context, Document
from validation.cases import robot_draw, sealed
from validation.cases.robot import DIAGNOSIS_SEED, RobotCases, find_robot_file, to_document
from validation.cases.robot_draw import Kind, Truth
from validation.cases.robot_score import SealedCase, first_choice, members, pair_up, plain_place
from validation.cases.robot_setup import ADDED, PERIOD_S, SERVOS
from validation.cases.robot_truth import TRUE_STEP_S
from validation.cases.sealed import CaseScore, score_bars
from validation.cases.servo_truth import ServoPlant

KIND_SHARES: Final[dict[Kind, float]] = {"none": 1 / 3, "single": 14 / 60, "pair": 13 / 60, "triple": 13 / 60}
"""Shares of all cases: 20, 14, 13 and 13 of 60."""
CLEAR: Final = 2.0
"""Strength, in family-wise limits, above which an effect should be reported."""
LISTED: Final = 3
"""Most effects that a verdict lists: with more, none is named."""


@dataclass(frozen=True, slots=True)
class ServoCases(RobotCases):
    """Cases of servos with poor models."""

    name: ClassVar[str] = "servo-cases"
    kinds: ClassVar[dict[Kind, float]] = KIND_SHARES
    is_audited: ClassVar[bool] = True

    def score(self, folder: Path, solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
        return score_cases(solved)


def score_cases(solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
    """Score solved cases: what is sure must be right, and what is clear must be seen and named."""
    paired = [pair_up(case, list(result["findings"])) for case, result in solved]
    clear = [pair for pairs, _ in paired for pair in pairs if pair.effect.times_limit > CLEAR]
    given = [(pair, pair.finding) for pairs, _ in paired for pair in pairs if pair.finding is not None]
    named = [(pair, one) for pair, one in given if 1 <= len(one["effects"]) <= LISTED]
    quiet = [result for case, result in solved if case.truth.kind == "none"]
    sure = [is_sure_and_wrong(*one) for one in solved]
    shown = [pair.finding for pair in clear]
    short = [one is not None and 1 <= len(one["effects"]) <= LISTED for one in shown]
    right = [first_choice(one) in pair.accepted for pair, one in named]
    bars = {
        "sure and wrong": check_rate(sure, 0.02, True),
        "reported": check_rate((one is not None for one in shown), 0.80, False),
        "named": check_rate(short, 0.60, False),
        "right effect of those named": check_rate(right, 0.88, False),
        "false alarms": check_rate((bool(one["findings"]) for one in quiet), 0.05, True),
    }
    return score_bars(bars, len(solved), {"cpu seconds": sum(one["seconds"] for _, one in solved)})


def is_sure_and_wrong(case: SealedCase, result: Document) -> bool:
    """Return whether a finding has one effect in its set, which no true effect of the case is like."""
    true = {(name, place) for one in case.equivalents for name, place in one}
    return any(len(one["effects"]) == 1 and not members(one) <= true for one in result["findings"])


def campaign(context: Context, cases: int = 60, step: str = "all", partial: bool = False) -> Document:
    """Make, solve and score sealed cases of servos as `run_steps` does."""
    return sealed.run_steps(context, ServoCases(tuple(SERVOS)), cases, step, partial)


NEXT_SHARES: Final[dict[Kind, float]] = {"single": 0.5, "pair": 0.5}
BAR: Final = 18 / 24
"""Least share of the cases that one motion settles."""
NEXT_NUMBER: Final = 12
"""Number of the first run of the new motion after those of a case, for its seed."""

HOLDS: Final = {
    "constant torque": ("asymmetric friction", "spring"),
    "asymmetric friction": ("constant torque", "spring"),
    "position-dependent torque": ("link centre",),
}
"""Effects that are a true one exactly, whatever a servo does, where dry friction and armature are fitted.

Friction in one direction is a constant torque beside other dry friction. So is a spring without stiffness. A
weight beside its line pulls as a torque does that follows the angle, and an armature has its inertia."""


@dataclass(frozen=True, slots=True)
class NextCases(ServoCases):
    """Cases of servos, each diagnosed again with one more motion if the first verdict left something open."""

    name: ClassVar[str] = "next-cases"
    kinds: ClassVar[dict[Kind, float]] = NEXT_SHARES

    def solve(self, folder: Path, case: Path) -> Document:
        """Diagnose a log, and again with the proposed motion where that counts."""
        truth = next(one for one in sealed.load_truth(folder, self).cases if one.name == case.stem)
        robot = Robot.from_toml(find_robot_file(folder, case.stem))
        logs = load(robot, case)
        try:
            found, usable = _diagnose(robot, logs)
        except RobotError as why:
            return {"findings": [], "refused": str(why)}
        before = to_document(found)
        try:
            key = choose_rivals(found.rivals)[0].finding
        except RobotError:
            return before
        open_as = say_what_is_open(truth, before, key, {one.name for one in catalogue(robot, logs)})
        if not open_as:
            return before
        proposal, motion = propose_motion(robot, logs, found.rivals, usable)
        told = {
            "finding": key,
            "open": open_as,
            "motion": proposal.motions[proposal.choice.motions[0]],
            "rivals": list(proposal.rivals),
            "sigmas": proposal.choice.sigmas[0].tolist(),
            "tells apart": proposal.choice.tells_apart,
        }
        more = [make_next(truth.truth, motion, run) for run in range(proposal.runs)]
        after, _ = _diagnose(robot, replace(logs, motions=(*logs.motions, *more)))
        return {**before, "next": told, "after": to_document(after)}

    def score(self, folder: Path, solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
        """Count the cases that the motion settles, by what was open, with a 90 % interval."""
        tried = [(case, result) for case, result in solved if "next" in result]
        settled = [is_settled(case, result) for case, result in tried]
        pairs = [(result["next"]["open"], done) for (_, result), done in zip(tried, settled, strict=True)]
        named = ("set", "place", "wrong name")
        groups = {name: [done for open_as, done in pairs if open_as == name] for name in named}
        bars = {"settled by one motion": check_rate(settled, BAR, False)}
        counts = {name: f"{sum(own)} of {len(own)}" for name, own in groups.items()}
        more = {
            "settled": counts,
            "interval 90 %": [*clopper_pearson(sum(settled), len(settled), 0.9)],
            "cpu seconds": sum(one["seconds"] for _, one in solved),
        }
        return score_bars(bars, len(solved), more)


def _diagnose(robot: Robot, logs: Logs) -> tuple[Diagnosis, Usable]:
    found = audit(robot, logs)
    result = diagnose(robot, logs.fit, held_out=logs.judged, audit=found, seed=DIAGNOSIS_SEED)
    return result, found.usable


def list_accepted(
    case: SealedCase, findings: Sequence[Mapping[str, Any]], key: str
) -> list[frozenset[tuple[str, str]]]:
    """Return the class of the effect that a finding names first; of none, those that no finding names first.

    An equivalence class also has what `HOLDS` the true effect: no motion takes that out of a set.
    """
    classes = tuple(
        (*same, *((other, one.place) for other in HOLDS.get(one.name, ())))
        for one, same in zip(case.truth.effects, case.equivalents, strict=True)
    )
    pairs, _ = pair_up(replace(case, equivalents=classes), list(findings))
    right = [one for one in pairs if one.finding and first_choice(one.finding) in one.accepted]
    own = [one for one in right if one.finding and _key(one.finding) == key]
    return [one.accepted for one in own or [pair for pair in pairs if pair not in right]]


def say_what_is_open(case: SealedCase, result: Document, key: str, known: Set[str]) -> str:
    """Return what a finding leaves open: a set with the right name, a place, wrong names; empty if nothing.

    Nothing is left open by the right name, or by a place without one if the catalogue knows no right name.
    """
    finding = next(one for one in result["findings"] if _key(one) == key)
    accepted = list_accepted(case, result["findings"], key)
    if not finding["effects"]:
        return "place" if known & {name for own in accepted for name, _ in own} else ""
    if any(is_named(case, finding, one) for one in accepted):
        return ""
    return "set" if members(finding) & frozenset().union(*list_accepted(case, (), "")) else "wrong name"


def is_settled(case: SealedCase, result: Document) -> bool:
    """Return whether the right effect is named after the motion, or a wrong name is withdrawn."""
    told, after = result["next"], result["after"]["findings"]
    accepted = list_accepted(case, result["findings"], told["finding"])
    if any(is_named(case, one, own) for one in after for own in accepted):
        return True
    true = frozenset().union(*list_accepted(case, (), ""))
    wrong = [one for one in after if one["effects"] and not members(one) & true]
    return told["open"] == "wrong name" and not wrong


def is_named(case: SealedCase, finding: Mapping[str, Any], accepted: Set[tuple[str, str]]) -> bool:
    """Return whether a set holds an effect that is sealed, and nothing that is not accepted."""
    true = {(name, plain_place(place)) for one in case.equivalents for name, place in one}
    return not members(finding).isdisjoint(true) and members(finding) <= accepted


def _key(finding: Mapping[str, Any]) -> str:
    return f"{finding['place']}: {finding['effect']}"


def make_next(truth: Truth, planned: Motion, run: int) -> Motion:
    """Let the true servo make a motion once more, and return its log."""
    campaign = robot_draw.make_campaign(truth.seed, truth.model)
    effects = [robot_draw.make_effect(one, campaign.plan.scene) for one in truth.effects]
    added_kg = planned.conditions[ADDED]
    plant = ServoPlant(campaign.robot, campaign.nuisances, effects, TRUE_STEP_S, added_kg)
    ((name, log),) = planned.joints.items()
    assert log.command is not None
    assert log.enabled is not None
    assert log.temperature is not None
    number, times_s, gain = NEXT_NUMBER + run, log.position.time_s, planned.gain[name] * log.enabled.value
    heat_degC = float(log.temperature.value[0]), float(log.temperature.value[-1])
    shown = plant.simulate(log.command.value[None], PERIOD_S, truth.seed * 100 + number, heat_degC, gain)
    (measured,) = robot_draw.measure(shown, np.random.default_rng([truth.seed, 3, number]))
    joint = JointLog(
        position=Signal(times_s, measured),
        command=log.command,
        temperature=log.temperature,
        enabled=log.enabled,
    )
    return Motion(f"next-{run + 1}", {name: joint}, planned.gain, "next", conditions=planned.conditions)


def next_campaign(context: Context, cases: int = 40, step: str = "all", partial: bool = False) -> Document:
    """Make, solve and score sealed cases as `run_steps` does."""
    return sealed.run_steps(context, NextCases(tuple(SERVOS)), cases, step, partial)
