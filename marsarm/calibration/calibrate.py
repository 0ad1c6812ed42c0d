"""Calibration of the arm: fit, rejection of outliers, hold-out validation and identifiability."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array, Flags, Integers
from marsarm.calibration.arm_model import arm_model
from marsarm.calibration.arm_parameters import FRAME_SCREWS, arm_parameters
from marsarm.calibration.campaign_data import Campaign
from marsarm.calibration.outliers import OutlierRejection, reject_outliers
from sim.arm_model.description import BuiltTolerances
from simgap.serial_arm.fit import (
    Fit,
    FitParameter,
    HoldOutValidation,
    Identifiability,
    Linearisation,
    assess_identifiability,
    fit,
    validate_hold_out,
)

HOLD_OUT_STRIDE: Final = 5
"""Stride of held-out poses in each group: every fifth pose is left out of the fit that it validates.

Held-out poses do take part in the search for outliers.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Result of a calibration."""

    nominal: Params
    campaign: Campaign
    rejection: OutlierRejection
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
    def best(self) -> Fit:
        """Return the fit to all poses except outliers."""
        return self.rejection.fit


def calibrate(
    nominal: Params, campaign: Campaign, with_backlash: bool = True, built: BuiltTolerances | None = None
) -> Calibration:
    """Fit the arm to a campaign, reject outliers, and validate the fit on held-out poses.

    `checks.check_fit` decides whether the result is acceptable.

    Args:
        nominal: Nominal parameters of flight software.
        campaign: Measured poses.
        with_backlash: True if the model uses the state of the backlash.
        built: Tolerances of manufacture; None for those of the default arm.

    Returns:
        The calibration.

    Raises:
        TooManyOutliers: No arm explains the poses.
    """
    parameters = arm_parameters(built)
    everything = np.ones(campaign.count, bool)
    preliminary = _preliminary_fit(parameters, nominal, campaign, everything, with_backlash)
    model = arm_model(nominal, campaign, preliminary, with_backlash)
    cleaned = reject_outliers(parameters, model, preliminary.values)
    is_held_out = select_held_out(campaign.group)
    preliminary_part = _preliminary_fit(parameters, nominal, campaign, ~is_held_out, with_backlash)
    part_model = arm_model(nominal, campaign, preliminary_part, with_backlash, is_held_out)
    part = reject_outliers(parameters, part_model, preliminary_part.values, ~is_held_out).fit
    held_out = is_held_out & cleaned.fit.used
    at = cleaned.fit.at
    frames = Linearisation(at.residual, at.jacobian[:, :, FRAME_SCREWS])
    return Calibration(
        nominal=nominal,
        campaign=campaign,
        rejection=cleaned,
        hold_out=validate_hold_out(part, part.at.at(held_out)),
        held_out_poses=held_out,
        held_out_error=part_model.errors(part.values)[:, held_out],
        identifiability=assess_identifiability(parameters, at, cleaned.fit.used),
        frame_identifiability=assess_identifiability(parameters[FRAME_SCREWS], frames, cleaned.fit.used),
        preliminary=preliminary,
        unknown=model.unknown,
        before=model.errors(np.zeros(len(parameters))),
        after=model.errors(cleaned.fit.values),
    )


def _preliminary_fit(
    parameters: Sequence[FitParameter], nominal: Params, campaign: Campaign, used: Flags, with_backlash: bool
) -> Fit:
    """Fit the used poses to decide the side of uncertain outputs, without the measurements of other poses."""
    preliminary = fit(parameters, arm_model(nominal, campaign, None, with_backlash), None, used)
    # fit again: with known backlash widths, more outputs can be confirmed
    return fit(
        parameters, arm_model(nominal, campaign, preliminary, with_backlash, ~used), preliminary.values, used
    )


def select_held_out(group: Integers) -> Flags:
    """Select every fifth pose of each group.

    Args:
        group: Group index of each pose, shape (n,).

    Returns:
        Flags of the held-out poses, shape (n,).
    """
    held = np.zeros(group.size, bool)
    for name in np.unique(group):
        held[np.flatnonzero(group == name)[HOLD_OUT_STRIDE // 2 :: HOLD_OUT_STRIDE]] = True
    return held


def rms_m(error: Array) -> float:
    """Compute the root mean square of position errors.

    Args:
        error: Error screws, rotation [rad] first, then translation [m], shape (6, n).

    Returns:
        Root mean square error [m].
    """
    return float(np.sqrt(np.mean(np.sum(error[3:] ** 2, axis=0))))
