"""Counts over many targets: valid branches, and reasons of invalid ones."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, IkResult

JOINT_NAMES: Final = tuple(joint.name.lower() for joint in Joint)
VERDICT_NAMES: Final = tuple(verdict.name.lower() for verdict in BranchVerdict)


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts that add up over parts of a batch."""

    targets_by_valid: Counter[int] = field(default_factory=Counter)
    """Number of targets by their number of valid branches."""
    valid_by_branch: Counter[str] = field(default_factory=Counter)
    by_verdict: Counter[str] = field(default_factory=Counter)
    outside_by_joint: Counter[str] = field(default_factory=Counter)
    """Number of branches outside limits, by the joint farthest beyond its limit."""

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(
            self.targets_by_valid + other.targets_by_valid,
            self.valid_by_branch + other.valid_by_branch,
            self.by_verdict + other.by_verdict,
            self.outside_by_joint + other.outside_by_joint,
        )

    @property
    def targets(self) -> int:
        """Return the number of targets."""
        return self.targets_by_valid.total()

    @property
    def out(self) -> int:
        """Return the number of invalid branches."""
        return self.by_verdict.total() - self.by_verdict["valid"]


def tally(result: IkResult) -> Tally:
    """Count the results of a batch."""
    valid = result.verdict == BranchVerdict.VALID
    outside = result.verdict == BranchVerdict.OUTSIDE_LIMITS
    return Tally(
        Counter(dict(_count_values(valid.sum(axis=0)))),
        Counter(dict(zip(BRANCHES, valid.sum(axis=1).tolist(), strict=True))),
        Counter({VERDICT_NAMES[k]: count for k, count in _count_values(result.verdict)}),
        Counter({Joint(k).name.lower(): count for k, count in _count_values(result.joint[outside])}),
    )


def _count_values(numbers: NDArray[np.int64]) -> list[tuple[int, int]]:
    values, counts = np.unique(numbers, return_counts=True)
    return [(int(value), int(count)) for value, count in zip(values, counts, strict=True)]
