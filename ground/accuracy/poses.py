"""Poses to be budgeted: targets over the primary workspace and its wedge, on every valid branch."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.kinematics.arm import Arm
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.transforms import Array
from sim.frames import p_R_from_N
from sim.workspace import approach_from, random_targets

BRANCHES_A_TARGET: Final = 3
"""Fewer than the valid ones of a target on average, so that one draw is nearly always enough."""


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Joint angles that bring a tool to targets of the workspace."""

    tool: Tool
    output_rad: Array
    """(5, n), of the arm as it hangs."""
    p_NoTo_N_m: Array
    """(3, n)."""


def workspace_poses(arm: Arm, tool: Tool, gravity_R_m_s2: Array, count: int, seed: int) -> Poses:
    """So many poses of a tool; the same for the same seed."""
    rng = np.random.default_rng([seed, tool])
    outputs, targets = np.zeros((5, 0)), np.zeros((3, 0))
    while outputs.shape[1] < count:
        p_N_m, angles = random_targets(rng, -(-count // BRANCHES_A_TARGET))
        answers = inverse_kinematics(arm, tool, p_R_from_N(p_N_m.T).T, approach_from(angles), gravity_R_m_s2)
        valid = answers.verdict.T == BranchVerdict.VALID  # target by target
        found = np.moveaxis(answers.output_rad, 1, -1)[:, valid]
        outputs = np.concatenate([outputs, found], axis=1)
        targets = np.concatenate([targets, p_N_m[:, np.nonzero(valid)[0]]], axis=1)
    return Poses(tool, outputs[:, :count], targets[:, :count])
