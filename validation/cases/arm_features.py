"""Files of the campaign and of solved cases of this arm: equivalence classes, and residuals of a case.

The classes, detection limits, families and locations of a campaign are published before its cases.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, FiniteFloat, TypeAdapter

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.closure import Closure, build_held_out_model, compute_closure
from marsarm.diagnosis.diagnose import Level, Verdict
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.normal_equations import form_normal_equations
from marsarm.diagnosis.problem import Hypothesis, Ints
from marsarm.diagnosis.result import finite_or_none
from marsarm.diagnosis.sensitivity import Sensitivities
from simgap.common.errors import BadRequest
from simgap.common.toml import read_json

CLASSES_FILE: Final = "classes.json"
NO_FEATURES: Final = "holds no features"


@dataclass(frozen=True, slots=True)
class _PlacedEffect:
    name: str
    place: str


@dataclass(frozen=True, slots=True)
class _Size:
    name: str
    is_amplitude: Literal[True]
    least: FiniteFloat
    most: FiniteFloat


@dataclass(frozen=True, slots=True)
class _Shape:
    is_amplitude: Literal[False]


@dataclass(frozen=True, slots=True)
class _Finding(_PlacedEffect):
    parameters: list[Annotated[_Size | _Shape, Field(discriminator="is_amplitude")]]
    level: Level
    places: list[str]
    families: list[str]
    effects: list[_PlacedEffect]


@dataclass(frozen=True, slots=True)
class _Closure:
    share: FiniteFloat | None


@dataclass(frozen=True, slots=True)
class ResultFile:
    """Part of a result that the score reads."""

    verdict: Verdict
    effects: list[_Finding]
    closure: _Closure | None
    seconds: FiniteFloat


@dataclass(frozen=True, slots=True)
class PublishedHypothesis:
    """Published facts of a hypothesis."""

    label: int
    """Equivalence class."""
    family_wise_share: float
    """Detection limit in the selection from all hypotheses, over that of a single test."""
    family: str
    location: str


_Limit = Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None


@dataclass(frozen=True, slots=True)
class _Entry:
    name: str
    place: str
    label: Annotated[int, Field(validation_alias="class")]
    limit: _Limit
    family_wise_limit: _Limit
    family: str
    location: str


_CLASSES_ADAPTER: Final = TypeAdapter(Annotated[list[_Entry], Field(min_length=1)])


@dataclass(frozen=True, slots=True)
class EquivalenceClasses:
    """Hypotheses of a campaign by effect and place, with the classes that it cannot distinguish."""

    known: Mapping[tuple[str, str], PublishedHypothesis]

    def of(self, effect: str, place: str) -> int | None:
        """Return the class of a hypothesis; None if the campaign does not have it."""
        found = self.known.get((effect, place))
        return None if found is None else found.label

    def locations(self, effect: str, place: str) -> frozenset[str]:
        """Return the locations of a hypothesis and of what is the same in this campaign."""
        return frozenset(one.location for one in self._alike(effect, place))

    def families(self, effect: str, place: str) -> frozenset[str]:
        """Return the families of a hypothesis and of what is the same in this campaign."""
        return frozenset(one.family for one in self._alike(effect, place))

    def family_wise_share(self, effect: str, place: str) -> float:
        """Return the limit in the selection over that of a single test; BadRequest if it is not known."""
        if (effect, place) not in self.known:
            raise BadRequest(
                f"{effect} at {place} is not in the catalogue of this campaign; score it with the marsarm "
                "that made it"
            )
        return self.known[effect, place].family_wise_share

    def _alike(self, effect: str, place: str) -> list[PublishedHypothesis]:
        label = self.of(effect, place)
        return [one for one in self.known.values() if label is not None and one.label == label]


def classes_json(model: DiagnosisModel) -> list[dict[str, Any]]:
    """Return the JSON document; an infinite limit is None."""
    rows = zip(
        model.sensitivities.hypotheses,
        model.label,
        model.limits,
        model.families,
        model.locations,
        strict=True,
    )
    return [
        {
            "name": one.effect,
            "place": one.place,
            "class": int(label),
            "limit": finite_or_none(limit.limit),
            "family_wise_limit": finite_or_none(limit.family_wise_limit),
            "family": str(family),
            "location": location,
        }
        for one, label, limit, family, location in rows
    ]


def load_classes(campaign: Path) -> EquivalenceClasses:
    """Load what is published; BadRequest if it cannot be read."""
    path = campaign / CLASSES_FILE
    document = read_json(path, _CLASSES_ADAPTER, "holds no classes", "make the campaign anew")
    return EquivalenceClasses({
        (one.name, one.place): PublishedHypothesis(
            one.label, one.family_wise_limit / one.limit, one.family, one.location
        )
        for one in document
        if one.limit is not None and one.family_wise_limit is not None
    })  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class CampaignSensitivities:
    """Sensitivities of a campaign's fitted and held-out motions."""

    fitted: Sensitivities
    held: Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class CaseResiduals:
    """Rows of the campaign's features that a case has, and their residuals, (n,) each."""

    rows: Ints
    value: Array


