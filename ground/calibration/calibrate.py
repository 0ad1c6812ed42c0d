"""From a campaign to the arm's numbers, with every doubt about them said."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.params import Params
from fsw.kinematics.transforms import Array, Flags
from ground.calibration.arm_model import ArmModel, arm_model, modelled
from ground.calibration.arm_numbers import FRAMES, arm_parameters
from ground.calibration.data import Campaign
from ground.calibration.fit import Fit
from ground.calibration.judge import Judged, judged
from ground.calibration.outliers import Cleaned, cleaned_fit
from ground.calibration.problem import Linearised
from ground.calibration.screws import error_screw
from ground.calibration.seen import Seen, seen

HELD_OUT: Final = 5
"""Every fifth pose of a group takes no part in the first fit and judges it."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was found."""

    nominal: Params
    campaign: Campaign
    cleaned: Cleaned
    """The fit to all poses, without outliers."""
    judged: Judged
    """The fit to four fifths of them, by the last fifth."""
    judged_poses: Flags
    """Which these are, (n,)."""
    held_out_error: Array
    """Their error screws, (6, k)."""
    seen: Seen
    frames_seen: Seen
    """Of the frames' numbers alone: what the paper counts."""
    before: Array
    """Error screws of all poses by the nominal numbers, in axes of the modelled frame, (6, n)."""
    after: Array
    """By the calibrated ones."""

    @property
    def fit(self) -> Fit:
        """The fit."""
        return self.cleaned.fit


def calibrate(nominal: Params, campaign: Campaign, with_backlash: bool = True) -> Calibration:
    """Fit, leave out outliers, judge by held-out poses; check_fit says whether it is to be believed.

    Raises:
        NoAgreement: no arm explains the poses.
    """
    parameters, model = arm_parameters(), arm_model(nominal, campaign, with_backlash)
    cleaned = cleaned_fit(parameters, model)
    fresh = held_out(campaign.group)
    part = cleaned_fit(parameters, model, cleaned.fit.values, cleaned.fit.used & ~fresh).fit
    judges = fresh & cleaned.fit.used
    verdict = judged(part, _at(part.at, judges))
    at = cleaned.fit.at
    frames = Linearised(at.residual, at.jacobian[:, :, FRAMES])
    found = Calibration(
        nominal=nominal,
        campaign=campaign,
        cleaned=cleaned,
        judged=verdict,
        judged_poses=judges,
        held_out_error=_errors(model, part.values)[:, judges],
        seen=seen(parameters, at, cleaned.fit.used),
        frames_seen=seen(parameters[FRAMES], frames, cleaned.fit.used),
        before=_errors(model, np.zeros(len(parameters))),
        after=_errors(model, cleaned.fit.values),
    )
    return found


def held_out(group: Sequence[int] | Array) -> Flags:
    """Every fifth pose of each group, (n,)."""
    of_group = np.asarray(group)
    held = np.zeros(of_group.size, bool)
    for name in np.unique(of_group):
        held[np.flatnonzero(of_group == name)[HELD_OUT // 2 :: HELD_OUT]] = True
    return held


def rms_m(error: Array) -> float:
    """Root mean square position error of screws (6, n)."""
    return float(np.sqrt(np.mean(np.sum(error[3:] ** 2, axis=0))))


def _errors(model: ArmModel, x: Array) -> Array:
    return error_screw(modelled(model.nominal, x, model.believed), model.measured)


def _at(at: Linearised, poses: Flags) -> Linearised:
    return Linearised(at.residual[poses], at.jacobian[poses])
