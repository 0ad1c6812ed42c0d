"""Diagnosis of a serial arm by poses that a tracker measured: joints, effects, sizes, and what remains.

Links are base parameters, since no drawing has them to a tenth of a millimetre. All effects of all joints are
fitted together, so an effect is named only for what no other one explains.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from simgap.common.errors import RobotError
from simgap.common.progress import Progress, no_progress
from simgap.effects.effect import Family
from simgap.result import MIN_REMAINDER, Base, Diagnosis, Finding, JointError, Refusal, Rejected, Remainder
from simgap.serial_arm import effects as kinds
from simgap.serial_arm import nested_models
from simgap.serial_arm.calibrate import (
    LEAST_POSES,
    PoseErrors,
    SerialCalibration,
    estimate_setup,
    pose_errors,
)
from simgap.serial_arm.chain import PoseSeries
from simgap.serial_arm.fit import assess_identifiability
from simgap.serial_arm.model import GEOMETRY, TERMS, SerialArm

TARGET: Final = "target"
"""Place of an error of the whole arm."""
FAMILIES: Final = {
    kinds.PeriodicJointError: (Family.GEOMETRY, Family.TRANSMISSION),
    kinds.TrackerCompliance: (Family.TRANSMISSION,),
    kinds.DirectionHysteresis: (Family.TRANSMISSION, Family.FRICTION),
}
"""Families that poses at rest cannot tell apart, the likelier first."""
NEXT_MOTION: Final = {
    kinds.PeriodicJointError: "the same poses with another payload, which changes an error of the gear only",
    kinds.TrackerCompliance: "",
    kinds.DirectionHysteresis: "the same poses from both sides, with a payload, which changes friction only",
}
"""Motion that would separate these families."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackerFit:
    """Models of an arm, fitted to the earlier poses of a series and judged by the later ones."""

    models: tuple[nested_models.NestedModel, ...]
    """The first one has base and target alone, each other one a term more."""
    fresh: PoseSeries
    """Poses that only judge."""
    temperature: nested_models.TemperatureTest | None
    """None if the air temperature is unknown."""

    @property
    def found(self) -> SerialCalibration:
        """Return the calibration with all terms."""
        return self.models[-1].found


def fit_tracker(
    arm: SerialArm,
    series: PoseSeries,
    *,
    terms: Sequence[str] = TERMS,
    fit_share: float = 0.5,
    progress: Progress = no_progress,
) -> TrackerFit:
    """Fit an arm to the earliest poses of a series, term by term.

    Args:
        arm: Arm of the file; sizes are differences from it.
        terms: Terms to fit, of TERMS and in their order; none fits base and target alone.
        fit_share: Share of the poses that are fitted.

    Raises:
        RobotError: There are too few poses, or they do not determine base and target.
    """
    count = round(fit_share * series.count)
    if min(count, series.count - count) < LEAST_POSES:
        raise RobotError(
            f"{series.name}: {count} poses to fit and {series.count - count} to judge are too few; give "
            f"{LEAST_POSES} or more of each"
        )
    is_part = np.arange(series.count) < count
    part, fresh = series.at(is_part), series.at(~is_part)
    steps = [tuple(terms[:k]) for k in range(len(terms) + 1)]
    models = nested_models.fit_nested_models(arm, estimate_setup(arm, part), part, fresh, steps, progress)
    progress(len(steps), len(steps) + 1, "testing each effect of each joint")
    return TrackerFit(models, fresh, nested_models.temperature_test(models[-1].found, models[-1].validation))


def diagnose_tracker(arm: SerialArm, series: PoseSeries) -> Diagnosis:
    """Find the effects in the joints of an arm; the later half of the poses judges; RobotError if too few."""
    return describe_tracker(fit_tracker(arm, series))


