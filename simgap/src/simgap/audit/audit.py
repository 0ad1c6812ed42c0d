"""Audit of logs: what to know of them before a diagnosis, and which samples it must not use."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags
from simgap.audit.collision import find_collisions
from simgap.audit.limits import find_cut_offs, find_saturation
from simgap.audit.plane import chain_joints, find_plane
from simgap.audit.rates import audit_rates, encoder_step_rad, find_constant_positions, stale_flags
from simgap.audit.records import Audit, RemarkKind
from simgap.audit.samples import joint_samples
from simgap.audit.static import Rest, find_rest, predict_free
from simgap.audit.units import audit_units
from simgap.logs import Logs, Motion
from simgap.result import Refusal
from simgap.robot import Robot

PASSES: Final = 2
"""The second pass predicts free positions without the samples that the first has found held back."""


def audit(robot: Robot, logs: Logs) -> Audit:
    """Audit logs against their robot.

    Args:
        robot: Robot with its nominal model.
        logs: Logs of all its motions, held out or not.

    Returns:
        Rates of all signals, remarks with the worst first, and the samples that are refused, with reasons.
        Stale and invalid samples, cut-off commands and contact with a plane are refused.
    """
    motions = logs.motions
    rates, remarks = audit_rates(motions)
    remarks += [*audit_units(robot, motions), *find_constant_positions(robot, motions)]
    rest = find_rest(robot, motions)
    held = np.zeros(rest.measured.shape, np.bool_)
    is_below = np.zeros(rest.time_s.size, np.bool_)
    chain = np.isin(rest.joints, chain_joints(robot))
    for _ in range(PASSES):
        free = predict_free(robot, motions, rest, held | (is_below[:, None] & chain))
        cut_offs, held = find_cut_offs(robot, motions, rest, free)
        contact, is_below = find_plane(robot, motions, rest, free, np.asarray(held.any(axis=1)))
    remarks += [*cut_offs, *contact, *find_saturation(robot, motions), *find_collisions(robot, motions, rest)]
    ranked = sorted(remarks, key=lambda one: list(RemarkKind).index(one.kind))
    reasons = {
        "command is cut off or the joint is too weak": held,
        "contact with a plane": is_below[:, None] & chain,
    }
    usable, refused = _refuse(motions, rest, reasons)
    return Audit(rates, tuple(ranked), refused, usable)


def _refuse(
    motions: Sequence[Motion], rest: Rest, reasons: Mapping[str, Flags]
) -> tuple[dict[tuple[str, str], Flags], tuple[Refusal, ...]]:
    """Return flags of usable position samples, and for each motion and reason how many rows are refused."""
    usable: dict[tuple[str, str], Flags] = {}
    refused: list[Refusal] = []
    step_rad = {name: encoder_step_rad(motions, name) for name in rest.joints}
    for number, motion in enumerate(motions):
        at = np.flatnonzero(rest.motion == number)
        count = dict.fromkeys([*reasons, "stale", "not finite"], 0)
        for name, log in motion.joints.items():
            samples, n = joint_samples(log), log.position.value.size
            good = np.zeros(n, np.bool_)
            good[samples.index] = True
            count["not finite"] = max(count["not finite"], int(np.sum(~good)))
            stale = np.zeros(n, np.bool_)
            stale[samples.index] = stale_flags(samples, step_rad.get(name, 0.0))
            count["stale"] = max(count["stale"], int(stale.sum()))
            good &= ~stale
            for reason, flags in reasons.items():
                if name in rest.joints and at.size:
                    own = flags[at, rest.joints.index(name)]
                    hit = _at_samples(rest.time_s[at], own, log.position.time_s)
                    count[reason] = max(count[reason], int(np.sum(hit & good)))
                    good &= ~hit
            usable[motion.name, name] = good
        refused += [Refusal(motion.name, reason, n) for reason, n in count.items() if n]
    return usable, tuple(refused)


def _at_samples(rest_time_s: Array, flags: Flags, time_s: Array) -> Flags:
    """Return for each position sample whether a neighbour at the low rate is flagged, (n,)."""
    after = np.clip(np.searchsorted(rest_time_s, time_s), 0, flags.size - 1)
    return flags[after] | flags[np.maximum(after - 1, 0)]
