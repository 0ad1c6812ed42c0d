"""Diagnosis model: all that is fixed, and can be published, before a case is measured."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.detectability import Detectability, alias_cosines, detection_limits, equivalence_classes
from ground.diagnosis.normal_equations import NormalEquations, form_normal_equations
from ground.diagnosis.problem import Ints
from ground.diagnosis.residual_analysis import FeatureGroup, group_features
from ground.diagnosis.selection import CandidateSet
from ground.diagnosis.sensitivity import Sensitivities
from ground.diagnosis.thresholds import SIMULATED_CASES, Thresholds, calibrate_thresholds


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisModel:
    """Normal equations, equivalence classes, detection limits and thresholds of a campaign."""

    sensitivities: Sensitivities
    equations: NormalEquations
    cosine: Array
    """Absolute cosine between the sensitivities of every two hypotheses, shape (h, h)."""
    label: Ints
    """Equivalence class of every hypothesis, shape (h,)."""
    limits: tuple[Detectability, ...]
    groups: tuple[FeatureGroup, ...]
    thresholds: Thresholds

    @property
    def candidates(self) -> CandidateSet:
        """Candidate set of all identifiable hypotheses."""
        return CandidateSet(self.equations, self.label, self.thresholds.effect, self.equations.identifiable)

    def equivalence_class(self, hypothesis: int) -> tuple[int, ...]:
        """Return the hypotheses of the same equivalence class, itself included."""
        return tuple(int(one) for one in np.flatnonzero(self.label == self.label[hypothesis]))


def build_model(
    sensitivities: Sensitivities,
    seed: int,
    cases: int = SIMULATED_CASES,
    thresholds: Thresholds | None = None,
    step: Callable[[int, int], None] = lambda *_: None,
) -> DiagnosisModel:
    """Build the diagnosis model from the sensitivities of a campaign.

    Args:
        sensitivities: Sensitivities of the campaign.
        seed: Seed of the simulated cases.
        cases: Number of simulated cases of each kind.
        thresholds: Thresholds that are known already; None to calibrate them with simulated cases.
        step: Called with the number of cases done and the total.
    """
    equations = form_normal_equations(sensitivities)
    cosine, label, limits, groups = (
        alias_cosines(equations),
        equivalence_classes(equations),
        detection_limits(equations),
        group_features(equations),
    )
    kept = thresholds or calibrate_thresholds(equations, label, cosine, limits, groups, seed, cases, step)
    return DiagnosisModel(sensitivities, equations, cosine, label, limits, groups, kept)
