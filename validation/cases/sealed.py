"""Sealed cases of a diagnosis: planned and sealed by a digest, then made, solved and scored, for any robot.

A folder holds `digest.txt`, `sealed/truth.json`, the logs in `cases` and the results in `solved`. The truth
is sealed before a case is recorded, and solving never reads it. Whatever was interrupted goes on.
"""

import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from marsarm.common.pool import Runner
from marsarm.common.rates import RateBar, check_rate
from simgap.common.errors import BadOutput, BadRequest
from simgap.common.files import atomic_write, check_new_path
from simgap.common.progress import Progress, as_guess, part_of
from simgap.common.toml import describe_first_problem
from validation.campaigns import Context, Document

TRUTH: Final = "truth.json"
DIGEST: Final = "digest.txt"
SEALED_FOLDER: Final = "sealed"
CASES_FOLDER: Final = "cases"
SOLVED_FOLDER: Final = "solved"
PARTIAL_SUFFIX: Final = ".part"
MOST_CASES: Final = 1000
STEPS: Final = ("all", "make", "solve", "score")


class NamedCase(Protocol):
    """Truth of a case."""

    @property
    def name(self) -> str:
        """Name, case-000 for the first."""


Case = TypeVar("Case", bound=NamedCase)


@dataclass(frozen=True, slots=True)
class SealedTruth(Generic[Case]):
    """Truth of all cases; without the seed, the salt prevents that the digest confirms a guess."""

    salt: str
    cases: tuple[Case, ...]

    def text(self) -> str:
        """Return the text of the truth file."""
        return json.dumps(asdict(self), indent=1, sort_keys=True) + "\n"

    def digest(self) -> str:
        """Return the SHA-256 of that text."""
        return hashlib.sha256(self.text().encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class CaseScore:
    """Score as a document, and as a table of its bars."""

    document: Document
    in_bounds: bool

    def markdown(self) -> str:
        """Return the table as a page."""
        lines = ["# Sealed cases", "", "|  | wanted | found |  |", "|---" * 4 + "|"]
        for name, bar in self.document["bars"].items():
            wanted = f"at {'most' if bar['is_most'] else 'least'} {bar['rate']:g}"
            verdict = "met" if bar["met"] else "missed"
            lines.append(f"| {name} | {wanted} | {bar['hits']} of {bar['of']} | {verdict} |")
        return "\n".join([*lines, ""])


LEVELS: Final = ("place", "family", "effect")


@dataclass(frozen=True, slots=True)
class JudgedEffect:
    """Verdict on a true effect of the catalogue, from its detection limit on."""

    is_reported: bool
    has_place: bool = False
    has_effect: bool = False
    """True if the right one comes first."""
    is_covered: bool | None = None
    """True if the set of the lowest reported level holds the truth; None without a set."""


def level_bars(
    alarms: Iterable[bool],
    outside: Sequence[tuple[bool, bool, bool]],
    effects: Sequence[JudgedEffect],
    wrong_rates: tuple[float, float, float],
) -> dict[str, RateBar]:
    """Return the bars of cases without effect, outside the catalogue (wrong by level), and of effects."""
    reported = [one for one in effects if one.is_reported]
    sets = [one.is_covered for one in reported if one.is_covered is not None]
    return {
        "false alarms": check_rate(alarms, 0.05, True),
        **{
            f"outside, wrong {level}": check_rate((one[k] for one in outside), wrong_rates[k], True)
            for k, level in enumerate(LEVELS)
        },
        "reported": check_rate((one.is_reported for one in effects), 0.85, False),
        "right place": check_rate((one.has_place for one in reported), 0.95, False),
        "right effect": check_rate((one.has_effect for one in reported), 0.88, False),
        "set coverage": check_rate(sets, 0.95, False),
    }


def score_bars(
    bars: Mapping[str, RateBar], count: int, more: Mapping[str, Any], in_bounds: bool = True
) -> CaseScore:
    """Return a score of `count` solved cases by bars, which have to be met, as all other bounds have to."""
    verdicts = {name: {**asdict(bar), "met": bar.is_met} for name, bar in bars.items()}
    document = {"cases": count, "bars": verdicts, **more}
    return CaseScore(document, in_bounds and all(bar.is_met for bar in bars.values()))


class CaseMaker(Generic[Case]):
    """Robot of some cases: all that differs between robots. Objects go to other processes."""

    name: ClassVar[str]
    """Name of the campaign."""
    least_seed: ClassVar[int] = 0
    """Seeds below it become it: their cases are for tuning."""
    suffix: ClassVar[str]
    """Suffix of the file of a case's logs; empty for a folder."""
    truth_type: ClassVar[TypeAdapter[Any]]
    """Type of the sealed truth."""

    def draw(self, folder: Path, cases: int, seed: int, run: Runner, progress: Progress) -> tuple[Case, ...]:
        """Draw the truth of all cases, and write what solving may know before them."""
        raise NotImplementedError

    def record(self, path: Path, case: Case) -> None:
        """Record the logs of a case."""
        raise NotImplementedError

    def prepare(self, folder: Path, run: Runner, progress: Progress) -> None:
        """Compute what all cases share, in parallel, before they are solved."""

    def load(self, folder: Path) -> None:
        """Load what all cases share, once in each process."""

    def solve(self, folder: Path, case: Path) -> Document:
        """Diagnose the logs of a case."""
        raise NotImplementedError

    def score(self, folder: Path, solved: Sequence[tuple[Case, Document]]) -> CaseScore:
        """Compare results with the truth."""
        raise NotImplementedError


def run_steps(
    context: Context, maker: CaseMaker[Any], cases: int, step: str, partial: bool, is_kept: bool = True
) -> Document:
    """Make, solve and score cases, or do one of `STEPS`, in the folder of the context.

    If it names none, cases that are kept have one of the name and the seed, such as servo-cases-1. A partial
    score is of the cases that are solved, where others are refused.
    """
    context = replace(context, seed=max(context.seed, maker.least_seed))
    if step not in STEPS:
        raise BadRequest(f"set step: {step} is none of {', '.join(STEPS)}")
    with TemporaryDirectory() as scratch:
        folder = context.out or Path(f"{maker.name}-{context.seed}" if is_kept else scratch)
        run, document = context.run, Document()
        making = solving = context.progress
        if step == "all":  # the share of each is a guess
            making, solving = (as_guess(part_of(making, begin, begin + 0.5)) for begin in (0.0, 0.5))
        if step in ("all", "make"):
            digest, recorded = make_cases(folder, maker, cases, context.seed, run, making)
            document |= {"digest": digest, "cases": cases, "recorded": recorded}
        if step in ("all", "solve"):
            solved, every = solve_cases(folder, maker, run, solving)
            document |= {"solved": solved, "cases": every}
        if step in ("all", "score"):
            found = score_cases(folder, maker, partial)
            (folder / "score.md").write_text(found.markdown(), encoding="utf-8")
            document |= {**found.document, "in_bounds": found.in_bounds}
        return document


def _uncounted(progress: Progress) -> Progress:
    """Return the progress of what comes before the cases, which says nothing of the time that these take."""
    return lambda done, total, what: progress(0.0, 0.0, what)


def make_cases(
    folder: Path, maker: CaseMaker[Any], cases: int, seed: int, run: Runner, progress: Progress
) -> tuple[str, int]:
    """Draw and seal the truth, then record every case that is not there; return digest and number recorded.

    BadRequest if the folder holds something else, or cases of another seed or number.
    """
    if not 1 <= cases <= MOST_CASES:
        raise BadRequest(f"cases: {cases} is not within 1 .. {MOST_CASES}")
    check_folder(folder)
    folder.mkdir(exist_ok=True)
    truth = load_existing_truth(folder, maker, salt(seed), cases)
    if truth is None:
        drawn = maker.draw(folder, cases, seed, run, _uncounted(progress))
        truth = SealedTruth(salt(seed), drawn)
        seal(folder, truth)
    progress(0, cases, f"SHA-256 of the truth {truth.digest()}")
    paths = [(case_path(folder, maker, case.name).absolute(), case) for case in truth.cases]
    jobs = [(path, maker, case) for path, case in paths if not path.exists()]
    for done, name in enumerate(run(record_case, jobs), 1):
        progress(done, len(jobs), f"recorded {name}")
    return truth.digest(), len(jobs)


def check_folder(folder: Path) -> None:
    """Refuse a folder of something else, before anything is written."""
    check_new_path(folder, "out")
    if folder.exists() and not folder.is_dir():
        raise BadRequest(f"out {folder}: this is a file; name a new folder, or one of cases")
    there = set(os.listdir(folder)) if folder.exists() else set()
    if there and not any(name.startswith(("digest", "campaign", SEALED_FOLDER)) for name in there):
        raise BadRequest(f"out {folder}: holds something else; name a new folder, or one of cases")


def record_case(job: tuple[Path, CaseMaker[Any], Any]) -> str:
    """Record one case completely or not at all; return its name."""
    path, maker, case = job
    if path.exists():  # a worker recorded it and died before it could say so
        return str(case.name)
    part = path.with_name(f".{path.name}{PARTIAL_SUFFIX}")
    remove(part)
    path.parent.mkdir(exist_ok=True)
    try:
        maker.record(part, case)
    except BaseException:
        remove(part)
        raise
    part.rename(path)
    return str(case.name)


def remove(path: Path) -> None:
    """Remove a file, a folder or nothing."""
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def salt(seed: int) -> str:
    """Return the salt of a seed; only who knows the seed can compute it."""
    return np.random.default_rng([seed, 9]).bytes(16).hex()


def case_name(number: int) -> str:
    """Return the name of a case by its number from 0."""
    return f"case-{number:03d}"


def case_path(folder: Path, maker: CaseMaker[Any], name: str) -> Path:
    """Return the path of the logs of a case."""
    return folder / CASES_FOLDER / f"{name}{maker.suffix}"


def result_path(folder: Path, name: str) -> Path:
    """Return the path of the result of a case."""
    return folder / SOLVED_FOLDER / f"{name}.json"


def seal(folder: Path, truth: SealedTruth[Any]) -> str:
    """Write the truth in a folder of its own, and its digest; return the digest."""
    digest = truth.digest()
    (folder / SEALED_FOLDER).mkdir(exist_ok=True)
    for path, text in ((folder / SEALED_FOLDER / TRUTH, truth.text()), (folder / DIGEST, digest + "\n")):
        with atomic_write(path, "out") as file:
            file.write(text.encode())
    return digest


def load_existing_truth(
    folder: Path, maker: CaseMaker[Case], salt: str, cases: int
) -> SealedTruth[Case] | None:
    """Load the truth of a folder; None if it has none; BadRequest if it has another salt or number."""
    if not (folder / DIGEST).exists():
        return None
    truth = load_truth(folder, maker)
    if (truth.salt, len(truth.cases)) != (salt, cases):
        raise BadRequest(
            f"out {folder}: holds {len(truth.cases)} cases"
            f"{'' if truth.salt == salt else ' of another seed'}; give their seed and number, or a new folder"
        )
    return truth


def load_truth(folder: Path, maker: CaseMaker[Case]) -> SealedTruth[Case]:
    """Load the truth if it matches its digest; BadRequest if there is no truth, or it does not match."""
    path = folder / SEALED_FOLDER / TRUTH
    if not path.exists():
        path = folder / TRUTH  # of cases of this arm before 0.4
    digest = read_digest(folder)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BadRequest(
            f"{path}: cannot be read ({error.strerror}); without it nothing is scored"
        ) from error
    if hashlib.sha256(raw).hexdigest() != digest:
        raise BadRequest(f"{path}: is not what was sealed: its SHA-256 is not that in {DIGEST}")
    try:
        truth: SealedTruth[Case] = maker.truth_type.validate_json(raw)
    except ValidationError as error:
        raise BadRequest(f"{path}: was sealed, but is no truth ({describe_first_problem(error)})") from error
    return truth


def read_digest(folder: Path) -> str:
    """Read the published digest; BadRequest if there is none."""
    try:
        return (folder / DIGEST).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadRequest(f"{folder}: has no {DIGEST}: this is no folder of cases; make them first") from error


def solve_cases(folder: Path, maker: CaseMaker[Any], run: Runner, progress: Progress) -> tuple[int, int]:
    """Solve all cases without a result, and never read the truth; return how many, and the number of all."""
    read_digest(folder)
    cases = sorted(one for one in (folder / CASES_FOLDER).glob(f"case-*{maker.suffix}"))
    if not cases:
        raise BadRequest(f"{folder}: no case is recorded yet; the step make goes on")
    left = [one.absolute() for one in cases if not result_path(folder, one.stem).exists()]
    jobs = [(folder.absolute(), maker, one) for one in left]
    if jobs:  # before the workers start, else each would compute it
        maker.prepare(folder, run, _uncounted(progress))
    progress(0, len(jobs), "solving")
    for done, name in enumerate(run(solve_case, jobs), 1):
        progress(done, len(jobs), name)
    return len(jobs), len(cases)


def solve_case(job: tuple[Path, CaseMaker[Any], Path]) -> str:
    """Solve one case; its result is written last, so that an interrupted case is solved again."""
    folder, maker, case = job
    maker.load(folder)  # what is known before a case is no part of its time
    began = time.process_time()
    result = maker.solve(folder, case)
    write_json(result_path(folder, case.stem), {**result, "seconds": time.process_time() - began})
    return case.stem


def score_cases(folder: Path, maker: CaseMaker[Any], partial: bool) -> CaseScore:
    """Score the cases of a folder.

    BadRequest if the truth was changed, a case is not solved, or a result is damaged.
    """
    truth, results = load_truth(folder, maker), load_results(folder)
    missing = [case.name for case in truth.cases if case.name not in results]
    if missing and (not partial or len(missing) == len(truth.cases)):
        raise BadRequest(
            f"{folder}: {len(missing)} of {len(truth.cases)} cases are not solved, {missing[0]} first; "
            "the step solve goes on, partial=true scores those that are solved"
        )
    solved = [(case, results[case.name]) for case in truth.cases if case.name in results]
    found = maker.score(folder, solved)
    return replace(found, document={"digest": truth.digest(), **found.document})


_RESULT_ADAPTER: Final = TypeAdapter(dict[str, Any])


def load_results(folder: Path) -> dict[str, Document]:
    """Load the results of all solved cases by name; BadRequest if one cannot be read."""
    found = {}
    if (folder / SOLVED_FOLDER).is_file():
        raise BadRequest(f"{folder / SOLVED_FOLDER}: is a file; a folder of solved cases would be right")
    for path in sorted((folder / SOLVED_FOLDER).glob("case-*[0-9].json")):
        try:
            raw = path.read_bytes()
            found[path.stem] = _RESULT_ADAPTER.validate_json(raw, strict=True)
        except (OSError, ValidationError) as error:
            why = describe_first_problem(error) if isinstance(error, ValidationError) else error.strerror
            raise BadRequest(f"{path}: is no solved case ({why}); remove it and solve again") from error
    return found


def write_json(path: Path, document: Any) -> None:
    """Write a document atomically; BadOutput if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadOutput(f"out {path}: cannot be written ({error.strerror or error})") from error
    with atomic_write(path, "out") as file:
        file.write((json.dumps(document, indent=1, allow_nan=False) + "\n").encode())
