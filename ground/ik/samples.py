"""Random targets of the primary workspace, and how many branches answer each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.ik import BranchVerdict
from fsw.kinematics.transforms import Array
from ground.common.progress import Progress
from ground.ik.model import ArmModel
from ground.ik.tally import Tally, tally
from ground.ik.targets import Targets
from sim.frames import p_R_from_N
from sim.workspace import approach_from, random_targets


@dataclass(frozen=True, slots=True, eq=False)
class ReachSamples:
    """Targets in the workspace, and how many valid branches each has."""

    p_NoTo_N_m: Array
    """(3, n)."""
    angles_rad: Array
    """(2, n): of the approach, below horizontal and to the right of straight ahead."""
    valid: NDArray[np.int64]
    """(n,)."""


def sample(model: ArmModel, count: int, seed: int, progress: Progress) -> tuple[ReachSamples, Tally]:
    """Random targets of the workspace with their answers, counted; the same for the same seed."""
    p_N_m, angles = random_targets(np.random.default_rng(seed), count)
    targets = Targets(p_R_from_N(p_N_m.T).T, approach_from(angles))
    valid, counted = [], Tally()
    for answers in model.in_parts(targets, progress):
        valid.append((answers.verdict == BranchVerdict.VALID).sum(axis=0))
        counted += tally(answers)
    return ReachSamples(p_N_m, angles, np.concatenate(valid)), counted
