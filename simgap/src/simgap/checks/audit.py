"""Audit of logs: remarks, and samples that a diagnosis must not use."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags
from simgap.checks.commands import find_exchanged, find_leading, find_unlike_repeats
from simgap.checks.limits import chain_joints, find_collisions, find_cut_offs, find_plane, find_saturation
from simgap.checks.rates import audit_rates
from simgap.checks.records import Audit, Faulty, RemarkKind
from simgap.checks.signals import (
    describe_spikes,
    find_dead_commands,
    find_idle_signals,
    find_late_starts,
    find_low_rates,
    find_still_joints,
    find_wraps,
    flag_samples,
)
from simgap.checks.static import Rest, find_rest, predict_free
from simgap.checks.units import audit_units
from simgap.logs import Logs, Motion
from simgap.result import Refusal
from simgap.robot import ControlMode, Robot

TESTS: Final = (
    *(audit_units, find_wraps, find_exchanged, find_leading, find_still_joints, find_low_rates),
    *(find_late_starts, find_idle_signals, find_dead_commands, find_unlike_repeats),
)
"""Tests of the signals of joints; each returns its remarks."""
PASSES: Final = 2
"""The second pass predicts free positions without the samples that the first has found held back."""


def audit(robot: Robot, logs: Logs) -> Audit:
    """Audit logs against their robot.

    Stale and invalid samples, spikes, cut-off commands and contact with a plane are refused.
    """
    motions = logs.motions
    faulty = flag_samples(motions)
    rates, remarks = audit_rates(robot, motions, faulty)
    remarks += describe_spikes(robot, motions, faulty)
    for find in TESTS:
        remarks += find(robot, motions)
    rest = find_rest(robot, motions)
    held = np.zeros(rest.measured.shape, np.bool_)
    is_below = np.zeros(rest.time_s.size, np.bool_)
    chain = np.isin(rest.joints, chain_joints(robot))
    for _ in range(PASSES):
        free = predict_free(robot, motions, rest, held | (is_below[:, None] & chain))
        cut_offs, held, is_cut_off = find_cut_offs(robot, motions, rest, free)
        contact, is_below = find_plane(robot, motions, rest, free, np.asarray(held.any(axis=1)))
    remarks += [*cut_offs, *contact, *find_saturation(robot, motions), *find_collisions(robot, motions, rest)]
    ranked = sorted(remarks, key=lambda one: list(RemarkKind).index(one.kind))
    reasons = {
        "command is cut off": is_cut_off,
        "contact with a plane": is_below[:, None] & chain,
    }
    usable, refused = _refuse(motions, rest, faulty, reasons)
    return Audit(rates, tuple(ranked), refused, usable, tuple(_find_untested(robot, motions)))


def _find_untested(robot: Robot, motions: Sequence[Motion]) -> Iterator[str]:
    """Yield each fault that these logs cannot show, with the reason."""
    by_position = [joint.name for joint in robot.joints if joint.mode is ControlMode.POSITION]
    logs = [(name, log) for motion in motions for name, log in motion.joints.items()]
    if all(log.command is None for name, log in logs if name in by_position):
        yield "exchanged and reversed joints and columns, as no position command is logged"
    elif len(by_position) < 2:
        yield "exchanged joints, as one joint alone has position commands"
    if not any(log.velocity is not None and np.ptp(log.velocity.value) > 0.0 for _, log in logs):
        yield "times that are wrong by less than a factor of 100, as no velocity that changes is logged"


def _refuse(
    motions: Sequence[Motion], rest: Rest, faulty: Faulty, reasons: Mapping[str, Flags]
) -> tuple[dict[tuple[str, str], Flags], tuple[Refusal, ...]]:
    """Return flags of usable position samples, and for each motion and reason how many rows are refused."""
    usable: dict[tuple[str, str], Flags] = {}
    refused: list[Refusal] = []
    for number, motion in enumerate(motions):
        at = np.flatnonzero(rest.motion == number)
        count: Counter[str] = Counter()
        for name, log in motion.joints.items():
            flags = dict(faulty[motion.name, name])
            if name in rest.joints and at.size:
                own = {why: one[at, rest.joints.index(name)] for why, one in reasons.items()}
                time_s = log.position.time_s
                flags |= {why: _at_samples(rest.time_s[at], one, time_s) for why, one in own.items()}
            good = np.ones(log.position.value.size, np.bool_)
            for why, hit in flags.items():
                count[why] = max(count[why], int(np.sum(hit & good)))
                good &= ~hit
            usable[motion.name, name] = good
        refused += [Refusal(motion.name, why, n) for why, n in count.items() if n]
    return usable, tuple(refused)


def _at_samples(rest_time_s: Array, flags: Flags, time_s: Array) -> Flags:
    """Return for each position sample whether a neighbour at the low rate is flagged, (n,)."""
    after = np.clip(np.searchsorted(rest_time_s, time_s), 0, flags.size - 1)
    return flags[after] | flags[np.maximum(after - 1, 0)]
