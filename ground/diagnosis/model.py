"""Diagnosis model: all that is fixed, and can be published, before a case is measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from diagnosis.effects.effect import Family
from fsw.kinematics.transforms import Array
from ground.diagnosis.detectability import Detectability, alias_cosines, detection_limits, equivalence_classes
from ground.diagnosis.normal_equations import NormalEquations, form_normal_equations
from ground.diagnosis.problem import Ints
from ground.diagnosis.residual_analysis import FeatureGroup, group_features, lack_of_fit_limit
from ground.diagnosis.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisModel:
    """Normal equations, equivalence classes and detection limits of a campaign."""

    sensitivities: Sensitivities
    families: tuple[Family, ...]
    """Family of every hypothesis."""
    locations: tuple[str, ...]
    """Location of every hypothesis: its place without axis or direction."""
    equations: NormalEquations
    cosine: Array
    """Absolute cosine between the sensitivities of every two hypotheses, shape (h, h)."""
    label: Ints
    """Equivalence class of every hypothesis, shape (h,)."""
    limits: tuple[Detectability, ...]
    groups: tuple[FeatureGroup, ...]
    left_out: frozenset[int] = frozenset()
    """Hypotheses that do not compete, to see what takes the place of an effect that no catalogue has."""

    @property
    def lack_of_fit_limit(self) -> float:
        """The -log10 p from which on remaining structure counts."""
        return lack_of_fit_limit(self.groups)

    def without(self, effect: str) -> "DiagnosisModel":
        """Return the model without an effect at all places, and without what these motions show alike.

        Args:
            effect: Name of the effect.
        """
        labels = {
            int(k)
            for k, one in zip(self.label, self.equations.hypotheses, strict=True)
            if one.effect == effect
        }
        gone = frozenset(k for k, label in enumerate(self.label) if int(label) in labels)
        return replace(self, left_out=gone)

    def equivalence_class(self, hypothesis: int) -> tuple[int, ...]:
        """Return the hypotheses of the same equivalence class, itself included."""
        return tuple(int(one) for one in (self.label == self.label[hypothesis]).nonzero()[0])


def build_model(
    sensitivities: Sensitivities, families: Sequence[Family], locations: Sequence[str]
) -> DiagnosisModel:
    """Build the diagnosis model from the sensitivities of a campaign.

    Args:
        sensitivities: Sensitivities of the campaign.
        families: Family of each of its hypotheses.
        locations: Location of each.
    """
    equations = form_normal_equations(sensitivities)
    return DiagnosisModel(
        sensitivities,
        tuple(families),
        tuple(locations),
        equations,
        alias_cosines(equations),
        equivalence_classes(equations),
        detection_limits(equations),
        group_features(equations),
    )
