"""Sealed cases of any robot: drawn with their truth, written as the files that a user has, and diagnosed.

Sealed pairs are two logs of one robot, before and after, with one change or none between them. They have the
same commands and each its own noise, and the errors of the base parameters in common. Half of the pairs have
an effect in common too. A change comes in half of the cases, and goes in the others, as by a repair.

Limit of a change: what both logs share is free, so that only their difference tells a change d. It has half
the square of d, as the mean of both logs follows it halfway. The numbers of joints that are not known are no
nuisances: their changes are hypotheses.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import TypeAdapter

from marsarm.common.pool import Runner
from marsarm.common.rates import check_rate
from simgap.checks.audit import audit
from simgap.command.compare import compare_logs
from simgap.command.request import CompareRequest
from simgap.common.errors import BadRequest, RobotError
from simgap.common.progress import Progress
from simgap.common.report import to_json
from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.logs import Logs
from simgap.result import Comparison, Diagnosis
from simgap.robot import Robot
from validation.campaigns import Context, Document
from validation.cases import robot_draw, robot_score, robot_setup, sealed
from validation.cases.robot_score import SealedCase, find_equivalents, first_choice, pair_up, plain_place
from validation.cases.robot_table import ENTRIES, entries_of, list_hypotheses
from validation.cases.sealed import CaseScore, SealedTruth, score_bars

ROBOTS_FOLDER: Final = "robots"
INDEX_FILE: Final = "cases.json"
"""Robot of each case: all that solving is told."""
DIAGNOSIS_SEED: Final = 1
"""Seed of the diagnosis, independent of that of the cases."""
KIND_SHARES: Final[dict[robot_draw.Kind, float]] = {"none": 0.3, "single": 0.3, "pair": 0.2, "outside": 0.2}
"""Shares of all cases: 36, 36, 24 and 24 of 120."""
QUIET_SHARES: Final[dict[robot_draw.Kind, float]] = {"none": 1.0, "single": 0.0}
TUNING_SEEDS: Final = 1000
"""Seeds of cases below this are for tuning."""


@dataclass(frozen=True, slots=True)
class PlannedRobotCase:
    """Case before its effects are drawn."""

    name: str
    seed: int
    kind: robot_draw.Kind
    model: str


@dataclass(frozen=True, slots=True)
class RobotCases(sealed.CaseMaker[SealedCase]):
    """Cases of some robots."""

    models: tuple[str, ...] = tuple(robot_setup.ARMS)
    is_quiet: bool = False
    """True if no case has an effect: then no false alarm is allowed."""
    kinds: ClassVar[dict[robot_draw.Kind, float]] = KIND_SHARES
    case_type: ClassVar[type[SealedCase]] = SealedCase
    is_audited: ClassVar[bool] = False
    """True if the logs have samples that an audit refuses."""

    name: ClassVar[str] = "robot-cases"
    least_seed: ClassVar[int] = 1
    suffix: ClassVar[str] = ".parquet"
    truth_type: ClassVar[TypeAdapter[SealedTruth[SealedCase]]] = TypeAdapter(SealedTruth[SealedCase])

    def draw(
        self, folder: Path, cases: int, seed: int, run: Runner, progress: Progress
    ) -> tuple[SealedCase, ...]:
        """Draw the cases, each in a draft of its own, and write the robots and the index."""
        plans = plan_robot_cases(cases, seed, self.models, QUIET_SHARES if self.is_quiet else self.kinds)
        jobs = [(folder / sealed.SEALED_FOLDER / f"{one.name}.json", self, one) for one in plans]
        progress(0, len(jobs), "drawing")
        for done, name in enumerate(run(_draw, [job for job in jobs if not job[0].exists()]), 1):
            progress(done, len(jobs), f"drew {name}")
        case_type = TypeAdapter(self.case_type)
        drafts = tuple(case_type.validate_json(path.read_bytes()) for path, *_ in jobs)
        drawn = [(one.truth.seed, one.truth.kind) for one in drafts]
        if drawn != [(one.seed, one.kind) for one in plans]:
            raise BadRequest(f"out {folder}: holds drafts of another seed or number; give a new folder")
        for model in self.models:
            robot_setup.write_robot(folder / ROBOTS_FOLDER / model, model)
        sealed.write_json(folder / INDEX_FILE, {case.name: case.truth.model for case in drafts})
        return drafts

    def draw_case(self, plan: PlannedRobotCase) -> SealedCase:
        """Draw a case, with the equivalents of its effects."""
        truth = robot_draw.draw_truth(plan.seed, plan.kind, plan.model)
        entries = entries_of(robot_setup.load_robot(plan.model))
        equivalents = tuple(
            find_equivalents(robot_draw.make_campaign(plan.seed, plan.model), one, entries)
            for one in truth.effects
        )
        return SealedCase(plan.name, truth, equivalents)

    def record(self, path: Path, case: SealedCase) -> None:
        write_logs(path, robot_draw.record_logs(case.truth))

    def solve(self, folder: Path, case: Path) -> Document:
        """Diagnose a log as a user does: robot file, logs, split, diagnosis."""
        try:
            return to_document(diagnose_files(find_robot_file(folder, case.stem), case, self.is_audited))
        except RobotError as why:
            return {"findings": [], "remaining": [], "refused": str(why)}

    def score(self, folder: Path, solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
        found = robot_score.score_cases(solved)
        has_alarms = found.document["bars"]["false alarms"]["hits"] > 0
        return replace(found, in_bounds=not has_alarms) if self.is_quiet else found


def find_robot_file(folder: Path, case: str) -> Path:
    """Return the path of the robot file of a case."""
    models: dict[str, str] = json.loads((folder / INDEX_FILE).read_bytes())
    return folder / ROBOTS_FOLDER / models[case] / robot_setup.ROBOT_FILE


def plan_robot_cases(
    count: int, seed: int, models: tuple[str, ...], kinds: Mapping[robot_draw.Kind, float] = KIND_SHARES
) -> tuple[PlannedRobotCase, ...]:
    """Plan the kinds and the models of cases, in random order; each kind has each model equally often."""
    counts = {kind: round(share * count) for kind, share in kinds.items()}
    counts["single"] += count - sum(counts.values())
    pairs = [(kind, models[k % len(models)]) for kind, many in counts.items() for k in range(many)]
    order = np.random.default_rng([seed, 4]).permutation(count)
    named = [(sealed.case_name(k), TUNING_SEEDS * seed + k) for k in range(count)]
    return tuple(PlannedRobotCase(*own, *pairs[k]) for own, k in zip(named, order, strict=True))


def _draw(job: tuple[Path, RobotCases, PlannedRobotCase]) -> str:
    """Draw a case and write its draft."""
    path, maker, plan = job
    sealed.write_json(path, asdict(maker.draw_case(plan)))
    return plan.name


def diagnose_files(robot_file: Path, log: Path, is_audited: bool = False) -> Diagnosis:
    """Diagnose a log, without what an audit refuses if it is audited."""
    robot = Robot.from_toml(robot_file)
    logs = load(robot, log)
    found = audit(robot, logs) if is_audited else None
    return diagnose(robot, logs.fit, held_out=logs.judged, audit=found, seed=DIAGNOSIS_SEED)


def to_document(found: Diagnosis) -> Document:
    """Return what the score needs of a diagnosis, and what a reader wants to know."""
    names = ("findings", "remaining", "errors")
    document = {name: to_json(getattr(found, name)) for name in names}
    return {**document, "refused": "; ".join(one.reason for one in found.refused)}


def write_logs(path: Path, logs: Logs) -> None:
    """Write all motions in one Parquet file; those of a servo with its gain and its power."""
    columns: dict[str, list[NDArray[Any]]] = {}

    def add(name: str, values: NDArray[Any]) -> None:
        columns.setdefault(name, []).append(values)

    for motion in logs.motions:
        first = next(iter(motion.joints.values())).position.time_s
        add("motion", np.full(first.size, motion.name))
        add("repeat", np.full(first.size, motion.repeat_of))
        add("t_s", first)
        enabled = next(iter(motion.joints.values())).enabled
        if enabled is not None:
            add("gain", np.full(first.size, next(iter(motion.gain.values()))))
            add("enabled", enabled.value)
        for name, value in motion.conditions.items():
            add(name, np.full(first.size, value))
        for joint, log in motion.joints.items():
            assert log.command is not None
            assert log.temperature is not None
            add(f"command_{joint}", log.command.value)
            add(f"position_{joint}", log.position.value)
            add(f"temperature_{joint}", log.temperature.value)
    pq.write_table(pa.table({name: np.concatenate(parts) for name, parts in columns.items()}), path)


def campaign(
    context: Context,
    cases: int = 120,
    step: str = "all",
    partial: bool = False,
    robots: str = ",".join(robot_setup.ARMS),
    quiet: bool = False,
) -> Document:
    """Make, solve and score sealed cases of robots, named with commas, as `run_steps` does.

    Few cases cannot show rates. Quiet ones have no effect and are not kept, and no false alarm is allowed.
    """
    maker = RobotCases(tuple(robots.split(",")), quiet)
    return sealed.run_steps(context, maker, cases, step, partial, is_kept=not quiet)


PAIR_SHARES: Final[dict[robot_draw.Kind, float]] = {"none": 0.4, "single": 0.6}
"""Shares of all pairs without and with a change: 16 and 24 of 40."""
CHANGE_TIMES_LIMIT: Final = (2.0, 8.0)
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
class RobotPairs(RobotCases):
    """Pairs of logs of some robots."""

    name: ClassVar[str] = "robot-pairs"
    suffix: ClassVar[str] = ""
    kinds: ClassVar[dict[robot_draw.Kind, float]] = PAIR_SHARES
    case_type: ClassVar[type[SealedCase]] = SealedPair
    truth_type: ClassVar[TypeAdapter[Any]] = TypeAdapter(SealedTruth[SealedPair])

    def draw_case(self, plan: PlannedRobotCase) -> SealedPair:
        rng = np.random.default_rng([plan.seed, 6, list(robot_setup.MODELS).index(plan.model)])
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
            write_logs(path / f"{name}.parquet", robot_draw.record_logs(truth, 1 + run))

    def solve(self, folder: Path, case: Path) -> Document:
        """Compare two logs as a user does."""
        robot_file = find_robot_file(folder, case.name)
        before, after = (case / f"{name}.parquet" for name in SETS)
        try:
            request = CompareRequest(robot_file, before, after, seed=DIAGNOSIS_SEED)
            return describe(compare_logs(request))
        except RobotError as why:
            return {"findings": [], "remaining": [], "refused": str(why)}

    def score(self, folder: Path, solved: Sequence[tuple[Any, Document]]) -> CaseScore:
        return score_pairs(solved)


def make_change_motions(seed: int, model: str) -> robot_draw.CaseMotions:
    """Return the motions of a case with the limit of a change in place of that of an effect."""
    made = robot_draw.make_motions(seed, model)
    count = len(list_hypotheses(made.robot, CHANGES))
    limit = float(np.sqrt(2.0)) * robot_setup.limit_noncentrality(len(made.fitted), count)
    return replace(made, limit=limit, times_limit=CHANGE_TIMES_LIMIT)


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
    document = to_document(made.found)
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


def pair_campaign(
    context: Context,
    cases: int = 40,
    step: str = "all",
    partial: bool = False,
    robots: str = ",".join(robot_setup.ARMS),
) -> Document:
    """Make, solve and score sealed pairs of robots, named with commas, as `run_steps` does."""
    return sealed.run_steps(context, RobotPairs(tuple(robots.split(","))), cases, step, partial)
