"""Comparison of two sets of logs of one robot: what both have in common, and what differs."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from simgap.arrays import Array
from simgap.assemble import assemble, select_sure
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.records import Audit
from simgap.common.errors import RobotError
from simgap.diagnosis import (
    check_commands,
    check_names,
    choose_shown,
    is_copy,
    list_variations,
    refer_to_chosen,
    tell_remarks,
)
from simgap.effects.effect import Effect
from simgap.effects.variation import Difference, Variation, unbound
from simgap.logs import Logs, Motion
from simgap.report.traces import convert_errors
from simgap.residuals.conditioned import JoinedResiduals
from simgap.residuals.residuals import (
    ResidualModel,
    WrappedResiduals,
    add_sizes,
    refer_to,
    residuals_by_motion,
    split_sizes,
)
from simgap.residuals.simulation_residuals import list_kinds
from simgap.result import Comparison, Limit
from simgap.robot import Robot
from simgap.selection.checkpoint import Checkpoint, Meter, Progress, find_steps
from simgap.selection.context import Selection, fit_together
from simgap.selection.joint_fits import leave_out, start_fit
from simgap.selection.selection import select_effects
from simgap.selection.verdict import size_intervals

BEFORE, AFTER = "before:", "after:"
"""Beginnings of the names of motions, by which the two sets are told apart."""


def compare(
    robot: Robot,
    before: Sequence[Motion],
    after: Sequence[Motion],
    *,
    audits: Sequence[Audit] = (),
    seed: int = 1,
    progress: Progress = lambda share, text: None,
    cache: str | Path | None = None,
) -> Comparison:
    """Find what changed in a robot between two sets of logs.

    Base parameters of both sets are fitted together. Effects of both, and differences of all of them between
    the sets, then compete in one selection, by the rules of a diagnosis.

    Args:
        audits: Audit of each set; the samples that they refuse take no part.
        seed: Seed of the folds: the same seed gives the same bits.
        progress: Called with the share that is done, from 0 to 1, and a text.
        cache: Folder for the steps of an unfinished comparison, as in `diagnose`.

    Raises:
        RobotError: A set has no motion, is a copy of the other, or does not follow its commands; or the logs
            have nothing by which both can be compared.
    """
    _check_sets(robot, before, after)
    motions = [*_rename(before, BEFORE), *_rename(after, AFTER)]
    usable = {
        (prefix + motion.name, joint): audit.is_usable(motion.name, joint)
        for prefix, part, audit in zip((BEFORE, AFTER), (before, after), audits, strict=False)
        for motion in part
        for joint in motion.joints
    }
    kind = next((one for one in list_kinds(robot, motions, usable or None) if one.has_base), None)
    if kind is None:
        raise RobotError("the logs have no command and no torque; a comparison needs one of them")
    logs = Logs(tuple(motions))
    known = [*catalogue(robot, logs)]
    known += list_variations(robot, logs, known)
    check_names(known)
    shown, _ = choose_shown(robot, kind, known)
    base = [one for one in base_effects(robot, logs) if kind.shows(one)]
    model = tell_apart(kind.make(motions, False))
    competing = list_competing(base, shown)
    steps = None if cache is None else find_steps(cache, robot, motions, (), usable, (), seed)
    with Checkpoint(steps, [*base, *competing]) as checkpoint:
        meter = Meter(progress)
        selection = select_effects(model, base, competing, seed=seed, meter=meter, checkpoint=checkpoint)
        sure, sets, rejected = select_sure(selection, None)
        fitted = refer_to_chosen(model, base, sure)
        found = convert_errors(robot, assemble(robot, fitted, with_common_model(sure), sets, fitted))
        limits = list_limits(sure)
    own = {(one.place, one.name) for one in list_differences(sure)}
    progress(1.0, "done")
    told = [*zip((BEFORE, AFTER), audits, strict=False)]
    return Comparison(
        replace(
            found,
            seed=seed,
            base=(),
            findings=tuple(one for one in found.findings if (one.place, one.effect) in own),
            rejected=tuple(rejected),
            fitted_motions=model.motions,
            refused=tuple(
                replace(one, motion=prefix + one.motion) for prefix, audit in told for one in audit.refused
            ),
            remarks=tuple(f"{prefix} {text}" for prefix, audit in told for text in tell_remarks(audit)),
        ),
        limits,
    )


def _check_sets(robot: Robot, before: Sequence[Motion], after: Sequence[Motion]) -> None:
    """Refuse by RobotError two sets that cannot be compared."""
    if not before or not after:
        raise RobotError("a comparison needs motions before and after; one of the two sets is empty")
    for one in after:
        if copied := next((other.name for other in before if is_copy(one, other)), None):
            raise RobotError(f"motion {one.name} after is a copy of {copied} before; give two logs")
    check_commands(robot, (*before, *after))
    for joint in robot.joints:
        has_torque = [
            any(one.joints[joint.name].torque is not None for one in part if joint.name in one.joints)
            for part in (before, after)
        ]
        if len({*has_torque}) > 1:
            without = ("before", "after")[has_torque.index(False)]
            raise RobotError(
                f"joint {joint.name}: no torque is logged {without}; leave `torque` out of the robot file to "
                "compare positions"
            )


class SetResiduals(WrappedResiduals):
    """Residuals of one of two sets, with its part of each difference; see `ResidualModel`."""

    def __init__(self, raw: ResidualModel, which: int) -> None:
        """Keep the residuals of the first set, 0, or of the second, 1."""
        super().__init__(raw)
        self.which = which

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n); those that differ elsewhere are one here."""
        inner, total = self._add(effects, sizes)
        if total.ndim == 3:
            return residuals_by_motion(self.raw, inner, total)
        distinct, place = np.unique(total, axis=0, return_inverse=True)
        return self.raw.residuals(inner, distinct)[place.reshape(-1)]

    def _add(self, effects: Sequence[Effect], sizes: Array) -> tuple[list[Effect], Array]:
        """Return the effects of this set, each once, and their sizes, (n_candidates, .., total sizes)."""
        terms = [
            (one.effect, one.split(own)[self.which]) if isinstance(one, Difference) else (one, own)
            for one, own in split_sizes(effects, sizes)
        ]
        return add_sizes(terms, sizes.shape[:-1])

    def select(self, motions: Sequence[str]) -> "SetResiduals":
        """Return the residuals of these motions alone."""
        return SetResiduals(self.raw.select(motions), self.which)

    def around(self, effects: Sequence[Effect], sizes: Array) -> "SetResiduals":
        """Return the residuals with another reference: effects with their sizes, (1, total sizes)."""
        inner, total = self._add(effects, sizes)
        return SetResiduals(refer_to(self.raw, inner, total[0]), self.which)


