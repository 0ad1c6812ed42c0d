"""Sealed cases of any robot: drawn with their truth, written as the files that a user has, and diagnosed."""

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
from simgap.checks.audit import audit
from simgap.common.errors import BadRequest, RobotError
from simgap.common.progress import Progress
from simgap.common.report import to_json
from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.logs import Logs
from simgap.result import Diagnosis
from simgap.robot import Robot
from validation.campaigns import Context, Document
from validation.cases import sealed
from validation.cases.robot_draw import Kind, draw_truth, make_campaign, record_logs
from validation.cases.robot_score import SealedCase, find_equivalents, score_cases
from validation.cases.robot_setup import ARMS, ROBOT_FILE, load_robot, write_robot
from validation.cases.robot_table import entries_of
from validation.cases.sealed import CaseScore, SealedTruth

ROBOTS_FOLDER: Final = "robots"
INDEX_FILE: Final = "cases.json"
"""Robot of each case: all that solving is told."""
DIAGNOSIS_SEED: Final = 1
"""Seed of the diagnosis, independent of that of the cases."""
KIND_SHARES: Final[dict[Kind, float]] = {"none": 0.3, "single": 0.3, "pair": 0.2, "outside": 0.2}
"""Shares of all cases: 36, 36, 24 and 24 of 120."""
QUIET_SHARES: Final[dict[Kind, float]] = {"none": 1.0, "single": 0.0}
TUNING_SEEDS: Final = 1000
"""Seeds of cases below this are for tuning."""


@dataclass(frozen=True, slots=True)
class PlannedRobotCase:
    """Case before its effects are drawn."""

    name: str
    seed: int
    kind: Kind
    model: str


@dataclass(frozen=True, slots=True)
class RobotCases(sealed.CaseMaker[SealedCase]):
    """Cases of some robots."""

    models: tuple[str, ...] = tuple(ARMS)
    is_quiet: bool = False
    """True if no case has an effect: then no false alarm is allowed."""
    kinds: ClassVar[dict[Kind, float]] = KIND_SHARES
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
            write_robot(folder / ROBOTS_FOLDER / model, model)
        sealed.write_json(folder / INDEX_FILE, {case.name: case.truth.model for case in drafts})
        return drafts

    def draw_case(self, plan: PlannedRobotCase) -> SealedCase:
        """Draw a case, with the equivalents of its effects."""
        truth = draw_truth(plan.seed, plan.kind, plan.model)
        entries = entries_of(load_robot(plan.model))
        equivalents = tuple(
            find_equivalents(make_campaign(plan.seed, plan.model), one, entries) for one in truth.effects
        )
        return SealedCase(plan.name, truth, equivalents)

    def record(self, path: Path, case: SealedCase) -> None:
        write_logs(path, record_logs(case.truth))

    def solve(self, folder: Path, case: Path) -> Document:
        """Diagnose a log as a user does: robot file, logs, split, diagnosis."""
        try:
            return to_document(diagnose_files(find_robot_file(folder, case.stem), case, self.is_audited))
        except RobotError as why:
            return {"findings": [], "remaining": [], "refused": str(why)}

    def score(self, folder: Path, solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
        found = score_cases(solved)
        has_alarms = found.document["bars"]["false alarms"]["hits"] > 0
        return replace(found, in_bounds=not has_alarms) if self.is_quiet else found


def find_robot_file(folder: Path, case: str) -> Path:
    """Return the path of the robot file of a case."""
    models: dict[str, str] = json.loads((folder / INDEX_FILE).read_bytes())
    return folder / ROBOTS_FOLDER / models[case] / ROBOT_FILE


def plan_robot_cases(
    count: int, seed: int, models: tuple[str, ...], kinds: Mapping[Kind, float] = KIND_SHARES
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
    robots: str = ",".join(ARMS),
    quiet: bool = False,
) -> Document:
    """Make, solve and score sealed cases of robots, named with commas, as `run_steps` does.

    Few cases cannot show rates. Quiet ones have no effect and are not kept, and no false alarm is allowed.
    """
    maker = RobotCases(tuple(robots.split(",")), quiet)
    return sealed.run_steps(context, maker, cases, step, partial, is_kept=not quiet)
