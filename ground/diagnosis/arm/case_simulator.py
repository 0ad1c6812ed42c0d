"""The simulator of one case, in the features of the campaign whose sensitivities are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.arm.feature_set import FeatureSet, every_motion, measure_features
from ground.diagnosis.arm.features import CONDITIONS, MotionFeatures
from ground.diagnosis.arm.simulator import AffectedMotions, ArmSimulator
from ground.diagnosis.problem import EffectValues, FeatureLayout, Hypothesis, Ints, Nuisance
from sim.effects.effect import Effect

MOTION_CONDITIONS: Final = tuple(
    CONDITIONS.index(name) for name in ("speed_rad_s", "sin_angle", "cos_angle", "way")
)
MOTION_TOLERANCE: Final = 0.02
"""Of one motion in two logs: speeds [rad/s], sines and cosines of angles differ by less."""


@dataclass(frozen=True, slots=True, eq=False)
class CaseSimulator:
    """A case's simulator (ground.diagnosis.problem.Simulator) in m features of a campaign."""

    arm: ArmSimulator
    nominal: Array
    """What the simulator has for all features of the case under its own drive, (n,)."""
    at: Ints
    """Which of them each of the m features is."""
    rows: Ints
    """Which of the campaign's features they are, ascending, (m,)."""

    @property
    def layout(self) -> FeatureLayout:
        """The m features."""
        return self.arm.layout.select(self.at)

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The arm's."""
        return self.arm.hypotheses

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """The arm's."""
        return self.arm.nuisances

    def predict(self, settings: EffectValues, nuisance: Array) -> Array:
        """The features (m,); of repeats only the first is simulated."""
        effects = tuple(self.arm.effects(settings, nuisance))
        if not effects:
            return np.asarray(self.nominal[self.at])
        return np.asarray((self.nominal + simulate_change(self.arm, effects, self.nominal))[self.at])

    def residual(self) -> Array:
        """What was measured less what the simulator has, (m,)."""
        return np.asarray((measure_features(self.arm.feature_set) - self.nominal)[self.at])


def build_case_simulator(
    arm: ArmSimulator, layout: FeatureLayout, keys: Sequence[str], nominal: Array | None = None
) -> CaseSimulator:
    """To those features of a campaign, by their keys, that the case has too.

    One prediction is made, unless `nominal` has what the simulator had of the campaign, (M,). A feature that
    has the key but was of another motion (at another angle or speed) is none.
    """
    number = {key: k for k, key in enumerate(feature_keys(arm.feature_set))}
    rows = np.array([row for row, key in enumerate(keys) if key in number], np.intp)
    at = np.array([number[keys[row]] for row in rows], np.intp)
    here = _simulate_nominal(arm) if nominal is None else np.full(arm.layout.size, np.nan)
    if nominal is not None:
        here[at] = nominal[rows]
    apart = np.abs(arm.layout.condition[at] - layout.condition[rows])[:, list(MOTION_CONDITIONS)]
    same = np.all(apart < MOTION_TOLERANCE, axis=1) & _is_simulated(arm.feature_set)[at]
    return CaseSimulator(arm, here, at[same], rows[same])


def resimulate(
    case: CaseSimulator, patch: tuple[Effect, ...], only: Callable[[MotionFeatures], bool], otherwise: Array
) -> CaseSimulator:
    """The same with another patch: rests, and the moving recordings that are wanted, are computed anew.

    The others change by `otherwise` (m,).
    """
    arm, known = case.arm.with_patch(patch), first_recordings(case.arm.feature_set)
    there = arm.predict_effects((), lambda one: one.recording.name in known and only(one))
    anew, near = copy_repeats(arm.feature_set, known, there, np.nan), case.nominal.copy()
    near[case.at] += otherwise
    return replace(case, arm=arm, nominal=np.where(np.isfinite(anew), anew, near))


def simulate_change(
    arm: ArmSimulator,
    effects: tuple[Effect, ...],
    nominal: Array,
    only: Callable[[MotionFeatures], bool] = every_motion,
) -> Array:
    """By how much effects change all features of a case, (n,); 0 of motions that are not stepped.

    Of a block's repeats only the first is stepped, and only where the effects can show.
    """
    touched, known = AffectedMotions(effects), first_recordings(arm.feature_set)

    def wanted(one: MotionFeatures) -> bool:
        return one.recording.name in known and touched(one) and only(one)

    return copy_repeats(arm.feature_set, known, arm.predict_effects(effects, wanted) - nominal)


def _is_simulated(feature_set: FeatureSet) -> Flags:
    """Features that any simulation tells, (n,): of repeats those alone that their firsts have too."""
    known = first_recordings(feature_set)
    stepped = [np.full(len(one.features), one.recording.name in known) for one in feature_set.motions]
    rests = np.ones(sum(len(one.features) for one in feature_set.rests), bool)
    simulated = np.where(np.concatenate([*stepped, rests]), 1.0, np.nan)
    return np.isfinite(copy_repeats(feature_set, known, simulated, np.nan))


def _simulate_nominal(arm: ArmSimulator) -> Array:
    """Of the case under its own drive, (n,); NaN of repeats that have features their firsts have not."""
    known = first_recordings(arm.feature_set)
    return copy_repeats(
        arm.feature_set, known, arm.predict_effects((), lambda one: one.recording.name in known), np.nan
    )


def feature_keys(feature_set: FeatureSet) -> list[str]:
    """A name for each feature, the same in every recording of the session."""
    named = zip(feature_set.sessions, feature_set.features, strict=True)
    return [f"{session}/{feature.key}" for session, feature in named]


def first_recordings(feature_set: FeatureSet) -> set[str]:
    """The moving recordings that repeat none before them."""
    first: dict[str, str] = {}
    for one in feature_set.motions:
        first.setdefault(one.recording.block, one.recording.name)
    return set(first.values())


def copy_repeats(feature_set: FeatureSet, first: set[str], values: Array, otherwise: float = 0.0) -> Array:
    """What was not simulated: of repeats as in the first of their block."""
    known = {
        (feature.block, feature.key): value
        for session, feature, value in zip(feature_set.sessions, feature_set.features, values, strict=True)
        if session in first and np.isfinite(value)
    }
    named = zip(feature_set.features, values, strict=True)
    filled = [v if np.isfinite(v) else known.get((f.block, f.key), otherwise) for f, v in named]
    return np.array(filled)
