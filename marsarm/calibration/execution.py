"""Execution of a calibration: measure or read poses, fit, check, write the files, verify."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array, Integers, Pose, inverse
from marsarm.calibration.arm_parameters import PARAMETER_COUNT
from marsarm.calibration.calibrate import Calibration, calibrate, calibrated_params, parameter_text
from marsarm.calibration.campaign import (
    MIN_TARGETS,
    PAPER_GROUPS,
    CampaignPlan,
    earth_reference,
    resize_groups,
    run_campaign,
)
from marsarm.calibration.campaign_data import BadData, Campaign, read_campaign, save_campaign
from marsarm.calibration.residual_model import predict_poses
from marsarm.calibration.verify import (
    HARDSTOP_TARGETS,
    WORLDS,
    Verification,
    register_tools,
    verify_calibration,
)
from marsarm.common.options import LEAST_POSES, CalibrateRequest
from marsarm.common.requests import load_params, select_arm
from sim.arm_model.load import ArmModel
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.frames import P_NR_M
from sim.params import BadParams, check_params
from sim.tracker import Tracker
from simgap import Fit, HoldOutValidation, Identifiability, error_screw
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress, part_of

LEAST_SPAN_RAD: Final = 0.5
FRAME_RANK: Final = 26
"""Expected rank of the frame parameters, which the paper finds too.

