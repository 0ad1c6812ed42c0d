"""Comparison of two sets of logs of one robot: what both have in common, and then what differs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simgap.arrays import Flags
from simgap.assemble import assemble, select_sure
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.records import Audit
from simgap.common.errors import RobotError
from simgap.diagnosis import check_names, choose_shown
from simgap.effects.variation import unbound
from simgap.logs import Logs, Motion
from simgap.report.user_units import convert_errors
from simgap.residuals.known_effects import Change, KnownResiduals
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
    is_after: Flags = np.array([name.startswith(AFTER) for name in raw.motions])
    model = KnownResiduals(raw, {one: sizes[columns([one])] for one in present}, is_after)
    changes = [Change(one.place, unbound(one)) for one in (*base, *shown)]
    selection = select_effects(
        model, present, changes, seed=seed, meter=Meter(lambda share, text: progress(0.5 + 0.5 * share, text))
    )
    sure, sets, rejected = select_sure(selection, None)
    found = convert_errors(robot, assemble(robot, model, sure, sets, model))
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
