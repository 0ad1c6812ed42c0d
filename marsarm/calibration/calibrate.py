"""Calibration of the arm: fit, rejection of outliers, hold-out validation and identifiability.

Numbers of poses have shape (n,), error screws of poses (6, n) [rad, m], rotation first.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Final

import numpy as np

from fsw.dictionary.params import Params, digest
from fsw.kinematics.arm import pose_to_transform6
from fsw.kinematics.transforms import Array, Flags, Integers, Pose
from marsarm.calibration.arm_parameters import FRAME_SCREWS, arm_parameters, move_zeros_to_hardstops
from marsarm.calibration.campaign_data import Campaign
from marsarm.calibration.residual_model import residual_model
from sim.arm_model.description import BuiltTolerances
from sim.arms import own_name
from sim.params import params_toml
from simgap import (
    Fit,
    FitParameter,
    HoldOutValidation,
    Identifiability,
    Linearisation,
    assess_identifiability,
    fit,
    validate_hold_out,
)
from simgap.serial_arm.fit import fit_without_outliers

HOLD_OUT_STRIDE: Final = 5
"""Stride of held-out poses in each group: every fifth pose is left out of the fit that it validates.

Held-out poses do take part in the search for outliers.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Result of a calibration."""

    nominal: Params
    campaign: Campaign
    best: Fit
    """Fit to all poses except outliers."""
    hold_out: HoldOutValidation
    """Validation on the held-out poses of a fit to the others."""
    held_out_poses: Flags
    """Flags of the held-out poses, shape (n,)."""
    held_out_error: Array
    """Error screws of the held-out poses, shape (6, k)."""
    identifiability: Identifiability
    frame_identifiability: Identifiability
    """Identifiability of the frame parameters alone, as in the paper."""
    preliminary: Fit
    """Fit that decided on which side of the backlash uncertain outputs lie."""
    unknown: Flags
    """Outputs whose side of the backlash is unknown, shape (5, n)."""
    before: Array
    """Error screws of all poses with nominal parameters, in axes of the modelled frame, (6, n)."""
    after: Array
    """Error screws with calibrated parameters, shape (6, n)."""

    @property
    def outliers(self) -> tuple[int, ...]:
        """Return the indices of the poses that were left out."""
        return tuple(np.flatnonzero(~self.best.used).tolist())


def calibrate(
    nominal: Params, campaign: Campaign, with_backlash: bool = True, built: BuiltTolerances | None = None
) -> Calibration:
    """Fit the arm to a campaign, reject outliers, and validate the fit on held-out poses.

    `checks.check_fit` decides whether the result is acceptable. Without tolerances, they are those of the
    default arm. RobotError says that no arm explains the poses.
    """
    parameters = arm_parameters(built)
    everything = np.ones(campaign.count, bool)
    preliminary = _preliminary_fit(parameters, nominal, campaign, everything, with_backlash)
    model = residual_model(nominal, campaign, preliminary, with_backlash)
    best = fit_without_outliers(parameters, model, preliminary.values)
    is_held_out = select_held_out(campaign.group)
    preliminary_part = _preliminary_fit(parameters, nominal, campaign, ~is_held_out, with_backlash)
    part_model = residual_model(nominal, campaign, preliminary_part, with_backlash, is_held_out)
    part = fit_without_outliers(parameters, part_model, preliminary_part.values, ~is_held_out)
    held_out = is_held_out & best.used
    at = best.at
    frames = Linearisation(at.residual, at.jacobian[:, :, FRAME_SCREWS])
    return Calibration(
        nominal=nominal,
        campaign=campaign,
        best=best,
        hold_out=validate_hold_out(part, part.at.at(held_out)),
        held_out_poses=held_out,
        held_out_error=part_model.errors(part.values)[:, held_out],
        identifiability=assess_identifiability(parameters, at, best.used),
        frame_identifiability=assess_identifiability(parameters[FRAME_SCREWS], frames, best.used),
        preliminary=preliminary,
        unknown=model.unknown,
        before=model.errors(np.zeros(len(parameters))),
        after=model.errors(best.values),
    )


def _preliminary_fit(
    parameters: Sequence[FitParameter], nominal: Params, campaign: Campaign, used: Flags, with_backlash: bool
) -> Fit:
    """Fit the used poses to decide the side of uncertain outputs, without the measurements of other poses."""
    preliminary = fit(parameters, residual_model(nominal, campaign, None, with_backlash), None, used)
    # fit again: with known backlash widths, more outputs can be confirmed
    return fit(
        parameters,
        residual_model(nominal, campaign, preliminary, with_backlash, ~used),
        preliminary.values,
        used,
    )


def select_held_out(group: Integers) -> Flags:
    """Select every fifth pose of each group; groups and flags have shape (n,)."""
    held = np.zeros(group.size, bool)
    for name in np.unique(group):
        held[np.flatnonzero(group == name)[HOLD_OUT_STRIDE // 2 :: HOLD_OUT_STRIDE]] = True
    return held


def rms_m(error: Array) -> float:
    """Compute the root mean square [m] of the position errors of screws [rad, m], (6, n)."""
    return float(np.sqrt(np.mean(np.sum(error[3:] ** 2, axis=0))))


def calibrated_params(found: Calibration, tools: dict[str, Pose] | None = None) -> Params:
    """Build parameters of the calibrated arm, zeros in its hardstops, with poses X_FT of registered tools."""
    _, params = move_zeros_to_hardstops(found.nominal, found.best.values)
    registered = {name: pose_to_transform6(X_FT) for name, X_FT in (tools or {}).items()}
    changed = tuple(
        replace(tool, transform=registered.get(tool.name, tool.transform)) for tool in params.tools
    )
    return replace(params, tools=changed, arm_name=own_name(found.campaign.arm_name))


def data_sha256(campaign: Campaign) -> str:
    """Compute a digest of all measured data; it does not depend on the file format."""
    b, m = campaign.believed, campaign.measured
    # a table stores quaternions and half of each covariance, so the last digits of the rest may change
    R = np.round(m.X_RT.R, 8) + 0.0
    upper = m.covariance[:, *np.triu_indices(6)]
    written = BytesIO()
    for values in (b.motor_rad, b.backlash_rad, b.friction_Nm, b.side, b.gravity_R_m_s2, b.turret_kg):
        np.save(written, np.ascontiguousarray(values))
    for values in (R, m.X_RT.p, upper):
        np.save(written, np.ascontiguousarray(values))
    return hashlib.sha256(campaign.arm_name.encode() + written.getvalue()).hexdigest()


def provenance(found: Calibration) -> tuple[str, ...]:
    """Describe the origin of the parameters, one sentence a line; no date, so that files are reproducible."""
    campaign, best = found.campaign, found.best
    left_out = ", ".join(map(str, found.outliers)) or "none"
    groups, held = np.unique(campaign.group).size, found.held_out_error
    return (
        f"Flight parameters of {campaign.arm_name}, calibrated; those that are not here are nominal.",
        f"Over nominal parameters of digest {digest(found.nominal)}.",
        f"Data of digest {data_sha256(campaign)}:",
        f"{campaign.count} poses in {groups} groups; left out as outliers: {left_out}.",
        f"Position error, root mean square: {1e3 * rms_m(found.before):.3f} mm before, "
        f"{1e3 * rms_m(found.after[:, best.used]):.3f} mm after,",
        f"{1e3 * rms_m(held):.3f} mm on {held.shape[1]} held-out poses.",
        f"Residuals {best.sigma0:.3f} of the noise, p = {best.p_value:.3f}; "
        f"held out {found.hold_out.ratio:.3f} of what is expected.",
        (
            f"Rank {found.frame_identifiability.rank} of 42 frame numbers, {found.identifiability.rank} of "
            f"{best.values.size} in all."
        ),
        "Encoder zeros are in the hardstop angles: find every hardstop anew with this file loaded.",
    )


def parameter_text(found: Calibration, params: Params) -> str:
    """Format all parameters that differ from the nominal ones as TOML."""
    return params_toml(found.nominal, params, provenance(found))
