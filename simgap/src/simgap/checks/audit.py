"""Audit of logs: remarks, and samples that a diagnosis must not use."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags
from simgap.checks.commands import find_exchanged
from simgap.checks.limits import chain_joints, find_collisions, find_cut_offs, find_plane, find_saturation
from simgap.checks.records import (
    Audit,
    RemarkKind,
    audit_rates,
    encoder_step_rad,
    find_constant_positions,
    joint_samples,
    stale_flags,
)
from simgap.checks.signals import find_late_starts, find_spikes, find_still_joints, find_wraps, spike_flags
from simgap.checks.static import Rest, find_rest, predict_free
from simgap.checks.units import audit_units
from simgap.logs import Logs, Motion
from simgap.result import Refusal
from simgap.robot import ControlMode, Robot

TESTS: Final = (
    audit_units,
    find_wraps,
    find_exchanged,
    find_constant_positions,
    find_still_joints,
    find_spikes,
    find_late_starts,
)
"""Tests of the signals of joints; each returns its remarks."""
PASSES: Final = 2
"""The second pass predicts free positions without the samples that the first has found held back."""


def audit(robot: Robot, logs: Logs) -> Audit:
    """Audit logs against their robot.

    Stale and invalid samples, spikes, cut-off commands and contact with a plane are refused.
    """
    motions = logs.motions
    rates, remarks = audit_rates(motions)
    for find in TESTS:
        remarks += find(robot, motions)
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
    return Audit(rates, tuple(ranked), refused, usable, tuple(_find_untested(robot, motions)))


def _find_untested(robot: Robot, motions: Sequence[Motion]) -> Iterator[str]:
    """Yield each fault that these logs cannot show, with the reason."""
    by_position = [joint.name for joint in robot.joints if joint.mode is ControlMode.POSITION]
    logs = [(name, log) for motion in motions for name, log in motion.joints.items()]
    if all(log.command is None for name, log in logs if name in by_position):
        yield "exchanged and reversed joints, as no position command is logged"
    elif len(by_position) < 2:
        yield "exchanged joints, as one joint alone has position commands"
    if all(log.velocity is None for _, log in logs):
        yield "times that are wrong by less than a factor of 100, as no velocity is logged"


def _refuse(
    motions: Sequence[Motion], rest: Rest, reasons: Mapping[str, Flags]
) -> tuple[dict[tuple[str, str], Flags], tuple[Refusal, ...]]:
    """Return flags of usable position samples, and for each motion and reason how many rows are refused."""
    usable: dict[tuple[str, str], Flags] = {}
    refused: list[Refusal] = []
    step_rad = {name: encoder_step_rad(motions, name) for name in rest.joints}
    for number, motion in enumerate(motions):
        at = np.flatnonzero(rest.motion == number)
        count = dict.fromkeys([*reasons, "spike", "stale", "not finite"], 0)
        for name, log in motion.joints.items():
            samples, n = joint_samples(log), log.position.value.size
            good = np.zeros(n, np.bool_)
            good[samples.index] = True
            count["not finite"] = max(count["not finite"], int(np.sum(~good)))
            for reason, find in (("stale", stale_flags), ("spike", spike_flags)):
                flags = np.zeros(n, np.bool_)
                flags[samples.index] = find(samples, step_rad.get(name, 0.0))
                count[reason] = max(count[reason], int(flags.sum()))
                good &= ~flags
            for reason, at_rest in reasons.items():
                if name in rest.joints and at.size:
                    own = at_rest[at, rest.joints.index(name)]
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
