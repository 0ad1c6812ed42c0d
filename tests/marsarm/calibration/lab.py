"""Simulated campaign for tests, made once."""

from functools import cache

from marsarm.calibration.calibrate import Calibration, calibrate
from marsarm.calibration.campaign import CampaignPlan
from marsarm.calibration.campaign_data import Campaign
from marsarm.calibration.verify import simulate_campaign
from sim.arms import arm_named, nominal_params

NOMINAL = nominal_params()


@cache
def campaign() -> Campaign:
    return simulate_campaign(arm_named("as-built:1"), CampaignPlan(seed=1))


@cache
def calibration() -> Calibration:
    return calibrate(NOMINAL, campaign())
