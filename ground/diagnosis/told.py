"""A diagnosis as one plain document: text, numbers, lists and tables; what is not finite is None."""

from dataclasses import asdict
from typing import Any, Final

from ground.diagnosis.bootstrap import Alternatives
from ground.diagnosis.closure import Closure
from ground.diagnosis.diagnose import Finding
from ground.diagnosis.hypothesis import Hypothesis
from ground.diagnosis.plain import finite
from ground.diagnosis.ready import Ready
from ground.diagnosis.result import Result

MOST: Final = 10
"""Hypotheses of the ranking, and groups with structure, that are told."""


def told(result: Result) -> dict[str, Any]:
    """All that a result says; the keys are explained in docs/gap.md."""
    said, ready = result.diagnosis, result.ready
    return {
        "verdict": said.verdict,
        "effects": [_effect(ready, finding) for finding in said.findings],
        "ranking": [_named(ready, one) for one in said.ranking[:MOST]],
        "where": [_plain(asdict(cell)) for cell in said.where],
        "closure": None if result.closure is None else _closure(result.closure),
        "confusable": [
            [_named(ready, one) for one in finding.confusable]
            for finding in said.findings
            if len(finding.confusable) > 1
        ],
        "next_motion": [_plain(asdict(motion)) for motion in result.next_motion],
        "odds": finite(said.odds),
        "unexplained": {
            "structure": remains_unexplained(result),
            "surprise": finite(said.unexplained_surprise),
            "remains": [
                {
                    "channel": one.channel,
                    "place": one.place,
                    "regime": one.regime,
                    "depends_on": one.depends_on,
                    "surprise": finite(one.surprise),
                }
                for one in said.unexplained[:MOST]
            ],
        },
        "tool_mm": None
        if result.tool is None
        else {
            "before": finite(result.tool.before_mm),
            "after": finite(result.tool.after_mm),
            "floor": finite(result.tool.floor_mm),
        },
        "notes": list(result.notes),
        "floor": list(result.floor),
        "thresholds": _plain(asdict(ready.thresholds)),
    }


def remains_unexplained(result: Result) -> bool:
    """Whether structure remains beyond what is let pass: beside the findings, or without any."""
    said, limits = result.diagnosis, result.ready.thresholds
    limit = limits.unexplained if said.findings else limits.structure
    return said.unexplained_surprise >= limit


def probability_of(hypothesis: int, alternatives: Alternatives) -> float:
    """Of one among what may stand in its stead; 0 if it is not among the fewest that are told."""
    known = dict(zip(alternatives.hypotheses, alternatives.probability, strict=True))
    return float(known.get(hypothesis, 0.0))


def others(finding: Finding) -> tuple[tuple[int, float], ...]:
    """What may stand in the stead of a finding, one of each class, and how probably; most probable first."""
    known = finding.alternatives
    every = zip(known.hypotheses, known.probability, strict=True)
    return tuple((one, share) for one, share in every if one != finding.hypothesis)


def _effect(ready: Ready, finding: Finding) -> dict[str, Any]:
    hypothesis = ready.found.hypotheses[finding.hypothesis]
    numbers = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
    return {
        **_name(hypothesis),
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "is_size": parameter.sizes,
                "value": finite(value),
                "least": finite(least),
                "most": finite(most),
            }
            for parameter, value, least, most in numbers
        ],
        "probability": probability_of(finding.hypothesis, finding.alternatives),
        "share": finite(finding.share),
        "alternatives": [
            {**_named(ready, one), "probability": finite(share)} for one, share in others(finding)
        ],
        "confusable": [_named(ready, one) for one in finding.confusable if one != finding.hypothesis],
        "at_bound": list(finding.at_bound),
    }


def _closure(found: Closure) -> dict[str, Any]:
    names = ("share", "least", "most", "before", "after")
    numbers = {name: finite(getattr(found, name)) for name in names}
    return {**numbers, "channels": [_plain(asdict(channel)) for channel in found.channels]}


def _named(ready: Ready, hypothesis: int) -> dict[str, str]:
    return _name(ready.found.hypotheses[hypothesis])


def _name(hypothesis: Hypothesis) -> dict[str, str]:
    return {"name": hypothesis.effect, "place": hypothesis.place}


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    """The same with plain numbers."""
    return {key: _plain_value(value) for key, value in table.items()}


def _plain_value(value: Any) -> Any:
    if isinstance(value, dict):
        return _plain(value)
    if isinstance(value, tuple):
        return [_plain_value(one) for one in value]
    return value if isinstance(value, str | int) else finite(value)
