"""Share simulations: hypotheses at joints that scarcely move one another are put into one candidate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Flags, Integers

ALL_JOINTS: Final = -1
MAX_COUPLING: Final = 0.1
"""Largest change at another joint over that at the joint itself, each in the scale of its residuals.

What removes all residuals of one joint then changes the mean square of another by a hundredth: a fifth of the
least share that gets a name.
"""
AT_ONCE: Final = 32
"""Candidates whose residuals are kept at once: those of long logs are large."""


@dataclass(frozen=True, slots=True)
class Sharing:
    """Joints whose hypotheses may share a candidate."""

    groups: tuple[tuple[int, ...], ...]
    """Indices of joints, each in one group."""
    mixing: Integers
    """Columns of sizes at one joint that change other joints of its group; points that differ in them do not
    share."""

    def plan(self, points: Sequence[tuple[int, Array]]) -> list[list[int]]:
        """Distribute points over as few candidates as possible.

        Args:
            points: Joint, or ALL_JOINTS, and sizes of the union in their units, (n_sizes,), for each.

        Returns:
            For each candidate the indices of its points, at most one of each joint.
        """
        group_of = {joint: g for g, group in enumerate(self.groups) for joint in group}
        alone: list[list[int]] = []
        queues: dict[tuple[int, bytes], dict[int, list[int]]] = {}
        for k, (joint, sizes) in enumerate(points):
            if joint == ALL_JOINTS:
                alone.append([k])
            else:
                key = group_of[joint], sizes[self.mixing].tobytes()
                queues.setdefault(key, {}).setdefault(joint, []).append(k)
        slots = [slot for lanes in queues.values() for slot in zip_longest(*lanes.values())]
        return alone + [[k for k in slot if k is not None] for slot in slots]


def share_nothing(n_joints: int) -> Sharing:
    """Return the sharing in which each joint has candidates of its own.

    Args:
        n_joints: Number of joints.
    """
    return Sharing(tuple((j,) for j in range(n_joints)), np.empty(0, np.int64))


def measure_reach(
    simulate: Callable[[Sequence[Array]], Sequence[Array]],
    joint_of: Integers,
    scales: Array,
    now: tuple[Array, Array],
    columns: Sequence[tuple[Integers, Array]],
) -> Array:
    """Measure how much effects of typical size move each joint.

    Args:
        simulate: Returns the residuals of all joints, (n,), of size vectors of the union, (n_sizes,) each.
        joint_of: Joint of each residual, (n,) index.
        scales: Scale of the residuals of each joint, (n_joints,), in the unit of the model.
        now: Present sizes, (n_sizes,), in their units, and their residuals, (n,), in the unit of the model.
        columns: For each effect the columns of its sizes, and its typical sizes in their units.

    Returns:
        RMS changes over the scales, (n_effects, n_joints), without a unit.
    """
    sizes, residuals = now
    count = np.maximum(np.bincount(joint_of, minlength=len(scales)), 1)
    reach = []
    for first in range(0, len(columns), AT_ONCE):
        points = []
        for free, typical in columns[first : first + AT_ONCE]:
            point = sizes.copy()
            point[free] = typical
            points.append(point)
        for moved in simulate(points):
            square = np.bincount(joint_of, weights=(moved - residuals) ** 2, minlength=len(scales))
            reach.append(np.sqrt(square / count) / scales)
    return np.array(reach).reshape(-1, len(scales))


def find_sharing(places: Sequence[int], columns: Sequence[Integers], is_base: Flags, reach: Array) -> Sharing:
    """Put joints into groups whose base parameters scarcely move one another.

    Args:
        places: Joint of each effect, index; ALL_JOINTS for one at a body.
        columns: Columns of the sizes of each effect.
        is_base: True for effects that decide the groups, (n_effects,).
        reach: Changes by `measure_reach`, (n_effects, n_joints), without a unit.

    Returns:
        The groups, and the columns of effects that nevertheless move another joint of their group.
    """
    n_joints = reach.shape[1]
    coupling = np.zeros((n_joints, n_joints))
    for joint, is_mover, row in zip(places, is_base, reach, strict=True):
        if joint != ALL_JOINTS and is_mover:
            coupling[joint] = np.maximum(coupling[joint], relative_reach(joint, row))
    coupling = np.maximum(coupling, coupling.T)
    groups: list[list[int]] = []
    for joint in range(n_joints):
        free = [group for group in groups if coupling[joint, group].max() <= MAX_COUPLING]
        if free:
            free[0].append(joint)
        else:
            groups.append([joint])
    mixing = [np.empty(0, np.int64)]
    for joint, own, row in zip(places, columns, reach, strict=True):
        if joint == ALL_JOINTS:
            continue
        (group,) = (one for one in groups if joint in one)
        if relative_reach(joint, row)[group].max() > MAX_COUPLING:
            mixing.append(own)
    return Sharing(tuple(tuple(group) for group in groups), np.concatenate(mixing))


def relative_reach(joint: int, reach: Array) -> Array:
    """Return the changes at other joints over that at a joint.

    Args:
        joint: Index of the joint.
        reach: Changes at all joints, (n_joints,), without a unit.

    Returns:
        Ratios, (n_joints,); 0 at the joint itself.
    """
    ratios: Array = reach / max(float(reach[joint]), 1e-12)
    ratios[joint] = 0.0
    return ratios
