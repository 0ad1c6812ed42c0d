"""Execution of a calibration: measure or read poses, fit, check, verify, write the files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params
from marsarm.calibration.calibrate import Calibration, calibrate
from marsarm.calibration.campaign import (
    PAPER_GROUPS,
    CampaignPlan,
    earth_reference,
    resize_groups,
    run_campaign,
)
from marsarm.calibration.campaign_data import Campaign
from marsarm.calibration.campaign_file import read_campaign, save_campaign
from marsarm.calibration.checks import BadData, check_data, check_fit
from marsarm.calibration.parameter_file import calibrated_params, save_parameter_file
from marsarm.calibration.request import CalibrateRequest
from marsarm.calibration.verify import (
    HARDSTOP_TARGETS,
    WORLDS,
    Verification,
    register_tools,
    verify_calibration,
)
from marsarm.common.requests import load_params, select_arm
from sim.arm_model.load import ArmModel
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.params_table import BadParams, check_params
from sim.tracker import Tracker
from simgap.common.errors import BadRequest
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress, part_of

MICRO: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class CalibrateReport:
    """Result of a request for a calibration."""

    request: CalibrateRequest
    found: Calibration
    params: Params
    """Calibrated parameters."""
    verification: Verification | None


def run_calibration(request: CalibrateRequest, progress: Progress = no_progress) -> CalibrateReport:
    """Measure or read a campaign, fit, check and verify, and write the requested files.

    Raises:
        BadRequest: The request or the data are wrong, or the fit is not acceptable; nothing was written.
    """
    arm, base = _check_request(request)
    measured = _measuring_share(request)
    try:
        campaign = _take_campaign(request, arm, part_of(progress, 0.0, measured))
        drawing = _drawing_of(campaign) if arm is None else arm.model
        if base is None and request.params is not None:
            base = load_params(campaign.arm_name, request.params, request.mismatch)
        base = base or drawing.params
        check_data(base, campaign)
        progress(measured, 1.0, "fitting")
        found = calibrate(base, campaign, built=drawing.description.tolerances.built)
        check_fit(found)
        tools = None if arm is None else register_tools(arm, request.seed)
        params = calibrated_params(found, tools)
        check_params(params, "the calibrated arm")
        verification = None
        if arm is not None and request.verify:
            verification = verify_calibration(
                arm, params, request.verify, request.seed, part_of(progress, measured, 1.0)
            )
        if request.save_data is not None:
            save_campaign(campaign, request.save_data)
        if request.out is not None:
            save_parameter_file(found, params, request.out)
    except BadParams as error:
        raise BadRequest(str(error)) from error
    return CalibrateReport(request, found, params, verification)


def _check_request(request: CalibrateRequest) -> tuple[BuiltArm | None, Params | None]:
    """Check all that can be checked before any motion or output.

    Returns:
        The arm to measure and the parameters over those of its drawing, if there are any.
    """
    check_options(request)
    if (request.arm is None) == (request.data is None):
        raise BadRequest(
            "calibrate: give --arm ARM to measure one in simulation, or --data TABLE of a real one"
        )
    if request.data is not None and (request.verify or request.save_data is not None):
        raise BadRequest("calibrate: --verify and --save-data are for an arm in simulation; give no --data")
    if not all(0 <= um < 1e4 for um in request.tracker_um) or request.tracker_um[0] == 0:
        raise BadRequest("tracker: its noise is not within 0 .. 10000 micrometres, the first above 0")
    if request.arm is None:
        return None, None
    if request.params is None:
        return select_arm(request.arm, None), None
    base = load_params(request.arm, request.params, request.mismatch)
    return arm_named(request.arm, base), base


def _drawing_of(campaign: Campaign) -> ArmModel:
    """Return the drawing of a measured arm."""
    if not campaign.count:
        raise BadData("data: holds no pose")
    try:
        return arm_named(campaign.arm_name).model
    except UnknownArm as error:
        raise BadData(f"column arm: {error}") from error


def _require_table(path: Path | None) -> Path:
    if path is None:
        raise BadRequest("data: give a table")
    return path


def _take_campaign(request: CalibrateRequest, arm: BuiltArm | None, progress: Progress) -> Campaign:
    """Read the measured poses, or measure the arm in simulation."""
    if arm is None:
        return read_campaign(_require_table(request.data))
    um, um_per_m = request.tracker_um
    tracker = Tracker(sigma_m=um * MICRO, sigma_per_m=um_per_m * MICRO)
    plan = CampaignPlan(resize_groups(PAPER_GROUPS, request.poses), tracker, request.seed)
    found = HARDSTOP_TARGETS / (HARDSTOP_TARGETS + request.poses)
    reference = earth_reference(arm, part_of(progress, 0.0, found))
    return run_campaign(arm, reference, plan, part_of(progress, found, 1.0))


def _measuring_share(request: CalibrateRequest) -> float:
    """Return the share of the measurements in all work; the rest verifies the result."""
    measuring = HARDSTOP_TARGETS + request.poses
    verifying = 2 * HARDSTOP_TARGETS + WORLDS * request.verify if request.verify else 0
    return measuring / (measuring + verifying)
