"""Simulated campaigns for tests, each made once."""

from functools import cache

import numpy as np

from fsw.kinematics.arm import build_arm
from fsw.kinematics.transforms import Pose
from marsarm.calibration.calibrate import Calibration, calibrate
from marsarm.calibration.campaign import CampaignPlan
from marsarm.calibration.campaign_data import Campaign
from marsarm.calibration.verify import simulate_campaign, true_params
from sim.arms import arm_named, nominal_params

NOMINAL = nominal_params()


@cache
def campaign(seed: int = 1) -> Campaign:
    return simulate_campaign(arm_named(f"as-built:{seed}"), CampaignPlan(seed=seed))


@cache
def calibration(seed: int = 1) -> Calibration:
    return calibrate(NOMINAL, campaign(seed))


def truth(seed: int):
    return build_arm(true_params(arm_named(f"as-built:{seed}")))


def moved(X: Pose, by: np.ndarray) -> Pose:
    return Pose(X.R, X.p + by)