def describe_tracker(fitted: TrackerFit) -> Diagnosis:
    """Test the effects of all joints whose terms were fitted; `patch_arm` adds those that are named."""
    models, fresh, found = fitted.models, fitted.fresh, fitted.found
    arm, part = found.model.arm, found.model.series
    elimination = kinds.Elimination(found.fit)
    tests = kinds.judge_effects(models, elimination, kinds.list_effects(found))
    named = [test for test in tests if not test.problem]
    unnamed = [test.effect for test in tests if test.problem]
    chosen = elimination.without(kinds.flag_parameters(found.fit, unnamed))
    explained = pose_errors(*found.model.at(chosen.values), fresh)
    findings = []
    for test in named:
        without = elimination.without(kinds.flag_parameters(found.fit, [*unnamed, test.effect]))
        before = _in_noise(arm, pose_errors(*found.model.at(without.values), fresh))
        findings.append(_finding(found, test, chosen, 1.0 - _in_noise(arm, explained) / before))
    links = arm.links if GEOMETRY in found.model.terms else ()
    effects: list[kinds.TrackerEffect] = [kinds.LinkGeometry(one.name) for one in links]
    effects += [test.effect for test in named]
    return Diagnosis(
        robot=arm.name,
        kind="tracker",
        seed=0,
        is_base_only=len(models) == 1,
        findings=tuple(sorted(findings, key=lambda one: -one.share)),
        base=_base(found, chosen) if links else (),
        errors=_errors(models, explained),
        remaining=_remainders(models[-1], fitted.temperature, explained),
        refused=_refused(found),
        fitted_motions=(f"{part.name}: the first {part.count} poses",),
        judged_motions=(f"{part.name}: the last {fresh.count} poses",),
        effects=tuple(effects),
        sizes=tuple(
            tuple(chosen.values[kinds.flag_parameters(found.fit, [one])].tolist()) for one in effects
        ),
        rejected=(
            *(Rejected(one.effect.place, one.effect.name, one.problem) for one in tests if one.problem),
            *_rejected_temperature(fitted.temperature),
        ),
    )


def _in_noise(arm: SerialArm, errors: PoseErrors) -> float:
    """Compute the error of a pose in units of the repeatability."""
    noise = arm.repeatability
    return float(np.hypot(errors.rms_m / noise.position_m, errors.rms_rad / noise.rotation_rad))


def _finding(
    found: SerialCalibration, test: kinds.EffectTest, chosen: kinds.Eliminated, share: float
) -> Finding:
    effect = test.effect
    size, _, _ = kinds.effect_size(found, effect, chosen)
    is_periodic = isinstance(effect, kinds.PeriodicJointError)
    families = FAMILIES[type(effect)]
    return Finding(
        place=effect.place,
        family=effect.family,
        effect=effect.name,
        size=(size,),
        size_names=("rms_rad" if is_periodic else kinds.with_unit(effect.numbers[0]),),
        interval=((size - test.half_width, size + test.half_width),),
        text=_text(found, effect, chosen, size, test.half_width),
        share=share,
        places=(effect.place,),
        families=families,
        effects=(effect.key,),
        next_motion=NEXT_MOTION[type(effect)],
    )


def _text(
    found: SerialCalibration,
    effect: kinds.TrackerEffect,
    chosen: kinds.Eliminated,
    size: float,
    half_width: float,
) -> str:
    if isinstance(effect, kinds.TrackerCompliance):
        return f"{1e6 * size:.1f} +- {1e6 * half_width:.1f} urad/Nm"
    if isinstance(effect, kinds.DirectionHysteresis):
        text = f"{1e6 * size:.0f} +- {1e6 * half_width:.0f} urad"
        return f"{text} after a positive move, the opposite after a negative one"
    assert isinstance(effect, kinds.PeriodicJointError)
    values = chosen.values[kinds.flag_parameters(found.fit, [effect])]
    peak = float(np.max(np.abs(kinds.wave_features(found, effect) @ values)))
    text = f"{1e3 * size:.2f} +- {1e3 * half_width:.2f} mrad root mean square"
    return f"{text}, {1e3 * peak:.2f} mrad at most"


