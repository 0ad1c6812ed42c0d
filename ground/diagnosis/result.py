"""Result document of a diagnosis: text, numbers, lists and tables for JSON; NaN and infinity become None."""

from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any, Final

from ground.diagnosis.bootstrap import Alternatives
from ground.diagnosis.closure import Closure
from ground.diagnosis.diagnose import Diagnosis, Finding
from ground.diagnosis.experiment_design import CandidateMotion
from ground.diagnosis.model import DiagnosisModel
from ground.diagnosis.problem import Hypothesis

MAX_LISTED: Final = 10
"""Number of ranked hypotheses, and of groups with structure, in the output."""


@dataclass(frozen=True, slots=True)
class ToolError:
    """Root mean square tool error on held-out motion, without and with the findings."""

    before_mm: float
    after_mm: float
    noise_floor_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisResult:
    """Diagnosis with closure, tool error, next motion and notes."""

    model: DiagnosisModel
    diagnosis: Diagnosis
    closure: Closure | None
    """None if no motion was held out."""
    tool: ToolError | None
    """None if no held-out motion has tracker poses."""
    next_motion: tuple[CandidateMotion, ...]
    """Candidate motions, best first; empty if no finding has an alias or an alternative."""
    notes: tuple[str, ...]
    """Notes of the audit."""
    noise_floor: tuple[str, ...]
    """Notes on the origin of the noise floor."""


def finite_or_none(value: float) -> float | None:
    """Return the number; None if it is NaN or infinite, which JSON cannot hold."""
    return float(value) if isfinite(value) else None


def to_json(result: DiagnosisResult) -> dict[str, Any]:
    """Return the result document; docs/diagnosis.md explains its keys."""
    diagnosis, model = result.diagnosis, result.model
    return {
        "verdict": diagnosis.verdict,
        "effects": [_finding_json(model, finding) for finding in diagnosis.findings],
        "ranking": [_hypothesis_json(model, one) for one in diagnosis.ranking[:MAX_LISTED]],
        "residual_map": [_plain_table(asdict(cell)) for cell in diagnosis.residual_map],
        "closure": None if result.closure is None else _closure_json(result.closure),
        "equivalence_classes": [
            [_hypothesis_json(model, one) for one in finding.equivalence_class]
            for finding in diagnosis.findings
            if len(finding.equivalence_class) > 1
        ],
        "next_motion": [_plain_table(asdict(motion)) for motion in result.next_motion],
        "log_odds": finite_or_none(diagnosis.log_odds),
        "unexplained": {
            "lack_of_fit": has_lack_of_fit(result),
            "neg_log10_p": finite_or_none(diagnosis.unexplained_neg_log10_p),
            "groups": [
                {
                    "channel": one.channel,
                    "place": one.place,
                    "regime": one.regime,
                    "depends_on": one.depends_on,
                    "neg_log10_p": finite_or_none(one.neg_log10_p),
                }
                for one in diagnosis.unexplained[:MAX_LISTED]
            ],
        },
        "tool_mm": None
        if result.tool is None
        else {
            "before": finite_or_none(result.tool.before_mm),
            "after": finite_or_none(result.tool.after_mm),
            "noise_floor": finite_or_none(result.tool.noise_floor_mm),
        },
        "notes": list(result.notes),
        "noise_floor": list(result.noise_floor),
        "thresholds": _plain_table(asdict(model.thresholds)),
    }


def has_lack_of_fit(result: DiagnosisResult) -> bool:
    """Check that structure remains beyond the threshold that applies with or without findings."""
    diagnosis, limits = result.diagnosis, result.model.thresholds
    limit = limits.unexplained if diagnosis.findings else limits.structure
    return diagnosis.unexplained_neg_log10_p >= limit


def probability_of(hypothesis: int, alternatives: Alternatives) -> float:
    """Return the probability of a hypothesis among the alternatives; 0 if it is not one of them."""
    known = dict(zip(alternatives.hypotheses, alternatives.probability, strict=True))
    return float(known.get(hypothesis, 0.0))


def list_alternatives(finding: Finding) -> tuple[tuple[int, float], ...]:
    """Return the alternatives of a finding without itself, one of each class, with their probabilities."""
    known = finding.alternatives
    every = zip(known.hypotheses, known.probability, strict=True)
    return tuple((one, share) for one, share in every if one != finding.hypothesis)


def _finding_json(model: DiagnosisModel, finding: Finding) -> dict[str, Any]:
    hypothesis = model.sensitivities.hypotheses[finding.hypothesis]
    numbers = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
    return {
        **_effect_and_place(hypothesis),
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "is_amplitude": parameter.is_amplitude,
                "value": finite_or_none(value),
                "least": finite_or_none(least),
                "most": finite_or_none(most),
            }
            for parameter, value, least, most in numbers
        ],
        "probability": probability_of(finding.hypothesis, finding.alternatives),
        "share": finite_or_none(finding.share),
        "alternatives": [
            {**_hypothesis_json(model, one), "probability": finite_or_none(share)}
            for one, share in list_alternatives(finding)
        ],
        "aliases": [
            _hypothesis_json(model, one) for one in finding.equivalence_class if one != finding.hypothesis
        ],
        "at_bound": list(finding.at_bound),
    }


def _closure_json(found: Closure) -> dict[str, Any]:
    names = ("share", "least", "most", "before", "after")
    numbers = {name: finite_or_none(getattr(found, name)) for name in names}
    return {**numbers, "channels": [_plain_table(asdict(channel)) for channel in found.channels]}


def _hypothesis_json(model: DiagnosisModel, hypothesis: int) -> dict[str, str]:
    return _effect_and_place(model.sensitivities.hypotheses[hypothesis])


def _effect_and_place(hypothesis: Hypothesis) -> dict[str, str]:
    return {"name": hypothesis.effect, "place": hypothesis.place}


def _plain_table(table: dict[str, Any]) -> dict[str, Any]:
    """Convert the numbers of a table to plain ones."""
    return {key: _plain_value(value) for key, value in table.items()}


def _plain_value(value: Any) -> Any:
    if isinstance(value, dict):
        return _plain_table(value)
    if isinstance(value, tuple):
        return [_plain_value(one) for one in value]
    return value if isinstance(value, str | int) else finite_or_none(value)
