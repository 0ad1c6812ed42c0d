"""What each effect explains: arms with more and more of them, each fitted, cross-validated and judged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ground.calibration.serial.arm import SerialArm
from ground.calibration.serial.calibrate import Calibrated, Verdict, calibrate, calibrate_to, verdict
from ground.calibration.serial.held_out import CrossValidation, HeldOut, gain_m
from ground.calibration.serial.model import Setup
from ground.calibration.serial.series import Series
from ground.common.progress import Progress


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """An arm with the terms up to here."""

    terms: tuple[str, ...]
    found: Calibrated
    validation: CrossValidation
    held_out: HeldOut
    """Within the poses of the fit."""
    gain_m: float
    """By how much the error in cross-validation fell from the step before, mean over the blocks of time."""
    gain_sigma_m: float
    fitted: Verdict
    fresh: Verdict | None
    """Poses that took no part; None if there are none."""

    @property
    def is_worth_it(self) -> bool:
        """Whether the error fell by more than a standard error."""
        return self.gain_m > self.gain_sigma_m


def ladder(
    arm: SerialArm,
    setup: Setup,
    part: Series,
    fresh: Series | None,
    steps: Sequence[tuple[str, ...]],
    progress: Progress,
) -> tuple[Step, ...]:
    """Fit each of these sets of terms to one part of a series, judge it by the other.

    Poses that the last and largest does not agree with are left out of all.

    Raises:
        NoAgreement: too many poses do not agree with the rest.
    """
    progress(0, len(steps), "fitting")
    whole = calibrate(arm, setup, part, steps[-1])
    done: list[Step] = []
    for terms in steps:
        progress(len(done) + 1, len(steps) + 1, "judging")
        is_whole = terms == steps[-1]
        found = whole if is_whole else calibrate_to(arm, setup, part, terms, whole.fit.used)
        validation = CrossValidation(found.fit, arm.repeats.position_m)
        held_out = validation.held_out()
        gain = gain_m(done[-1].held_out, held_out) if done else (np.inf, 0.0)
        made, stands = found.arm, found.setup
        judged = None if fresh is None else verdict(made, stands, fresh)
        done.append(Step(terms, found, validation, held_out, *gain, verdict(made, stands, part), judged))
    return tuple(done)