@dataclass(frozen=True, slots=True, eq=False)
class CaseFeatures:
    """Residuals of the fitted and of the held-out motions of a case."""

    fitted: CaseResiduals
    held: CaseResiduals

    def document(self) -> dict[str, Any]:
        """Return the JSON document; numbers are exact."""
        return {
            name: {"rows": one.rows.tolist(), "value": one.value.tolist()}
            for name, one in (("fitted", self.fitted), ("held", self.held))
        }


@dataclass(frozen=True, slots=True, eq=False)
class CasePart:
    """Sensitivities and residuals of some features."""

    sensitivities: Sensitivities
    value: Array


@dataclass(frozen=True, slots=True)
class _PartFile:
    rows: Annotated[list[Annotated[int, Field(ge=0, lt=2**31)]], Field(min_length=1)]
    value: list[FiniteFloat]


@dataclass(frozen=True, slots=True)
class _FeaturesFile:
    fitted: _PartFile
    held: _PartFile


_FEATURES_ADAPTER: Final = TypeAdapter(_FeaturesFile)


def read_case_parts(path: Path, sensitivities: CampaignSensitivities) -> tuple[CasePart, CasePart]:
    """Read the fitted and the held-out part of a case; BadRequest if the campaign has not its features."""
    case = read_case_features(path)
    parts = (sensitivities.fitted, case.fitted), (sensitivities.held, case.held)
    for campaign, residuals in parts:
        if residuals.rows[-1] >= campaign.layout.size:
            raise BadRequest(
                f"{path}: row {residuals.rows[-1]} is not among the {campaign.layout.size} features of the "
                f"campaign; {_solve_again(path)}"
            )
    fitted, held = (
        CasePart(campaign.select(residuals.rows), residuals.value) for campaign, residuals in parts
    )
    return fitted, held


def read_case_features(path: Path) -> CaseFeatures:
    """Read residuals from a file; BadRequest if they cannot be read."""
    file = read_json(path, _FEATURES_ADAPTER, NO_FEATURES, _solve_again(path))
    return CaseFeatures(_check_residuals(path, file.fitted), _check_residuals(path, file.held))


def _check_residuals(path: Path, part: _PartFile) -> CaseResiduals:
    """Return the residuals of a part; BadRequest if rows do not ascend, or have not a value each."""
    rows = np.array(part.rows, np.intp)
    if rows.size != len(part.value) or np.any(np.diff(rows) <= 0):
        raise BadRequest(
            f"{path}: {NO_FEATURES} ({rows.size} rows, which must ascend, have {len(part.value)} values); "
            f"{_solve_again(path)}"
        )
    return CaseResiduals(rows, np.array(part.value))


def _solve_again(path: Path) -> str:
    return f"remove {path.name.replace('.features', '')} and solve again"


def closure_of_truth(fitted: CasePart, held: CasePart, true: dict[Hypothesis, Array], seed: int) -> Closure:
    """Return the closure of the true effects with their true sizes, by the parabolas of the sensitivities.

    Args:
        fitted: Fitted part of a case; the nuisances are fitted to it beside the effects.
        held: Held-out part.
        true: Values of all parameters of the true effects, in their units, (p,) each.
        seed: Seed of the noise draws.

    Returns:
        The closure, relative to the same nuisances without effects.

    Raises:
        ValueError: A motion is in both parts.
    """
    equations = form_normal_equations(fitted.sensitivities)
    model, N = build_held_out_model(equations, held.sensitivities, equations.C), equations.A[:, : equations.q]
    rest = equations.whiten(fitted.value - fitted.sensitivities.change(true))
    before = held.value - model.nuisance @ (equations.C @ (N.T @ rest))
    return compute_closure(model, before, before - held.sensitivities.change(true), seed)
