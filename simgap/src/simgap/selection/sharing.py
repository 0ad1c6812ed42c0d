"""Share simulations: hypotheses at joints that scarcely move one another are put into one candidate.

`joint_of_column` is the joint of each size, or ALL_JOINTS, (n_sizes,); `reach` has changes at all joints,
(n_joints,), without a unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers

Point = tuple[int, Array]
"""Joint, or ALL_JOINTS, and sizes of the union in their units, (n_sizes,) or (n_motions, n_sizes)."""
ALL_JOINTS: Final = -1
MAX_COUPLING: Final = 0.1
"""Largest change at another joint over that at the joint itself, each in the scale of its residuals.

What removes all residuals of one joint then changes the mean square of another by a hundredth: a fifth of the
least share that gets a name.
"""


@dataclass(frozen=True, slots=True)
class Sharing:
    """Joints whose hypotheses may share a candidate."""

    groups: tuple[tuple[int, ...], ...]
    """Indices of joints, each in one group."""
    mixing: Integers
    """Columns of sizes at one joint that change other joints of its group; points that differ in them, or in
    sizes of all joints, do not share."""
    reaching: Integers
    """Columns of sizes at one joint that change any other joint by more than MAX_COUPLING."""
    joint_of_column: Integers
    """Joint whose residuals decide each size, or ALL_JOINTS, (n_sizes,)."""

    def alone(self) -> "Sharing":
        """Return the sharing with the same joints of columns in which each joint has its own candidates."""
        return replace(self, groups=tuple((joint,) for group in self.groups for joint in group))

    def may_share(self, first: int, second: int) -> bool:
        """Return whether sizes in two columns scarcely change each other's joint; False at the same."""
        joints = {int(self.joint_of_column[first]), int(self.joint_of_column[second])}
        if len(joints) < 2 or ALL_JOINTS in joints or np.isin((first, second), self.mixing).any():
            return False
        return any(joints <= set(group) for group in self.groups)

    def list_fitted(self, joint: int) -> Flags:
        """List the sizes that the residuals of a joint, or of ALL_JOINTS, decide: flags, (n_sizes,)."""
        return np.asarray((self.joint_of_column == joint) | (joint == ALL_JOINTS))

    def plan(self, points: Sequence[Point]) -> list[list[int]]:
        """Distribute points over few candidates; list the points of each, at most one of each joint."""
        same = np.union1d(self.mixing, np.flatnonzero(self.joint_of_column == ALL_JOINTS))
        group_of = {joint: g for g, group in enumerate(self.groups) for joint in group}
        alone: list[list[int]] = []
        queues: dict[tuple[int, bytes], dict[int, list[int]]] = {}
        for k, (joint, sizes) in enumerate(points):
            if joint == ALL_JOINTS:
                alone.append([k])
            else:
                key = group_of[joint], sizes[..., same].tobytes()
                queues.setdefault(key, {}).setdefault(joint, []).append(k)
        slots = [slot for lanes in queues.values() for slot in zip_longest(*lanes.values())]
        return alone + [[k for k in slot if k is not None] for slot in slots]

    def merge(self, points: Sequence[Point]) -> Array:
        """Put the sizes of points at different joints into one candidate, in the shape of the points."""
        merged = points[0][1].copy()
        for joint, sizes in points[1:]:
            mine = self.joint_of_column == joint
            merged[..., mine] = sizes[..., mine]
        return merged


def share_nothing(n_joints: int, joint_of_column: Integers) -> Sharing:
    """Return the sharing in which each joint has candidates of its own."""
    none = np.empty(0, np.int64)
    return Sharing(tuple((j,) for j in range(n_joints)), none, none, joint_of_column)


def find_sharing(
    joints: Sequence[int],
    columns: Sequence[Integers],
    decides: Flags,
    reach: Array,
    joint_of_column: Integers,
) -> Sharing:
    """Put joints into groups whose base parameters scarcely move one another.

    Each effect has the index of its joint, the columns of its sizes, (n_own,), and changes by
    `measure_reach`, (n_effects, n_joints). Flags, (n_effects,), tell which effects decide the groups. Columns
    of effects that nevertheless move another joint of their group are `reaching`.
    """
    n_joints = reach.shape[1]
    coupling = np.zeros((n_joints, n_joints))
    for joint, does_decide, row in zip(joints, decides, reach, strict=True):
        if does_decide:
            coupling[joint] = np.maximum(coupling[joint], relative_reach(joint, row))
    coupling = np.maximum(coupling, coupling.T)
    groups: list[list[int]] = []
    for joint in range(n_joints):
        free = [group for group in groups if coupling[joint, group].max() <= MAX_COUPLING]
        if free:
            free[0].append(joint)
        else:
            groups.append([joint])
    mixing, reaching = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for joint, own, row in zip(joints, columns, reach, strict=True):
        (group,) = (one for one in groups if joint in one)
        ratios = relative_reach(joint, row)
        if ratios[group].max() > MAX_COUPLING:
            mixing.append(own)
        if ratios.max() > MAX_COUPLING:
            reaching.append(own)
    fixed = tuple(tuple(group) for group in groups)
    return Sharing(fixed, np.concatenate(mixing), np.concatenate(reaching), joint_of_column)


def relative_reach(joint: int, reach: Array) -> Array:
    """Return the changes at other joints over that at a joint, (n_joints,); 0 at the joint itself."""
    ratios: Array = reach / max(float(reach[joint]), 1e-12)
    ratios[joint] = 0.0
    return ratios
