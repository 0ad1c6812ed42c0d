"""Features of a case, and the closure of its true effects on held-out motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field, FiniteFloat, TypeAdapter

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.closure import Closure, build_held_out_model, compute_closure
from marsarm.diagnosis.normal_equations import form_normal_equations
from marsarm.diagnosis.problem import Hypothesis, Ints
from marsarm.diagnosis.sensitivity import Sensitivities
from simgap.common.errors import BadRequest
from simgap.common.toml import read_json


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
NO_FEATURES: Final = "holds no features"


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
