"""Comparison of two sets of logs of one robot: what both have in common, and then what differs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from simgap.arrays import Array, Flags
from simgap.assemble import assemble, select_sure
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.records import Audit
from simgap.common.errors import RobotError
from simgap.diagnosis import check_names, choose_shown
from simgap.effects.effect import Effect, JointEffect, Size
from simgap.logs import Logs, Motion
from simgap.residuals.residuals import ResidualModel, residuals_by_motion
from simgap.residuals.simulation_residuals import list_kinds
from simgap.result import Comparison, Limit
from simgap.robot import Robot
from simgap.selection.checkpoint import Meter, Progress
from simgap.selection.context import Selection, fit_together
from simgap.selection.joint_fits import start_fit
from simgap.selection.selection import select_effects
from simgap.selection.verdict import size_intervals

BEFORE, AFTER = "before:", "after:"
"""Beginnings of the names of motions, by which the two sets are told apart."""


@dataclass(frozen=True)
class Change(Effect):
    """Change of the sizes of another effect from the first set of logs to the second."""

    place: str
    effect: Effect

    def __post_init__(self) -> None:
        """Take the form from the effect; its hooks are called by `ComparedResiduals`."""
        for key in ("has_shape", "is_steady"):
            object.__setattr__(self, key, getattr(self.effect, key))

    @property
    def name(self) -> str:
        """Name of the effect that changes."""
        return f"change of {self.effect.key.removeprefix(f'{self.place}: ')}"

    @property
    def family(self) -> StrEnum:
        """Family of the effect that changes."""
        return self.effect.family

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Return differences of sizes, which may have either sign."""
        return tuple(
            replace(one, low=one.low - one.high, high=one.high - one.low, prior_std=math.inf)
            for one in self.effect.sizes
        )

    @property
    def parts(self) -> tuple[Effect, ...]:
        """Changes at the joints, where the effect acts at each of them."""
        return tuple(Change(one.place, one) for one in self.effect.parts)

    def describe(self, size: Array) -> str:
        """Return the changes with their signs."""
        names = (one.name for one in self.effect.sizes)
        return ", ".join(f"{name} {value:+.4g}" for name, value in zip(names, size, strict=True))

    def overrides(self, *hooks: str) -> bool:
        """Return whether the effect that changes has its own version of any of these hooks."""
        return self.effect.overrides(*hooks)