The arm has five joints, three of them parallel, so other combinations are not identifiable.
"""
MAX_MEDIAN_ERROR_M: Final = 0.06
"""Largest median error of nominal poses, at one metre from the turret."""
MAX_ERROR_M: Final = 0.15
"""Largest error of a single nominal pose, at one metre from the turret."""
MAX_MISFIT_M: Final = 3e-4
MAX_TRACKER_MOTION_M: Final = 1e-3
GRAVITY_M_S2: Final = (1.0, 12.0)
FARTHEST_M: Final = 4.0
TURRET_KG: Final = (1.0, 100.0)
MAX_FRICTION_NM: Final = 1000.0
MAX_SIGMA0: Final = 1.5
"""Largest ratio of residuals to noise; above it, the model lacks an effect."""
MIN_SIGMA0: Final = 0.6
MAX_HELD_OUT_RATIO: Final = 1.3
"""Largest ratio of held-out residuals to their expected size."""
MAX_PRIOR_SIGMAS: Final = 5.0
"""Largest parameter value of a built arm, in prior sigmas."""


def check_data(nominal: Params, campaign: Campaign) -> None:
    """Check the data before the fit; BadData if the data are wrong; the message lists every reason."""
    _refuse(_check_poses(campaign))
    _refuse(_check_units(campaign))
    _refuse(_check_tracker(campaign))
    _refuse(_check_frames(nominal, campaign))


def check_fit(found: Calibration) -> None:
    """Check that a fit is neither bad nor too good, its arm within tolerances; BadData has every reason."""
    _refuse(_check_fit(found.best, found.frame_identifiability, found.hold_out))


def _refuse(reasons: Iterator[str]) -> None:
    lines = list(reasons)
    if lines:
        raise BadData("\n".join(lines))


def _check_poses(campaign: Campaign) -> Iterator[str]:
    if campaign.count < LEAST_POSES:
        yield f"poses: {campaign.count} are too few; {LEAST_POSES} at least (the paper took 160)"
    span = np.ptp(campaign.believed.motor_rad, axis=1) if campaign.count else np.zeros(len(Joint))
    for joint in Joint:
        if span[joint] < LEAST_SPAN_RAD:
            yield (
                f"joint {joint.name.lower()}: moves over {np.degrees(span[joint]):.1f} deg in all poses; "
                f"poses must differ by {np.degrees(LEAST_SPAN_RAD):.0f} deg at least to tell its frames apart"
            )


def _check_units(campaign: Campaign) -> Iterator[str]:
    believed, measured = campaign.believed, campaign.measured
    turn = np.abs(believed.motor_rad).max()
    if turn > 3 * np.pi:
        yield f"motor_*_rad: up to {turn:.4g}; no joint turns so far: are these degrees? give radians"
    far = np.abs(measured.X_RT.p).max()
    if far > FARTHEST_M:
        yield f"p_*_m: up to {far:.4g} m from the rover's origin; are these millimetres? give metres"
    gravity = np.linalg.norm(believed.gravity_R_m_s2, axis=0)
    low, high = GRAVITY_M_S2
    if gravity.min() < low or gravity.max() > high:
        yield f"gravity_*_m_s2: {gravity.min():.4g} .. {gravity.max():.4g} long; give m/s2, 9.81 on Earth"
    if np.abs(believed.backlash_rad).max() > 0.02:
        yield f"backlash_*_rad: up to {np.abs(believed.backlash_rad).max():.4g}; half a backlash is 0.002 rad"
    friction_Nm = np.abs(believed.friction_Nm).max()
    if friction_Nm > MAX_FRICTION_NM:
        yield (
            f"friction_*_Nm: up to {friction_Nm:.4g}; friction holds less than {MAX_FRICTION_NM:.0f}: "
            "give newton metres"
        )
    sides = np.setdiff1d(believed.side, (-1.0, 0.0, 1.0))
    if sides.size:
        yield f"side_*: {sides[0]:.4g} is not a side; give +1 or -1 if the side is certain, else 0"
    kg = believed.turret_kg[~np.isnan(believed.turret_kg)]
    low_kg, high_kg = TURRET_KG
    if np.any((kg < low_kg) | (kg > high_kg)):
        yield (
            f"turret_kg: {kg.min():.4g} .. {kg.max():.4g}; a turret weighs {low_kg:.0f} .. {high_kg:.0f}: "
            "give kilograms, and leave it empty for the arm's own turret"
        )
    sigma = np.sqrt(np.diagonal(measured.covariance, axis1=1, axis2=2))
    if sigma.min() < 1e-7 or sigma.max() > 0.01:
        yield (
            f"cov_*: one sigma of {sigma.min():.2g} .. {sigma.max():.2g}; a tracker has 1e-5 .. 1e-3: "
            "give variances in rad2, rad m, m2"
        )


def _check_tracker(campaign: Campaign) -> Iterator[str]:
    for row, name in enumerate(("ground", "rover", "turret")):
        few = np.flatnonzero(campaign.targets_seen[row] < MIN_TARGETS)
        if few.size:
            yield (
                f"targets_{name}: {_list_poses(few)} with fewer than {MIN_TARGETS}: "
                "measure again or leave these poses out"
            )
    lost = np.flatnonzero(campaign.misfit_m > MAX_MISFIT_M)
    if lost.size:
        yield (
            f"misfit_m: {_list_poses(lost)} with targets up to {1e3 * campaign.misfit_m.max():.2f} mm "
            "from a rigid body: the tracker lost its lock or took another target; measure again"
        )
    moved = np.flatnonzero(campaign.tracker_moved_m > MAX_TRACKER_MOTION_M)
    if moved.size:
        yield (
            f"tracker_moved_m: {_list_poses(moved)}, ground up to "
            f"{1e3 * campaign.tracker_moved_m.max():.1f} mm "
            "from its first position: the tracker lost its lock or was moved; measure again"
        )
    X, turned_rad = campaign.measured.X_RT, np.diff(campaign.believed.motor_rad, axis=1)
    is_same = np.all(np.diff(X.p, axis=1) == 0, axis=0)
    stale = np.flatnonzero(is_same & (np.abs(turned_rad).max(axis=0) > 1e-3)) + 1
    if stale.size:
        yield (
            f"p_*_m: {_list_poses(stale)} equal to the pose before, although joints moved: the "
            "tracker lost its lock; measure again"
        )
    _, first = np.unique(np.concatenate([X.p, X.R.reshape(9, -1)]), axis=1, return_index=True)
    again = np.setdiff1d(np.arange(campaign.count), [*first, *stale])
    if again.size:
        yield (
            f"p_*_m, q_*: {_list_poses(again)} equal to an earlier pose to the last digit: "
            "leave out copied rows"
        )


def _check_frames(nominal: Params, campaign: Campaign) -> Iterator[str]:
    """Check that measured poses are near nominal ones; if not, try common mistakes of convention."""
    x = np.zeros(PARAMETER_COUNT)
    X = predict_poses(nominal, x, campaign.believed)
    off_m = _pose_error_m(X, campaign.measured.X_RT)
    as_given = float(np.median(off_m))
    if as_given < MAX_MEDIAN_ERROR_M:
        yield from _check_stray_poses(off_m)
        return
    alternatives = _wrong_conventions(campaign.measured.X_RT)
    found = {what: float(np.median(_pose_error_m(X, other))) for what, other in alternatives.items()}
    best = min(found, key=lambda what: found[what])
    hint = (
        f"{best} ({1e3 * found[best]:.0f} mm)"
        if found[best] < MAX_MEDIAN_ERROR_M
        else "no common mistake of convention explains it"
    )
    yield (
        f"measured poses: {1e3 * as_given:.0f} mm from the nominal ones (median); a built arm is within "
        f"{1e3 * MAX_MEDIAN_ERROR_M:.0f} mm. {hint[0].upper()}{hint[1:]}"
    )


def _check_stray_poses(off_m: Array) -> Iterator[str]:
    """Check for single poses with large errors, which would mislead the fit before it could reject them."""
    outliers = np.flatnonzero(off_m > MAX_ERROR_M)
    if outliers.size:
        yield (
            f"measured poses: {_list_poses(outliers)} up to {1e3 * off_m.max():.0f} mm from nominal, "
            f"the others {1e3 * float(np.median(off_m)):.0f} mm (median): the tracker lost its lock or took "
            "another target; measure again or leave out"
        )


def _wrong_conventions(X: Pose) -> dict[str, Pose]:
    flip = np.diag([1.0, -1.0, -1.0])
    return {
        "the frames are swapped: give the turret in the rover": inverse(X),
        "positions are in RNAV: give them in RMECH": Pose(X.R, X.p - P_NR_M[:, None]),
        "axes are z up: give x forward, y right, z down": Pose(
            np.einsum("ij,jkn->ikn", flip, X.R), flip @ X.p
        ),
        "quaternions are conjugated: give turret to rover": Pose(X.R.swapaxes(0, 1), X.p),
        "poses are one row too high": Pose(np.roll(X.R, 1, axis=2), np.roll(X.p, 1, axis=1)),
        "poses are one row too low": Pose(np.roll(X.R, -1, axis=2), np.roll(X.p, -1, axis=1)),
    }


def _pose_error_m(X: Pose, measured: Pose) -> Array:
    """Compute the error of each pose at one metre from its origin, shape (n,)."""
    T = error_screw(X, measured)
    return np.asarray(np.sqrt(np.sum(T**2, axis=0)))


def _check_fit(found: Fit, frames: Identifiability, verdict: HoldOutValidation) -> Iterator[str]:
    if not found.converged:
        yield "fit: did not converge"
    if frames.rank < FRAME_RANK:
        unseen = "; ".join(f"{', '.join(g.names)} as {g.identified}" for g in frames.unidentifiable_groups())
        yield (
            f"rank: the poses identify {frames.rank} of {FRAME_RANK} frame combinations ({unseen}); "
            "add poses that differ from these"
        )
    if found.sigma0 > MAX_SIGMA0:
        yield (
            f"residuals: {found.sigma0:.2f} times the noise, p = {found.p_value:.1e}; {MAX_SIGMA0} at most: "
            "the models of arm and tracker lack an effect"
        )
    if found.sigma0 < MIN_SIGMA0:
        yield (
            f"residuals: {found.sigma0:.2f} of the noise, {MIN_SIGMA0} at least: the covariances "
            f"are too large"
        )
    if verdict.ratio > MAX_HELD_OUT_RATIO:
        yield (
            f"held-out poses: {verdict.ratio:.2f} times what noise and covariance allow; "
            f"{MAX_HELD_OUT_RATIO} at most"
        )
    prior = np.array([parameter.prior_sigma for parameter in found.parameters])
    for k in np.flatnonzero(np.abs(found.values) > MAX_PRIOR_SIGMAS * prior):
        yield (
            f"{found.parameters[k].name}: {found.values[k]:.3g} {found.parameters[k].unit} from nominal, "
            f"{abs(found.values[k]) / prior[k]:.0f} times the manufacturing tolerance"
        )


def _list_poses(which: Integers) -> str:
    named = ", ".join(str(int(k)) for k in which[:6])
    return f"pose {named}" if which.size == 1 else f"poses {named}{' ...' if which.size > 6 else ''}"


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
    """Measure or read a campaign, fit, check and verify; BadRequest if request or data are wrong.

    Each file is written as soon as it can be: what follows may fail.
    """
    arm, base = _check_request(request)
    measured = _measuring_share(request)
    try:
        campaign = _take_campaign(request, arm, part_of(progress, 0.0, measured))
        if request.save_data is not None:
            save_campaign(campaign, request.save_data)
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
        if request.out is not None:
            with atomic_write(request.out, "out") as file:
                file.write(parameter_text(found, params).encode())
        verification = None
        if arm is not None and request.verify:
            verification = verify_calibration(
                arm, params, request.verify, request.seed, part_of(progress, measured, 1.0)
            )
    except BadParams as error:
        raise BadRequest(str(error)) from error
    return CalibrateReport(request, found, params, verification)


def _check_request(request: CalibrateRequest) -> tuple[BuiltArm | None, Params | None]:
    """Check what can be checked before a motion; return the arm, and parameters over those of its drawing."""
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


def _take_campaign(request: CalibrateRequest, arm: BuiltArm | None, progress: Progress) -> Campaign:
    """Read the measured poses, or measure the arm in simulation."""
    if arm is None:
        assert request.data is not None  # the request was checked
        return read_campaign(request.data)
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
