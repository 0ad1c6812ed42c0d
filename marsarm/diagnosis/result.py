"""Result document of a diagnosis: text, numbers, lists and tables for JSON; NaN and infinity become None."""

from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any, Final

from marsarm.diagnosis.closure import Closure
from marsarm.diagnosis.diagnose import Diagnosis, Finding
from marsarm.diagnosis.experiment_design import CandidateMotion
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.problem import Hypothesis
from simgap import Trace

MAX_LISTED: Final = 10
"""Number of groups with structure in the output."""


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
    traces: tuple[Trace, ...] = ()
    """Features of the fitted motions, measured and predicted without and with the findings."""

    def hypothesis(self, index: int) -> Hypothesis:
        """Return a hypothesis by its index."""
        return self.model.sensitivities.hypotheses[index]


def finite_or_none(value: float) -> float | None:
    """Return the number; None if it is NaN or infinite, which JSON cannot hold."""
    return float(value) if isfinite(value) else None


def to_json(result: DiagnosisResult) -> dict[str, Any]:
    """Return the result document; docs/diagnosis.md explains its keys."""
    diagnosis, model = result.diagnosis, result.model
    return {
        "verdict": diagnosis.verdict,
        "effects": [_finding_json(result, finding) for finding in diagnosis.findings],
        "residual_map": [_plain_table(asdict(cell)) for cell in diagnosis.residual_map],
        "closure": None if result.closure is None else _closure_json(result.closure),
        "next_motion": [_plain_table(asdict(motion)) for motion in result.next_motion],
        "unexplained": {
            "has_remainder": diagnosis.has_remainder,
            "neg_log10_p": finite_or_none(diagnosis.unexplained[0].neg_log10_p),
            "limit": finite_or_none(model.lack_of_fit_limit),
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
    }


def _finding_json(result: DiagnosisResult, finding: Finding) -> dict[str, Any]:
    hypothesis, limit = result.hypothesis(finding.hypothesis), result.model.limits[finding.hypothesis]
    numbers = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
    return {
        **_effect_and_place(hypothesis),
        "family": str(result.model.families[finding.hypothesis]),
        "level": finding.level,
        "places": list(finding.places),
        "families": list(map(str, finding.families)),
        "effects": [_effect_and_place(result.hypothesis(one)) for one in finding.effects],
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "is_amplitude": parameter.is_amplitude,
                "value": finite_or_none(value),
                "least": finite_or_none(least),
                "most": finite_or_none(most),
                "seen_from": finite_or_none(limit.limit * abs(parameter.typical)),
                "named_from": finite_or_none(limit.family_wise_limit * abs(parameter.typical)),
            }
            for parameter, value, least, most in numbers
        ],
        "share": finite_or_none(finding.share),
        "alternatives": [
            {**_effect_and_place(result.hypothesis(one.hypothesis)), "p": finite_or_none(one.p)}
            for one in finding.alternatives[1:]
        ],
        "aliases": [
            _effect_and_place(result.hypothesis(one))
            for one in finding.equivalence_class
            if one != finding.hypothesis
        ],
    }


def _closure_json(found: Closure) -> dict[str, Any]:
    names = ("share", "least", "most", "before", "after")
    numbers = {name: finite_or_none(getattr(found, name)) for name in names}
    return {**numbers, "channels": [_plain_table(asdict(channel)) for channel in found.channels]}


def _effect_and_place(hypothesis: Hypothesis) -> dict[str, str]:
    return {"name": hypothesis.effect, "place": hypothesis.place}


def _plain_table(table: dict[str, Any]) -> dict[str, Any]:
    """Convert the numbers of a table to plain ones."""
    return {
        key: value if isinstance(value, str | int) else finite_or_none(value) for key, value in table.items()
    }