def _base(found: SerialCalibration, chosen: kinds.Eliminated) -> tuple[Base, ...]:
    """List the parameters of the links, and whether the poses determine them apart from base and target."""
    fit = found.fit
    groups = assess_identifiability(fit.parameters, fit.at, fit.used).unidentifiable_groups()
    confounded = {name for group in groups for name in group.names}
    sigma = np.sqrt(np.diag(kinds.widened_covariance(fit)))
    half_width = np.maximum(
        norm.isf((1 - kinds.COVERAGE) / 2) * sigma,
        student.isf((1 - kinds.COVERAGE) / 2, kinds.BLOCKS - 1) * kinds.jackknife_sigma(chosen.by_block),
    )
    base = []
    for link in found.model.arm.links:
        geometry = kinds.LinkGeometry(link.name)
        for number, nominal in zip(geometry.numbers, link.geometry, strict=True):
            k = fit.index(f"{link.name}.{number}")
            value = nominal + float(chosen.values[k])
            interval = (value - float(half_width[k]), value + float(half_width[k]))
            is_identifiable = f"{link.name}.{number}" not in confounded
            base.append(Base(link.name, kinds.with_unit(number), nominal, value, interval, is_identifiable))
    return tuple(base)


def _errors(models: tuple[nested_models.NestedModel, ...], explained: PoseErrors) -> tuple[JointError, ...]:
    """Return the held-out errors of position and rotation: frames only, with links, and with the findings."""
    frames = models[0].fresh
    links = next((model.fresh for model in models if model.terms == (GEOMETRY,)), frames)
    position = (frames.rms_m, links.rms_m, explained.rms_m)
    rotation = (frames.rms_rad, links.rms_rad, explained.rms_rad)
    return (
        JointError(f"{TARGET} position", "m", *position, math.nan),
        JointError(f"{TARGET} rotation", "rad", *rotation, math.nan),
    )


def _remainders(
    last: nested_models.NestedModel, temperature: nested_models.TemperatureTest | None, explained: PoseErrors
) -> tuple[Remainder, ...]:
    """Describe the error that is left if it exceeds the repeatability, or follows temperature or time."""
    found = last.found
    curve = np.linspace(-1.0, 1.0, int(np.count_nonzero(found.fit.used)))
    gain_m, sigma_m, share = nested_models.drift_gain(found, last.validation, curve)
    depends_on = "time" if gain_m > 2.0 * sigma_m else ""
    if temperature is not None and temperature.explains:
        depends_on, share = "temperature", 1.0 - (temperature.with_m / temperature.without_m) ** 2
    mean_m = float(np.mean(explained.position_m))
    floor_m = math.sqrt(3.0) * found.model.arm.repeatability.position_m
    if not depends_on and explained.rms_m <= MIN_REMAINDER * floor_m:
        return ()
    return (Remainder(TARGET, "at rest", mean_m, "m", depends_on, share if depends_on else 0.0),)


def _refused(found: SerialCalibration) -> tuple[Refusal, ...]:
    rows = found.outliers
    if not rows:
        return ()
    reason = f"rows {', '.join(map(str, rows))} contradict the other poses"
    return (Refusal(found.model.series.name, reason, len(rows)),)


def _rejected_temperature(test: nested_models.TemperatureTest | None) -> tuple[Rejected, ...]:
    if test is None or test.explains:
        return ()
    reason = (
        f"it varies by {test.range_K:.2f} K; with it, the error of left-out blocks falls by "
        f"{1e6 * test.gain_m:.1f} +- {1e6 * test.gain_sigma_m:.1f} um, with a curve that is not the "
        f"temperature ({test.placebo}) by {1e6 * test.placebo_gain_m:.1f} um"
    )
    return (Rejected(TARGET, "air temperature", reason),)
