"""Closure of a case on held-out motion, computed the same way for diagnosis, baselines and truth."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.kinematics.transforms import Array
from ground.common.errors import BadRequest
from ground.diagnosis.closure import Closure, HeldOutModel, build_held_out_model, compute_closure
from ground.diagnosis.normal_equations import NormalEquations, form_normal_equations
from ground.diagnosis.problem import Hypothesis, Ints
from ground.diagnosis.sensitivity import Sensitivities


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


def split_case(sensitivities: CampaignSensitivities, case: CaseFeatures) -> tuple[CasePart, CasePart]:
    """Return the fitted and the held-out part of a case."""
    fitted = CasePart(sensitivities.fitted.select(case.fitted.rows), case.fitted.value)
    return fitted, CasePart(sensitivities.held.select(case.held.rows), case.held.value)


def read_case_features(path: Path) -> CaseFeatures:
    """Read residuals from a file; BadRequest if they cannot be read."""
    try:
        document = json.loads(path.read_bytes())
        fitted, held = (
            CaseResiduals(np.array(document[name]["rows"], np.intp), np.array(document[name]["value"], float))
            for name in ("fitted", "held")
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        solved = path.name.replace(".features", "")
        raise BadRequest(f"{path}: holds no features ({error}); remove {solved} and solve again") from error
    return CaseFeatures(fitted, held)


FeatureChange = Callable[[Sensitivities], Array]
"""Function that returns the change of the features, shape (m,), by assumed effects."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutTrial:
    """Case ready for tests of assumed effects on held-out motion."""

    fitted: CasePart
    held: CasePart
    equations: NormalEquations
    """Normal equations of the fitted part."""
    held_out_model: HeldOutModel

    def left(self, change: FeatureChange) -> tuple[Array, Array]:
        """Return residuals under assumed effects: of the fitted part whitened, of the held-out part raw.

        The nuisances are refitted beside the assumed effects.
        """
        equations = self.equations
        rest = equations.whiten(self.fitted.value - change(self.fitted.sensitivities))
        N = equations.A[:, : equations.q]
        v = equations.C[-1] @ (N.T @ rest)
        return rest - N @ v, self.held.value - change(
            self.held.sensitivities
        ) - self.held_out_model.nuisance @ v

    def closed(self, change: FeatureChange, seed: int) -> Closure:
        """Return the closure on held-out motion, relative to nuisances alone."""
        return compute_closure(self.held_out_model, self.left(no_change)[1], self.left(change)[1], seed)


def no_change(found: Sensitivities) -> Array:
    """Return no change, shape (m,)."""
    return np.zeros(found.layout.size)


def prepare_trial(fitted: CasePart, held: CasePart) -> HeldOutTrial:
    """Prepare a case for tests; ValueError if a motion is in both parts."""
    equations = form_normal_equations(fitted.sensitivities)
    return HeldOutTrial(fitted, held, equations, build_held_out_model(equations, held.sensitivities))


def closure_of_truth(case: HeldOutTrial, true: dict[Hypothesis, Array], seed: int) -> Closure:
    """Return the closure of the true effects with their true sizes, by the parabolas of the sensitivities."""
    return case.closed(lambda found: found.change(true), seed)
