"""Counts over many targets: which branches are valid, and why the others are out."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.branches import BRANCHES, slot_name
from fsw.kinematics.ik import BranchVerdict, IkResult

JOINT_NAMES: Final = tuple(joint.name.lower() for joint in Joint)
VERDICT_NAMES: Final = tuple(verdict.name.lower() for verdict in BranchVerdict)


@dataclass(frozen=True, slots=True)
class Tally:
    """Counts that add up over parts of a batch."""

    targets_by_valid: Counter[int] = field(default_factory=Counter)
    """Targets, by how many valid branches they have."""
    valid_by_branch: Counter[str] = field(default_factory=Counter)
    by_verdict: Counter[str] = field(default_factory=Counter)
    """Branches of targets, without those that are absent."""
    outside_by_joint: Counter[str] = field(default_factory=Counter)
    """Branches outside limits, by the joint that is farthest beyond its limit."""

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(
            self.targets_by_valid + other.targets_by_valid,
            self.valid_by_branch + other.valid_by_branch,
            self.by_verdict + other.by_verdict,
            self.outside_by_joint + other.outside_by_joint,
        )

    @property
    def targets(self) -> int:
        """How many targets there were."""
        return self.targets_by_valid.total()

    @property
    def branches(self) -> list[str]:
        """Every branch by name, and then every other root that was valid somewhere."""
        return list(dict.fromkeys((*BRANCHES, *sorted(self.valid_by_branch))))

    @property
    def out(self) -> int:
        """How many branches of targets are out, for whatever reason."""
        return self.by_verdict.total() - self.by_verdict["valid"]


def tally(answers: IkResult) -> Tally:
    """The counts of a batch (n,)."""
    valid = answers.verdict == BranchVerdict.VALID
    outside = answers.verdict == BranchVerdict.OUTSIDE_LIMITS
    verdicts = Counter(
        {
            VERDICT_NAMES[k]: int(count)
            for k, count in _count_values(answers.verdict)
            if k != BranchVerdict.ABSENT
        }
    )
    return Tally(
        Counter(dict(_count_values(valid.sum(axis=0)))),
        Counter({slot_name(slot): int(count) for slot, count in enumerate(valid.sum(axis=1)) if count}),
        verdicts,
        Counter({Joint(k).name.lower(): count for k, count in _count_values(answers.joint[outside])}),
    )


def _count_values(numbers: NDArray[np.int64]) -> list[tuple[int, int]]:
    values, counts = np.unique(numbers, return_counts=True)
    return [(int(value), int(count)) for value, count in zip(values, counts, strict=True)]
