"""Campaign of the inverse kinematics: millions of targets and joint vectors, with a check of every solution.

Solutions of a target must meet it. A joint vector must be among the solutions of its own target.
"""

import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import limit_excess
from fsw.kinematics.ik import BranchVerdict, IkResult, inverse_kinematics
from fsw.kinematics.transforms import Array
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document
from validation.kinematics_samples import Aim, Kinds, draw_targets, draw_vectors, near_name
from validation.kinematics_trials import (
    CASES,
    SAME_RAD,
    Case,
    Trial,
    claimed_roots,
    find_regular,
    root_distances,
    root_errors,
    smallest_singular_value,
    trials,
)

CHUNK: Final = 10_000
"""Number of targets, and of vectors, in a chunk."""
EXAMPLES: Final = 3
"""Examples that are kept of each failure near each kind of double root."""
INSIDE_RAD: Final = 1e-6
"""A vector this far inside its limits must be called valid."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Share of the work that one process does at a time, with its own seed."""

    index: int
    case: Case
    targets: int
    vectors: int
    seed: np.random.SeedSequence


@dataclass(slots=True)
class Tally:
    """Counts of one case, which add up."""

    targets: int = 0
    vectors: int = 0
    roots: int = 0
    worst_error: float = 0.0
    """Largest error of a root that claims to meet its target: the larger of metres and radians."""
    off: int = 0
    """Roots beyond the tolerance of their case."""
    valid_outside_limits: int = 0
    missed: Counter[str] = field(default_factory=Counter)
    """Regular vectors that are no solution of their targets, by kind of the nearest double root."""
    not_called_valid: int = 0
    """Vectors found and inside the limits, but called something else than valid."""
    indistinct: int = 0
    """Vectors not found close to where two roots meet."""
    unanswered: Counter[str] = field(default_factory=Counter)
    """Indistinct vectors of exact arms whose target has neither a solution nor a branch named as singular."""
    workspace: int = 0
    workspace_at_most_four: int = 0
    exceptions: int = 0
    examples: list[dict[str, Any]] = field(default_factory=list)

    def add(self, other: "Tally") -> None:
        """Add the counts of another tally."""
        worst_error = max(self.worst_error, other.worst_error)
        for example in other.examples:
            self._keep(example)
        for name in self.__slots__:
            if name != "examples":
                setattr(self, name, getattr(self, name) + getattr(other, name))
        self.worst_error = worst_error

    @property
    def failures(self) -> int:
        """Number of events that must not occur."""
        counts = (self.off, self.valid_outside_limits, self.not_called_valid, self.exceptions)
        return sum(counts) + self.missed.total() + self.unanswered.total()

    def as_json(self) -> dict[str, Any]:
        """Return the JSON document, with counters in descending order."""
        values = {name: getattr(self, name) for name in self.__slots__}
        counters = {name: dict(v.most_common()) for name, v in values.items() if isinstance(v, Counter)}
        return {"failures": self.failures, **values, **counters}

    def note(self, trial: Trial, what: str, where: Any, **more: Any) -> None:
        """Keep an example, with all that is necessary to repeat it."""
        gravity = trial.gravity_R_m_s2
        setup = {"arm": trial.arm_name, "tool": trial.tool, "gravity_R_m_s2": gravity}
        values = {"what": what, "near": where, **setup, **more}
        self._keep({name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in values.items()})

    def _keep(self, example: dict[str, Any]) -> None:
        similar = [e for e in self.examples if all(e[key] == example[key] for key in ("what", "near"))]
        if len(similar) < EXAMPLES:
            self.examples.append(example)