def tell_apart(raw: ResidualModel) -> JoinedResiduals:
    """Return residuals in which the two sets may differ, by the names of the motions."""
    parts = []
    for which, prefix in enumerate((BEFORE, AFTER)):
        own = [name for name in raw.motions if name.startswith(prefix)]
        parts.append(SetResiduals(raw.select(own), which))
    return JoinedResiduals(parts, raw.motions)


def list_competing(base: Sequence[Effect], shown: Sequence[Effect]) -> list[Effect]:
    """List effects that both sets have in common, and differences between the sets, beside one another.

    What follows a condition is in common.
    """
    steady = [one for one in shown if not isinstance(one, Variation)]
    every = {one.key: one for one in (*steady, *base)}  # the catalogue has some of the base too
    return [*shown, *(Difference(one.place, unbound(one)) for one in every.values())]


def list_differences(selection: Selection) -> list[Difference]:
    """List the differences that were found."""
    return [one for one in selection.chosen.effects if isinstance(one, Difference)]


def with_common_model(selection: Selection) -> Selection:
    """Return a selection whose base has all that both sets have in common, fitted without what differs."""
    changes, common = list_differences(selection), selection.chosen
    if changes:
        common = leave_out(selection.context, common, changes)
    return replace(selection, base=common)


def _rename(motions: Sequence[Motion], prefix: str) -> list[Motion]:
    """Put a set before the names of motions; motions of two sets are no repeats of one another."""
    return [
        replace(one, name=prefix + one.name, repeat_of=prefix + one.repeat_of if one.repeat_of else "")
        for one in motions
    ]


def list_limits(selection: Selection) -> tuple[Limit, ...]:
    """List the intervals of changes of base parameters that were not found; all of a joint may change."""
    context, chosen = selection.context, selection.chosen
    taken = {one.effect.key for one in list_differences(selection)}
    found = []
    for j, joint in enumerate(context.model.joints):
        base = [one for one in context.base if one.place == joint and one.key not in taken]
        own = [Difference(joint, unbound(one)) for one in base]
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
