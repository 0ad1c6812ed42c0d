"""The campaign of the inverse kinematics: millions of targets and joint vectors, each answer checked.

A target is tried for what its answers do, a joint vector for whether it is among the answers to its target.
"""

import json
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.ik import BranchVerdict, IkResult, inverse_kinematics
from fsw.kinematics.soft_limits import limit_excess
from fsw.kinematics.transforms import Array
from validation.kinematics_samples import Aim, Kinds, near_name, targets, vectors
from validation.kinematics_trials import (
    CASES,
    CLEAR_SIGMA,
    SAME_RAD,
    Case,
    Trial,
    claimed_roots,
    root_distances,
    root_errors,
    smallest_singular_value,
    trials,
)
from validation.options import campaign_parser

CHUNK: Final = 10_000
"""Targets, and as many vectors, at a time."""
EXAMPLES: Final = 3
"""Kept of each failure near each kind of double root."""
INSIDE_RAD: Final = 1e-6
"""A vector this far inside its limits must be called valid."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """What one process does at a time; its seed is its own."""

    index: int
    case: Case
    targets: int
    vectors: int
    seed: np.random.SeedSequence


@dataclass(slots=True)
class Tally:
    """What was found in one case; tallies add up."""

    targets: int = 0
    vectors: int = 0
    roots: int = 0
    worst_error: float = 0.0
    """Of any root that is said to meet its target: metres or radians, whichever is larger."""
    off: int = 0
    """Roots beyond the tolerance of their case."""
    valid_outside_limits: int = 0
    missed: Counter[str] = field(default_factory=Counter)
    """Vectors clear of double roots that are not among the answers to their own targets, by what is near."""
    near: Counter[str] = field(default_factory=Counter)
    """All vectors, by what is near."""
    not_called_valid: int = 0
    """Vectors found and inside the limits, but called something else than valid."""
    indistinct: int = 0
    """Vectors not found where two roots meet: there an answer that meets the target is enough."""
    unanswered: Counter[str] = field(default_factory=Counter)
    """Of the indistinct ones those whose target has no good answer, and no branch named as singular."""
    workspace: int = 0
    workspace_at_most_four: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    """Of all branches of the targets, without those of the vectors."""
    exceptions: int = 0
    examples: list[dict[str, Any]] = field(default_factory=list)

    def add(self, other: "Tally") -> None:
        """Count the other in."""
        self.worst_error = max(self.worst_error, other.worst_error)
        for example in other.examples:
            self._keep(example)
        for name in ("missed", "near", "unanswered", "verdicts"):
            getattr(self, name).update(getattr(other, name))
        for name in COUNTS:
            setattr(self, name, getattr(self, name) + getattr(other, name))

    @property
    def failures(self) -> int:
        """Whatever must not occur."""
        counts = (self.off, self.valid_outside_limits, self.not_called_valid, self.exceptions)
        return sum(counts) + self.missed.total() + self.unanswered.total()

    def as_json(self) -> dict[str, Any]:
        """Plain values, the counters from the most frequent down."""
        values = {name: getattr(self, name) for name in self.__slots__}
        counters = {name: dict(v.most_common()) for name, v in values.items() if isinstance(v, Counter)}
        return {"failures": self.failures, **values, **counters}

    def note(self, trial: Trial, what: str, where: Any, **more: Any) -> None:
        """Keep an example: enough to run it again."""
        gravity = trial.gravity_R_m_s2
        again = {"arm": trial.arm_name, "tool": trial.tool.name, "gravity_R_m_s2": gravity}
        values = {"what": what, "near": where, **again, **more}
        self._keep({name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in values.items()})

    def _keep(self, example: dict[str, Any]) -> None:
        alike = [e for e in self.examples if all(e[word] == example[word] for word in ("what", "near"))]
        if len(alike) < EXAMPLES:
            self.examples.append(example)


COUNTS: Final = (
    "targets",
    "vectors",
    "roots",
    "off",
    "valid_outside_limits",
    "not_called_valid",
    "indistinct",
    "workspace",
    "workspace_at_most_four",
    "exceptions",
)


def plan_chunks(n_targets: int, n_vectors: int, seed: int, case: Case | None = None) -> list[Chunk]:
    """Chunks for about so many targets and vectors, the cases in turn, or those of one case."""
    per_round = [one for one in CASES for _ in range(one.chunks)]
    wanted = max(n_targets, n_vectors)
    rounds = max(1, round(wanted / (CHUNK * len(per_round))))
    count = rounds * len(per_round)
    chunks = [
        Chunk(k, per_round[k % len(per_round)], -(-n_targets // count), -(-n_vectors // count), own)
        for k, own in enumerate(np.random.SeedSequence(seed).spawn(count))
    ]
    return [chunk for chunk in chunks if case is None or chunk.case == case]


def run_chunk(chunk: Chunk) -> Tally:
    """Try all of the chunk; an exception, or a numerical warning, is counted and ends one tool's part."""
    rng, tally = np.random.default_rng(chunk.seed), Tally()
    parts = list(trials(chunk.case, rng))
    for trial in parts:
        own = Tally()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                _try_targets(own, trial, chunk, rng, -(-chunk.targets // len(parts)))
                _try_vectors(own, trial, chunk, rng, -(-chunk.vectors // len(parts)))
        except Exception:
            own.exceptions += 1
            own.note(trial, "exception", None, chunk=chunk.index, trace=traceback.format_exc())
        tally.add(own)
    return tally


def _answers(trial: Trial, p_m: Array, approach: Array) -> IkResult:
    return inverse_kinematics(trial.arm, trial.tool, p_m, approach, trial.gravity_R_m_s2)


def _try_targets(tally: Tally, trial: Trial, chunk: Chunk, rng: np.random.Generator, n: int) -> None:
    p_m, approach, aim = targets(trial, rng, n)
    answers = _answers(trial, p_m, approach)
    tally.targets += n
    _check_roots(tally, trial, chunk, answers, p_m, approach, [Aim(int(k)).name for k in aim])
    valid = (answers.verdict == BranchVerdict.VALID).sum(axis=0)[aim == Aim.WORKSPACE]
    tally.workspace += valid.size
    tally.workspace_at_most_four += int((valid <= 4).sum())
    codes, counts = np.unique(answers.verdict, return_counts=True)
    tally.verdicts.update({BranchVerdict(int(c)).name: int(k) for c, k in zip(codes, counts, strict=True)})


def _try_vectors(tally: Tally, trial: Trial, chunk: Chunk, rng: np.random.Generator, n: int) -> None:
    q, near = vectors(trial, rng, n)
    X_RT = trial.tool_pose(q)
    answers = _answers(trial, X_RT.p, X_RT.R[:, 0])
    names = [near_name(k) for k in near]
    tally.vectors += n
    tally.near.update(names)
    error = _check_roots(tally, trial, chunk, answers, X_RT.p, X_RT.R[:, 0], names)
    distance = root_distances(answers, q)
    _check_verdicts(tally, trial, answers, q, distance, names)
    lost = np.flatnonzero(~(distance.min(axis=0) < SAME_RAD))
    if lost.size:
        answered = (error < chunk.case.tolerance_m).any(axis=0)
        named = (answers.verdict == BranchVerdict.SINGULAR).any(axis=0)
        _sort_lost(tally, trial, chunk, q, lost, answered | named, distance.min(axis=0), near)


def _check_roots(
    tally: Tally,
    trial: Trial,
    chunk: Chunk,
    answers: IkResult,
    p_m: Array,
    approach: Array,
    names: list[Any],
) -> Array:
    """Forward check of all claimed roots; those that are valid must be inside the limits."""
    error = root_errors(trial, answers, p_m, approach)
    there = claimed_roots(answers)
    tally.roots += int(there.sum())
    if there.any():
        tally.worst_error = max(tally.worst_error, float(error[there].max()))
    off = np.argwhere(there & ~(error <= chunk.case.tolerance_m))
    tally.off += len(off)
    for branch, k in off[:EXAMPLES]:
        root, left = answers.output_rad[:, branch, k], float(error[branch, k])
        target = {"p_RoTo_R_m": p_m[:, k], "approach_R": approach[:, k]}
        tally.note(trial, "off", names[k], chunk=chunk.index, root_rad=root, error=left, **target)
    beyond = limit_excess(trial.arm, answers.output_rad).max(axis=0)
    tally.valid_outside_limits += int(((answers.verdict == BranchVerdict.VALID) & ~(beyond <= 0)).sum())
    return error


def _check_verdicts(
    tally: Tally, trial: Trial, answers: IkResult, q: Array, distance: Array, names: list[str]
) -> None:
    same, at = distance.argmin(axis=0), np.arange(q.shape[1])
    found = distance[same, at] < SAME_RAD
    inside = limit_excess(trial.arm, q).max(axis=0) < -INSIDE_RAD
    wrong = np.flatnonzero(found & inside & (answers.verdict[same, at] != BranchVerdict.VALID))
    tally.not_called_valid += wrong.size
    for k in wrong[:EXAMPLES]:
        verdict = BranchVerdict(int(answers.verdict[same[k], k])).name
        tally.note(trial, "not called valid", names[k], vector_rad=q[:, k], verdict=verdict)


def _sort_lost(
    tally: Tally,
    trial: Trial,
    chunk: Chunk,
    q: Array,
    lost: NDArray[np.intp],
    answered: NDArray[np.bool_],
    distance: Array,
    near: Kinds,
) -> None:
    """Vectors not among the answers: missed where the pose is clear of double roots, else indistinct."""
    sigma = smallest_singular_value(trial, q[:, lost])
    for k, s in zip(lost, sigma, strict=True):
        name, clear = near_name(near[k]), bool(s > CLEAR_SIGMA)
        tally.indistinct += not clear
        if not clear and answered[k]:
            continue
        (tally.missed if clear else tally.unanswered)[name] += 1
        nearest = None if np.isinf(distance[k]) else float(distance[k])
        more = {"chunk": chunk.index, "vector_rad": q[:, k], "sigma": float(s), "nearest_rad": nearest}
        tally.note(trial, "missed" if clear else "unanswered", name, **more)


EXAMPLE = "example: python -m validation.kinematics --targets 200000 --vectors 200000 > campaign.json"
SAY_EVERY_S = 10.0


def run_kinematics_campaign(
    n_targets: int, n_vectors: int, seed: int = 0, workers: int = 1
) -> dict[str, Any]:
    """Run it and sum up, by case; with the same seed and numbers everything comes again."""
    began = time.monotonic()
    tallies = {case.name: Tally() for case in CASES}
    chunks = plan_chunks(n_targets, n_vectors, seed)
    said = began
    for done, (chunk, tally) in enumerate(_results(chunks, workers), 1):
        tallies[chunk.case.name].add(tally)
        now = time.monotonic()
        if now - said > SAY_EVERY_S or done == len(chunks):
            said = now
            _say(done, len(chunks), now - began, tallies)
    return {
        "seed": seed,
        "targets": sum(t.targets for t in tallies.values()),
        "vectors": sum(t.vectors for t in tallies.values()),
        "failures": sum(t.failures for t in tallies.values()),
        "workspace_share_with_at_most_four_valid": _share(tallies),
        "seconds": time.monotonic() - began,
        "cases": {
            case.name: {"tolerance": case.tolerance_m, **tallies[case.name].as_json()} for case in CASES
        },
    }


def _results(chunks: Sequence[Chunk], workers: int) -> Iterator[tuple[Chunk, Tally]]:
    """As they come; the order changes nothing but which examples are kept."""
    if workers == 1:
        yield from ((chunk, run_chunk(chunk)) for chunk in chunks)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        running = {pool.submit(run_chunk, chunk): chunk for chunk in chunks}
        for future in as_completed(running):
            yield running[future], future.result()


def _share(tallies: dict[str, Tally]) -> float:
    workspace = sum(t.workspace for t in tallies.values())
    return sum(t.workspace_at_most_four for t in tallies.values()) / max(workspace, 1)


def _say(done: int, of: int, spent_s: float, tallies: dict[str, Tally]) -> None:
    failures = sum(t.failures for t in tallies.values())
    left_s = spent_s / done * (of - done)
    print(f"marsarm: {done} of {of} chunks, {failures} failures, {left_s:.0f} s to go", file=sys.stderr)


def main() -> int:
    """Print the result as JSON; exit status 1 if anything failed."""
    options = campaign_parser("kinematics", __doc__, EXAMPLE)
    options.add_argument("--targets", type=int, default=200_000, help="random targets (default 200000)")
    options.add_argument("--vectors", type=int, default=200_000, help="random joint vectors (default 200000)")
    asked = options.parse_args()
    if min(asked.targets, asked.vectors, asked.workers) < 1 or asked.seed < 0:
        options.error("targets, vectors and workers are 1 or more, the seed is not negative")
    result = run_kinematics_campaign(asked.targets, asked.vectors, asked.seed, asked.workers)
    print(json.dumps(result, indent=2))
    return 1 if result["failures"] else 0


if __name__ == "__main__":
    sys.exit(main())
