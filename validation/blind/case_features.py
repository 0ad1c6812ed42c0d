"""How far what is said of a case closes its gap on held-out motion: one sum for all who say anything."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.kinematics.transforms import Array
from ground.common.requests import BadRequest
from ground.diagnosis.closure import Closure, HeldOutModel, build_held_out_model, compute_closure
from ground.diagnosis.nonlinear_fit import QuadraticSurrogate, fit_nonlinear
from ground.diagnosis.normal_equations import NormalEquations, form_normal_equations
from ground.diagnosis.problem import Hypothesis, Ints
from ground.diagnosis.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class CampaignSensitivities:
    """A campaign's sensitivities, of the motions that are fitted and of those that are held out."""

    fitted: Sensitivities
    held: Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class CaseResiduals:
    """Which features of the campaign a case has, and what was measured less predicted, (n,) each."""

    rows: Ints
    value: Array


@dataclass(frozen=True, slots=True, eq=False)
class CaseFeatures:
    """Of a case."""

    fitted: CaseResiduals
    held: CaseResiduals

    def document(self) -> dict[str, Any]:
        """Plain; every number comes back as it was."""
        return {
            name: {"rows": one.rows.tolist(), "value": one.value.tolist()}
            for name, one in (("fitted", self.fitted), ("held", self.held))
        }


@dataclass(frozen=True, slots=True, eq=False)
class CasePart:
    """Some features: their sensitivities, and what was measured less predicted."""

    sensitivities: Sensitivities
    value: Array


def split_case(kept: CampaignSensitivities, case: CaseFeatures) -> tuple[CasePart, CasePart]:
    """What a diagnosis is made of, and what it is tried on."""
    fitted = CasePart(kept.fitted.select(case.fitted.rows), case.fitted.value)
    return fitted, CasePart(kept.held.select(case.held.rows), case.held.value)


def read_case_features(path: Path) -> CaseFeatures:
    """As they were written; BadRequest if they cannot be read."""
    try:
        said = json.loads(path.read_bytes())
        fitted, held = (
            CaseResiduals(np.array(said[name]["rows"], np.intp), np.array(said[name]["value"], float))
            for name in ("fitted", "held")
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        solved = path.name.replace(".features", "")
        raise BadRequest(f"{path}: holds no features ({error}); remove {solved} and solve again") from error
    return CaseFeatures(fitted, held)


FeatureChange = Callable[[Sensitivities], Array]
"""What is said to have changed in the features, (m,)."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutTrial:
    """A case with its nuisances alone, ready for what is said of it."""

    fitted: CasePart
    held: CasePart
    equations: NormalEquations
    """Of the fitted part."""
    held_out_model: HeldOutModel

    def left(self, change: FeatureChange) -> tuple[Array, Array]:
        """Residuals (m,) of the fitted part, whitened, and of the held-out part, raw; nuisances refitted."""
        equations = self.equations
        rest = equations.whiten(self.fitted.value - change(self.fitted.sensitivities))
        N = equations.A[:, : equations.q]
        v = equations.C[-1] @ (N.T @ rest)
        return rest - N @ v, self.held.value - change(
            self.held.sensitivities
        ) - self.held_out_model.nuisance @ v

    def closed(self, change: FeatureChange, seed: int) -> Closure:
        """On held-out motion, against nuisances alone."""
        return compute_closure(self.held_out_model, self.left(no_change)[1], self.left(change)[1], seed)


def no_change(found: Sensitivities) -> Array:
    """No change."""
    return np.zeros(found.layout.size)


def prepare_trial(fitted: CasePart, held: CasePart) -> HeldOutTrial:
    """ValueError if a motion is in both."""
    equations = form_normal_equations(fitted.sensitivities)
    return HeldOutTrial(fitted, held, equations, build_held_out_model(equations, held.sensitivities))


def closure_of_truth(case: HeldOutTrial, true: dict[Hypothesis, Array], seed: int) -> Closure:
    """What the true effects achieve, their sizes fitted from the true ones on, by the parabolas."""
    surrogate = QuadraticSurrogate(case.fitted.sensitivities)
    whitened = case.equations.whiten(case.fitted.value)
    best = fit_nonlinear(surrogate, case.equations, whitened, true)
    said = dict(zip(best.hypotheses, best.values, strict=True))
    return case.closed(lambda found: QuadraticSurrogate(found).change(said), seed)