def plan_chunks(n_targets: int, n_vectors: int, seed: int, case: Case | None = None) -> list[Chunk]:
    """Plan chunks for about this many targets and vectors, with all cases in turn, or those of one case."""
    per_round = [one for one in CASES for _ in range(one.chunks)]
    larger = max(n_targets, n_vectors)
    rounds = max(1, round(larger / (CHUNK * len(per_round))))
    count = rounds * len(per_round)
    chunks = [
        Chunk(k, per_round[k % len(per_round)], -(-n_targets // count), -(-n_vectors // count), chunk_seed)
        for k, chunk_seed in enumerate(np.random.SeedSequence(seed).spawn(count))
    ]
    return [chunk for chunk in chunks if case is None or chunk.case == case]


def run_chunk(chunk: Chunk) -> Tally:
    """Try all targets and vectors; an exception or a numerical warning is counted, and ends its trial."""
    rng, tally = np.random.default_rng(chunk.seed), Tally()
    parts = list(trials(chunk.case, rng))
    for trial in parts:
        part = Tally()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                _try_targets(part, trial, chunk, rng, -(-chunk.targets // len(parts)))
                _try_vectors(part, trial, chunk, rng, -(-chunk.vectors // len(parts)))
        except Exception:
            part.exceptions += 1
            part.note(trial, "exception", None, chunk=chunk.index, trace=traceback.format_exc())
        tally.add(part)
    return tally


def _solve(trial: Trial, p_m: Array, approach: Array) -> IkResult:
    return inverse_kinematics(trial.arm, trial.tool, p_m, approach, trial.gravity_R_m_s2)


def _try_targets(tally: Tally, trial: Trial, chunk: Chunk, rng: np.random.Generator, n: int) -> None:
    p_m, approach, aim = draw_targets(trial, rng, n)
    answers = _solve(trial, p_m, approach)
    tally.targets += n
    _check_roots(tally, trial, chunk, answers, p_m, approach, [Aim(int(k)).name for k in aim])
    valid = (answers.verdict == BranchVerdict.VALID).sum(axis=0)[aim == Aim.WORKSPACE]
    tally.workspace += valid.size
    tally.workspace_at_most_four += int((valid <= 4).sum())


def _try_vectors(tally: Tally, trial: Trial, chunk: Chunk, rng: np.random.Generator, n: int) -> None:
    q, near = draw_vectors(trial, rng, n)
    X_RT = trial.tool_pose(q)
    answers = _solve(trial, X_RT.p, X_RT.R[:, 0])
    names = [near_name(k) for k in near]
    tally.vectors += n
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
    """Check claimed roots by forward kinematics, and valid ones for the limits; return the errors, (S, n)."""
    error = root_errors(trial, answers, p_m, approach)
    claimed = claimed_roots(answers)
    tally.roots += int(claimed.sum())
    if claimed.any():
        tally.worst_error = max(tally.worst_error, float(error[claimed].max()))
    off = np.argwhere(claimed & ~(error <= chunk.case.tolerance_m))
    tally.off += len(off)
    for branch, k in off[:EXAMPLES]:
        root, root_error = answers.output_rad[:, branch, k], float(error[branch, k])
        target = {"p_RoTo_R_m": p_m[:, k], "approach_R": approach[:, k]}
        tally.note(trial, "off", names[k], chunk=chunk.index, root_rad=root, error=root_error, **target)
    beyond = limit_excess(trial.arm, answers.output_rad).max(axis=0)
    tally.valid_outside_limits += int(((answers.verdict == BranchVerdict.VALID) & ~(beyond <= 0)).sum())
    return error


def _check_verdicts(
    tally: Tally, trial: Trial, answers: IkResult, q: Array, distance: Array, names: list[str]
) -> None:
    """Check that vectors which are found, and inside their limits, are called valid."""
    nearest, at = distance.argmin(axis=0), np.arange(q.shape[1])
    found = distance[nearest, at] < SAME_RAD
    inside = limit_excess(trial.arm, q).max(axis=0) < -INSIDE_RAD
    wrong = np.flatnonzero(found & inside & (answers.verdict[nearest, at] != BranchVerdict.VALID))
    tally.not_called_valid += wrong.size
    for k in wrong[:EXAMPLES]:
        verdict = BranchVerdict(int(answers.verdict[nearest[k], k])).name
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
    """Count vectors that are no solution as missed if they are regular, else as indistinct."""
    sigma, regular = smallest_singular_value(trial, q[:, lost]), find_regular(trial, q[:, lost])
    for k, s, clear in zip(lost, sigma, regular.tolist(), strict=True):
        name = near_name(near[k])
        tally.indistinct += not clear
        if not clear and (answered[k] or not trial.is_exact):
            continue
        (tally.missed if clear else tally.unanswered)[name] += 1
        nearest = None if np.isinf(distance[k]) else float(distance[k])
        more = {"chunk": chunk.index, "vector_rad": q[:, k], "sigma": float(s), "nearest_rad": nearest}
        tally.note(trial, "missed" if clear else "unanswered", name, **more)


def campaign(context: Context, targets: int = 10_000_000, vectors: int = 10_000_000) -> Document:
    """Try all targets and vectors and sum up by case; the same seed and numbers give the same result."""
    if min(targets, vectors) < 1:
        raise BadRequest("set: targets and vectors are 1 or more")
    began = time.monotonic()
    tallies = {case.name: Tally() for case in CASES}
    chunks = plan_chunks(targets, vectors, context.seed)
    found = context.each(run_chunk, ((chunk,) for chunk in chunks), "chunks")
    for chunk, tally in zip(chunks, found, strict=True):
        tallies[chunk.case.name].add(tally)
    failures, workspace = (sum(getattr(t, n) for t in tallies.values()) for n in ("failures", "workspace"))
    at_most_four = sum(t.workspace_at_most_four for t in tallies.values())
    return {
        "seed": context.seed,
        "targets": sum(t.targets for t in tallies.values()),
        "vectors": sum(t.vectors for t in tallies.values()),
        "failures": failures,
        "in_bounds": not failures,
        "workspace_share_with_at_most_four_valid": at_most_four / max(workspace, 1),
        "seconds": time.monotonic() - began,
        "cases": {
            case.name: {"tolerance": case.tolerance_m, **tallies[case.name].as_json()} for case in CASES
        },
    }