class ComparedResiduals:
    """Residuals of two sets of motions, about a model that they have in common; see `ResidualModel`."""

    by_motion = True

    def __init__(self, raw: ResidualModel, known: Mapping[Effect, Array]) -> None:
        """Keep the residuals of both sets.

        Args:
            known: Effects of the common model and their sizes, from which all other sizes count.
        """
        self.raw, self.known = raw, dict(known)
        self.kind, self.units, self.joints, self.motions = raw.kind, raw.units, raw.joints, raw.motions
        self.step_s, self.method, self.noise_std = raw.step_s, raw.method, raw.noise_std
        self.repeat_of, self.joint_of, self.motion_of = raw.repeat_of, raw.joint_of, raw.motion_of
        self.time_s = raw.time_s
        self._is_after: Flags = np.array([name.startswith(AFTER) for name in raw.motions])

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n); a change acts in the second set alone."""
        if sizes.ndim == 2:
            sizes = np.repeat(sizes[:, None], len(self.motions), axis=1)
        inner = {one.key: one for one in self.known}
        inner |= {one.key: one for one in (getattr(effect, "effect", effect) for effect in effects)}
        places, n = {}, 0
        for key, one in inner.items():
            places[key] = slice(n, n + len(one.sizes))
            n += len(one.sizes)
        total = np.zeros((*sizes.shape[:2], n))
        for one, size in self.known.items():
            total[..., places[one.key]] += size
        first = 0
        for effect in effects:
            own = sizes[..., first : first + len(effect.sizes)]
            first += len(effect.sizes)
            if isinstance(effect, Change):
                total[..., places[effect.effect.key]] += own * self._is_after[:, None]
            else:
                total[..., places[effect.key]] += own
        bounds = [(one.low, one.high) for effect in inner.values() for one in effect.sizes]
        low, high = np.array(bounds).reshape(-1, 2).T
        return residuals_by_motion(self.raw, [*inner.values()], np.clip(total, low, high))

    def select(self, motions: Sequence[str]) -> "ComparedResiduals":
        """Return the residuals of these motions alone."""
        return ComparedResiduals(self.raw.select(motions), self.known)

    def explain(self, name: str) -> Array:
        """Return a variable at the measured motion, (n,)."""
        return self.raw.explain(name)


def compare(
    robot: Robot,
    before: Sequence[Motion],
    after: Sequence[Motion],
    *,
    audits: Sequence[Audit] = (),
    seed: int = 1,
    progress: Progress = lambda share, text: None,
) -> Comparison:
    """Find what changed in a robot between two sets of logs.

    Base parameters and effects are first found for both sets together. Changes of all effects then compete
    to explain what this common model leaves.

    Args:
        audits: Audit of each set; the samples that they refuse take no part.
        seed: Seed of the folds: the same seed gives the same bits.
        progress: Called with the share that is done, from 0 to 1, and a text.

    Raises:
        RobotError: A set has no motion, the motions are too few, or the logs allow more than one kind of
            comparison.
    """
    if not before or not after:
        raise RobotError("a comparison needs motions before and after; one of the two sets is empty")
    motions = [*_rename(before, BEFORE), *_rename(after, AFTER)]
    usable = {
        (prefix + motion.name, joint): audit.is_usable(motion.name, joint)
        for prefix, part, audit in zip((BEFORE, AFTER), (before, after), audits, strict=False)
        for motion in part
        for joint in motion.joints
    }
    kind = next(one for one in list_kinds(robot, motions, usable or None) if one.has_base)
    logs = Logs(tuple(motions))
    known = catalogue(robot, logs)
    check_names(known)
    raw = kind.make(motions, False)
    shown, _ = choose_shown(robot, kind, known)
    base = [one for one in base_effects(robot, logs) if kind.shows(one)]
    common = select_effects(
        raw, base, shown, seed=seed, meter=Meter(lambda share, text: progress(0.5 * share, text))
    )
    sizes, columns = common.chosen.sizes, common.context.union.columns
    present = (*base, *common.chosen.effects)
    model = ComparedResiduals(raw, {one: sizes[columns([one])] for one in present})
    changes = [Change(one.place, _unbound(one)) for one in (*base, *shown)]
    selection = select_effects(
        model, present, changes, seed=seed, meter=Meter(lambda share, text: progress(0.5 + 0.5 * share, text))
    )
    sure, sets, rejected = select_sure(selection, None)
    found = assemble(robot, model, sure, sets, model)
    limits = list_limits(sure, changes[: len(base)])
    progress(1.0, "done")
    return Comparison(
        replace(found, seed=seed, base=(), rejected=tuple(rejected), fitted_motions=raw.motions), limits
    )


def _rename(motions: Sequence[Motion], prefix: str) -> list[Motion]:
    """Put a set before the names of motions; motions of two sets are no repeats of one another."""
    return [
        replace(one, name=prefix + one.name, repeat_of=prefix + one.repeat_of if one.repeat_of else "")
        for one in motions
    ]


def _unbound(effect: Effect) -> Effect:
    """Return a base effect without its prior."""
    return replace(effect, is_base=False) if isinstance(effect, JointEffect) else effect


def list_limits(selection: Selection, changes: Sequence[Change]) -> tuple[Limit, ...]:
    """List the intervals of changes of base parameters: all of a joint may change, beside the findings."""
    context, chosen = selection.context, selection.chosen
    found = []
    for j, joint in enumerate(context.model.joints):
        own = [one for one in changes if one.place == joint]
        if not own:
            continue
        start = start_fit(context, (*chosen.effects, *own), j, chosen.sizes, chosen.fits)
        (fit,) = fit_together(context, [start], "limits")
        intervals = size_intervals(context, fit)
        for change in own:
            for column, size in zip(context.union.columns([change]), change.sizes, strict=True):
                low, high = intervals[fit.columns == column][0]
                found.append(Limit(joint, size.name, float(low), float(high)))
    return tuple(found)
