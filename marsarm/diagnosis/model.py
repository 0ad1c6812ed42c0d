"""Diagnosis model: all that is fixed, and can be published, before a case is measured."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from marsarm.diagnosis.detectability import Detectability, detection_limits, equivalence_classes
from marsarm.diagnosis.normal_equations import NormalEquations, form_normal_equations
from marsarm.diagnosis.problem import Ints
from marsarm.diagnosis.residual_analysis import FeatureGroup, group_features, lack_of_fit_limit
from marsarm.diagnosis.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisModel:
    """Normal equations, equivalence classes and detection limits of a campaign."""

    sensitivities: Sensitivities
    families: tuple[StrEnum, ...]
    """Family of every hypothesis."""
    locations: tuple[str, ...]
    """Location of every hypothesis: its place without axis or direction."""
    equations: NormalEquations
    label: Ints
    """Equivalence class of every hypothesis, shape (h,)."""
    limits: tuple[Detectability, ...]
    groups: tuple[FeatureGroup, ...]
    left_out_effect: str = ""
    """Effect that does not compete, to see what takes the place of one that no catalogue has; "" for none."""

    @property
    def lack_of_fit_limit(self) -> float:
        """The -log10 p from which on remaining structure counts."""
        return lack_of_fit_limit(self.groups)

    @property
    def left_out(self) -> frozenset[int]:
        """Hypotheses of the left-out effect at all places, and those that these motions show alike."""
        named = zip(self.label, self.sensitivities.hypotheses, strict=True)
        gone = {int(k) for k, one in named if one.effect == self.left_out_effect}
        return frozenset(k for k, label in enumerate(self.label) if int(label) in gone)

    def equivalence_class(self, hypothesis: int) -> tuple[int, ...]:
        """Return the hypotheses of the same equivalence class, itself included."""
        return tuple(int(one) for one in (self.label == self.label[hypothesis]).nonzero()[0])


def build_model(
    sensitivities: Sensitivities, families: Sequence[StrEnum], locations: Sequence[str]
) -> DiagnosisModel:
    """Build the diagnosis model from the sensitivities of a campaign.

    Args:
        sensitivities: Sensitivities of the campaign.
        families: StrEnum of each of its hypotheses.
        locations: Location of each.
    """
    equations = form_normal_equations(sensitivities)
    label = equivalence_classes(equations)
    return DiagnosisModel(
        sensitivities,
        tuple(families),
        tuple(locations),
        equations,
        label,
        detection_limits(equations, label),
        group_features(equations),
    )
