"""A campaign ready for cases: everything that is fixed, and can be published, before data."""

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
    """What does not depend on data."""

    sensitivities: Sensitivities
    equations: NormalEquations
    cosine: Array
    """|cos| between hypotheses, (H, H)."""
    label: Ints
    """Equivalence class of every hypothesis, (H,)."""
    limits: tuple[Detectability, ...]
    groups: tuple[FeatureGroup, ...]
    thresholds: Thresholds

    @property
    def candidates(self) -> CandidateSet:
        """All hypotheses that are seen."""
        return CandidateSet(self.equations, self.label, self.thresholds.effect, self.equations.identifiable)

    def confusable(self, hypothesis: int) -> tuple[int, ...]:
        """Its class, itself included."""
        return tuple(int(one) for one in np.flatnonzero(self.label == self.label[hypothesis]))


def build_model(
    sensitivities: Sensitivities,
    seed: int,
    cases: int = SIMULATED_CASES,
    thresholds: Thresholds | None = None,
    step: Callable[[int, int], None] = lambda *_: None,
) -> DiagnosisModel:
    """Of a campaign's sensitivities; without thresholds they are calibrated with `cases` simulated cases."""
    equations = form_normal_equations(sensitivities)
    cosine, label, limits, groups = (
        alias_cosines(equations),
        equivalence_classes(equations),
        detection_limits(equations),
        group_features(equations),
    )
    kept = thresholds or calibrate_thresholds(equations, label, cosine, limits, groups, seed, cases, step)
    return DiagnosisModel(sensitivities, equations, cosine, label, limits, groups, kept)
