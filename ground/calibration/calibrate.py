"""From a campaign to the arm's numbers, with every doubt about them said."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array, Flags, Integers
from ground.calibration.arm_model import arm_model
from ground.calibration.arm_parameters import FRAME_SCREWS, arm_parameters
from ground.calibration.campaign_data import Campaign
from ground.calibration.fit import Fit, HoldOutValidation, Linearisation, fit, validate_hold_out
from ground.calibration.identifiability import Identifiability, assess_identifiability
from ground.calibration.outliers import OutlierRejection, reject_outliers

HOLD_OUT_STRIDE: Final = 5
"""Every fifth pose of a group is in no equation of the fit that it judges.

But what is an outlier, and which unsure gaps are as believed, was found with it.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was found."""

    nominal: Params
    campaign: Campaign
    rejection: OutlierRejection
    """The fit to all poses, without outliers."""
    hold_out: HoldOutValidation
    """The fit to four fifths of them, by the last fifth."""
    held_out_poses: Flags
    """Which these are, (n,)."""
    held_out_error: Array
    """Their error screws, (6, k)."""
    identifiability: Identifiability
    frame_identifiability: Identifiability
    """Of the frames' numbers alone: what the paper counts."""
    preliminary: Fit
    """What unsure gaps were judged by."""
    unknown: Flags
    """Outputs of which nobody knows where in their gaps they lie, (5, n)."""
    before: Array
    """Error screws of all poses by the nominal numbers, in axes of the modelled frame, (6, n)."""
    after: Array
    """By the calibrated ones."""

    @property
    def best(self) -> Fit:
        """The fit."""
        return self.rejection.fit


def calibrate(nominal: Params, campaign: Campaign, with_backlash: bool = True) -> Calibration:
    """Fit, leave out outliers, judge by held-out poses; check_fit says whether it is to be believed.

    Raises:
        NoAgreement: no arm explains the poses.
    """
    parameters = arm_parameters()
    everything = np.ones(campaign.count, bool)
    near = _preliminary_fit(nominal, campaign, everything, with_backlash)
    model = arm_model(nominal, campaign, near, with_backlash)
    cleaned = reject_outliers(parameters, model, near.values)
    fresh = select_held_out(campaign.group)
    near_part = _preliminary_fit(nominal, campaign, ~fresh, with_backlash)
    part_model = arm_model(nominal, campaign, near_part, with_backlash, fresh)
    part = reject_outliers(parameters, part_model, near_part.values, ~fresh).fit
    judges = fresh & cleaned.fit.used
    at = cleaned.fit.at
    frames = Linearisation(at.residual, at.jacobian[:, :, FRAME_SCREWS])
    return Calibration(
        nominal=nominal,
        campaign=campaign,
        rejection=cleaned,
        hold_out=validate_hold_out(part, part.at.at(judges)),
        held_out_poses=judges,
        held_out_error=part_model.errors(part.values)[:, judges],
        identifiability=assess_identifiability(parameters, at, cleaned.fit.used),
        frame_identifiability=assess_identifiability(parameters[FRAME_SCREWS], frames, cleaned.fit.used),
        preliminary=near,
        unknown=model.unknown,
        before=model.errors(np.zeros(len(parameters))),
        after=model.errors(cleaned.fit.values),
    )


def _preliminary_fit(nominal: Params, campaign: Campaign, used: Flags, with_backlash: bool) -> Fit:
    """A fit to the poses used that unsure gaps can be judged by; of the others none is looked at."""
    parameters = arm_parameters()
    near = fit(parameters, arm_model(nominal, campaign, None, with_backlash), None, used)
    # once more: when widths of gaps are known, what agrees is seen more sharply
    return fit(parameters, arm_model(nominal, campaign, near, with_backlash, ~used), near.values, used)


def select_held_out(group: Integers) -> Flags:
    """Every fifth pose of each group, (n,)."""
    held = np.zeros(group.size, bool)
    for name in np.unique(group):
        held[np.flatnonzero(group == name)[HOLD_OUT_STRIDE // 2 :: HOLD_OUT_STRIDE]] = True
    return held


def rms_m(error: Array) -> float:
    """Root mean square position error of screws (6, n)."""
    return float(np.sqrt(np.mean(np.sum(error[3:] ** 2, axis=0))))
