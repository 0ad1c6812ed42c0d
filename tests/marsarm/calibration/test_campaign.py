"""Campaign in the closed loop: measurements show the true arm at the poses that flight software reached."""

import numpy as np
import pytest

from marsarm.calibration.calibrate import data_sha256
from marsarm.calibration.campaign import (
    PAPER_GROUPS,
    CampaignPlan,
    earth_reference,
    resize_groups,
    run_campaign,
)
from marsarm.calibration.verify import simulate_campaign, true_poses, zero_errors_rad
from sim.arm_check import NoPlan
from sim.arms import arm_named
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from simgap.serial_arm.chain import error_screw
from tests.marsarm.calibration.lab import campaign


@pytest.mark.slow
def test_the_papers_campaign_is_planned():
    assert [(g.turret_kg, round(np.degrees(g.roll_rad)), g.count) for g in PAPER_GROUPS] == [
        (8.0, 0, 40),
        (19.0, 0, 40),
        (8.0, 20, 40),
        (19.0, 20, 40),
    ]
    inside = sum(branch.startswith("shoulder-in") for branch in campaign().branch)
    assert inside == pytest.approx(0.3 * 160, abs=2)


def test_an_arm_whose_loads_on_earth_cannot_be_those_on_mars_is_refused(monkeypatch):
    def find_no_plan(arm, on_earth):
        raise NoPlan("the best torques differ from the wanted ones by [9.0] N m")

    monkeypatch.setattr("marsarm.calibration.campaign.without_turret", find_no_plan)
    with pytest.raises(BadRequest, match="arm: no poses for Earth without a turret: the best torques differ"):
        earth_reference(arm_named("nominal"), no_progress)


def test_the_same_seed_gives_the_same_campaign():
    plan = CampaignPlan(resize_groups(PAPER_GROUPS, 8), seed=3)
    one, other = (data_sha256(simulate_campaign(arm_named("as-built:3"), plan)) for _ in range(2))
    assert one == other


@pytest.mark.slow
def test_in_the_closed_loop_the_true_arm_is_measured():
    arm = arm_named("as-built:5")
    reference = earth_reference(arm, no_progress)
    found = run_campaign(arm, reference, CampaignPlan(resize_groups(PAPER_GROUPS, 4)), no_progress)
    assert found.count == 4
    assert np.all(found.targets_seen >= 3)
    assert np.all(found.misfit_m < 1.5e-4)
    truth = true_poses(arm, found.believed, zero_errors_rad(arm, reference))
    off = error_screw(truth, found.measured.X_RT)[3:]
    assert np.linalg.norm(off, axis=0).max() < 0.3e-3
