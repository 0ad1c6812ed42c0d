"""The tools of the flight turret, registered on its interface before it is mounted: paper, Verification."""

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.kinematics.arm import build_arm
from fsw.kinematics.transforms import Pose, screw_exp
from ground.calibration.arm_numbers import FIXTURE_M, FIXTURE_RAD
from ground.calibration.settled import true_params
from sim.arms import BuiltArm


def registered_tools(arm: BuiltArm, seed: int) -> dict[Tool, Pose]:
    """X_FT of every tool as the tracker measures it, from targets on the tool and on the interface."""
    rng = np.random.default_rng([seed, 3])
    truth = build_arm(true_params(arm))
    noise = np.repeat([FIXTURE_RAD, FIXTURE_M], 3)
    return {tool: truth.X_FT[tool] @ screw_exp(noise * rng.standard_normal(6)) for tool in Tool}
