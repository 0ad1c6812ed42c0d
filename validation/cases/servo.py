"""Sealed cases of a servo that swings a weight, with the poor model that people have of one.

The robot plug-in with another truth (`servo_truth`), other shares of kinds, and the bars of poor models.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

from marsarm.common.rates import check_rate
from validation.campaigns import Context, Document
from validation.cases import sealed
from validation.cases.bars import score_bars
from validation.cases.robot import RobotCases
from validation.cases.robot_draw import Kind
from validation.cases.robot_score import SealedCase, first_choice, members, pair_up
from validation.cases.robot_setup import SERVOS
from validation.cases.sealed import CaseScore

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
