"""Equation 13's argument: do backlash, deflection and distortion lie at their limits, all at once?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array, Flags
from ground.accuracy.budget import COVERAGE
from ground.accuracy.combine import TOTAL, paper_rule
from ground.accuracy.moments import pooled_quantile, squared_length
from ground.accuracy.propagate import Sensitivity
from ground.accuracy.sources import Case, ErrorModel


@dataclass(frozen=True, slots=True)
class AtLimit:
    """A source that the paper's rule adds: what 99.73 % of the poses, or of the errors, stay within [m]."""

    source: str
    added_m: float
    """Absolute components, frame by frame: what the rule adds."""
    together_m: float
    """Every frame at its limit, but with its sign: one number that is wrong for the whole arm."""
    independent_m: float
    """Every frame by itself, as far as its spread has it."""


def at_limit(model: ErrorModel, case: Case, moved: Sequence[Sensitivity]) -> tuple[AtLimit, ...]:
    """Of the sources of a case that the rule adds, over the poses of all tools."""
    return tuple(
        _at_limit(model, name, factor, moved)
        for name, factor in case.sources.items()
        if model.source[name].at_limit
    )


def _at_limit(model: ErrorModel, name: str, factor: float, moved: Sequence[Sensitivity]) -> AtLimit:
    source = model.source[name]
    added = [np.abs(factor * one.of(source)[TOTAL]).sum(axis=1) for one in moved]
    signed = [(factor * one.of(source)[TOTAL]).sum(axis=1) for one in moved]
    lengths = [squared_length([(factor * one.of(source)[TOTAL], source.spread)]) for one in moved]
    return AtLimit(
        name, _within(added), _within(signed), min(pooled_quantile(lengths, COVERAGE), _within(added))
    )


def _within(shifts: list[Array]) -> float:
    return float(np.quantile(np.linalg.norm(np.concatenate(shifts, axis=-1), axis=0), COVERAGE))


def backlash_sum(model: ErrorModel, moved: Sensitivity, gap: Array) -> Array:
    """How far outputs in their gaps (5, n) move the tool, over the sum of what each can, (n,)."""
    by_joint = moved.of(model.source["backlash"])[TOTAL][:, : len(Joint)]
    there = np.einsum("ikn,kn->in", by_joint, gap)
    most = np.linalg.norm(np.abs(by_joint).sum(axis=1), axis=0)
    return np.asarray(np.linalg.norm(there, axis=0) / most)


def without_adding(u: Array, at_limit: Flags) -> dict[str, Array]:
    """What the paper's rule says of errors (sources, 6, 7, n), were less of it adding: components (6, n)."""
    rooted = np.sqrt((u**2).sum(axis=2, keepdims=True))
    no_source = np.zeros_like(at_limit)
    return {
        "paper": paper_rule(u, at_limit),
        "paper, no source added": paper_rule(u, no_source),
        "paper, no frames added": paper_rule(rooted, at_limit),
        "paper, neither added": paper_rule(rooted, no_source),
    }
