"""Sealed pairs of logs of one robot, before and after, with one change or none between them.

The robot plug-in with two logs a case, which have the same commands and each its own noise. Both have the
errors of the base parameters in common, and half of the pairs an effect too. A change comes in half of the
cases, and goes in the others, as by a repair.

Limit of a change: what both logs share is free, so that only their difference tells a change d. It has half
the square of d, as the mean of both logs follows it halfway. The numbers of joints that are not known are no
nuisances: their changes are hypotheses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from pydantic import TypeAdapter

from marsarm.common.rates import check_rate
from simgap.command.diagnosis import compare_logs
from simgap.command.request import CompareRequest
from simgap.common.errors import RobotError
from simgap.result import Comparison
from validation.campaigns import Context, Document
from validation.cases import robot, robot_draw, sealed
from validation.cases.bars import score_bars
from validation.cases.robot_score import SealedCase, find_equivalents, first_choice, pair_up, plain_place
from validation.cases.robot_setup import ARMS, MODELS, limit_noncentrality
from validation.cases.robot_table import ENTRIES, list_hypotheses
from validation.cases.sealed import CaseScore, SealedTruth

KIND_SHARES: Final[dict[robot_draw.Kind, float]] = {"none": 0.4, "single": 0.6}
"""Shares of all pairs without and with a change: 16 and 24 of 40."""
TIMES_LIMIT: Final = (2.0, 8.0)
"""Range of the strength of a change, in family-wise limits."""
SETS: Final = ("before", "after")
CHANGES: Final = tuple(replace(one, needs="" if one.needs == "known" else one.needs) for one in ENTRIES)
"""Effects that may change: also the numbers of joints that are fitted in any case."""


@dataclass(frozen=True, slots=True)
class SealedPair(SealedCase):
    """Pair with its truth, whose effects are the change."""

    common: tuple[robot_draw.DrawnEffect, ...]
    """Effects of both logs."""
    is_gone: bool
    """True if the effect that changes is there before, False if it is there after."""


@dataclass(frozen=True, slots=True)
class RobotPairs(robot.RobotCases):
    """Pairs of logs of some robots."""

    name: ClassVar[str] = "robot-pairs"
    suffix: ClassVar[str] = ""
    kinds: ClassVar[dict[robot_draw.Kind, float]] = KIND_SHARES
    case_type: ClassVar[type[SealedCase]] = SealedPair
    truth_type: ClassVar[TypeAdapter[Any]] = TypeAdapter(SealedTruth[SealedPair])

    def draw_case(self, plan: robot.PlannedRobotCase) -> SealedPair:
        rng = np.random.default_rng([plan.seed, 6, list(MODELS).index(plan.model)])
        made = make_change_motions(plan.seed, plan.model)
        common = (draw_typical(made, rng),) if rng.uniform() < 0.5 else ()
        changes = (robot_draw.draw_effect(made, CHANGES, common, rng),) if plan.kind != "none" else ()
        same = tuple(((one.name, one.place),) for one in changes)
        truth = robot_draw.make_truth(plan.seed, plan.kind, plan.model, changes)
        return SealedPair(plan.name, truth, same, common, bool(rng.uniform() < 0.5))

    def record(self, path: Path, case: SealedCase) -> None:
        assert isinstance(case, SealedPair)
        path.mkdir()
        for run, name in enumerate(SETS):
            has_change = (name == "before") == case.is_gone
            effects = (*case.common, *(case.truth.effects if has_change else ()))
            truth = replace(case.truth, effects=effects)
            robot.write_logs(path / f"{name}.parquet", robot_draw.record_logs(truth, 1 + run))

    def solve(self, folder: Path, case: Path) -> Document:
        """Compare two logs as a user does."""
        robot_file = robot.find_robot_file(folder, case.name)
        before, after = (case / f"{name}.parquet" for name in SETS)
        try:
            request = CompareRequest(robot_file, before, after, seed=robot.DIAGNOSIS_SEED)
            return describe(compare_logs(request))
        except RobotError as why:
            return {"findings": [], "remaining": [], "refused": str(why)}

    def score(self, folder: Path, solved: Sequence[tuple[Any, Document]]) -> CaseScore:
        return score_pairs(solved)


def make_change_motions(seed: int, model: str) -> robot_draw.CaseMotions:
    """Return the motions of a case with the limit of a change in place of that of an effect."""
    made = robot_draw.make_motions(seed, model)
    count = len(list_hypotheses(made.robot, CHANGES))
    limit = float(np.sqrt(2.0)) * limit_noncentrality(len(made.fitted), count)
    return replace(made, limit=limit, times_limit=TIMES_LIMIT)


def draw_typical(made: robot_draw.CaseMotions, rng: np.random.Generator) -> robot_draw.DrawnEffect:
    """Draw an effect of the catalogue at any of its places, with a typical size; its strength stays open."""
    every = list_hypotheses(made.robot, ENTRIES)
    one = every[int(rng.integers(len(every)))]
    sign = float(rng.choice((-1.0, 1.0))) if one.entry.is_signed else 1.0
    kind, size = one.entry.kind, sign * one.entry.typical * one.scale
    families = tuple(sorted(map(str, kind.families)))
    shape = float(rng.uniform())
    return robot_draw.DrawnEffect(kind.name, one.place, str(kind.family), size, shape, 0.0, families)


def describe(made: Comparison) -> Document:
    """Return what the score needs of a comparison; changes have the names of what changes."""
    document = robot.to_document(made.found)
    for one in document["findings"]:
        one["effect"] = one["effect"].removeprefix("change of ")
        one["effects"] = [key.replace(": change of ", ": ") for key in one["effects"]]
    return document


def add_equivalents(case: SealedCase, findings: Sequence[Document]) -> SealedCase:
    """Add the effects that cannot be told from a change, where it is not named itself: they take a minute."""
    true = {one for same in case.equivalents for one in same}
    if not findings or any(first_choice(one) in true for one in findings):
        return case
    made = make_change_motions(case.truth.seed, case.truth.model)
    same = tuple(find_equivalents(made, one, CHANGES) for one in case.truth.effects)
    return replace(case, equivalents=same)


def score_pairs(solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
    """Score pairs: nothing is found where nothing changed, and else place and effect of the change."""
    quiet = [result for case, result in solved if case.truth.kind == "none"]
    changed = [(case, list(result["findings"])) for case, result in solved if case.truth.effects]
    paired = [pair_up(add_equivalents(case, found), found) for case, found in changed]
    pairs = [pair for found, _ in paired for pair in found]
    found = [(one.finding, {place for _, place in one.accepted}) for one in pairs]
    is_placed = [one is not None and plain_place(one["place"]) in right for one, right in found]
    is_named = [one.finding is not None and first_choice(one.finding) in one.accepted for one in pairs]
    bars = {
        "false alarms": check_rate((bool(one["findings"]) for one in quiet), 0.05, True),
        "right place of the change": check_rate(is_placed, 0.95, False),
        "right effect": check_rate(is_named, 0.88, False),
    }
    more = {
        "further findings beside a change": sum(len(rest) for _, rest in paired),
        "refused": sum(bool(one.get("refused")) and not one["findings"] for _, one in solved),
        "cpu seconds": sum(one["seconds"] for _, one in solved),
    }
    return score_bars(bars, len(solved), more)


def campaign(
    context: Context, cases: int = 40, step: str = "all", partial: bool = False, robots: str = ",".join(ARMS)
) -> Document:
    """Make, solve and score sealed pairs of robots, named with commas, as `run_steps` does."""
    return sealed.run_steps(context, RobotPairs(tuple(robots.split(","))), cases, step, partial)
