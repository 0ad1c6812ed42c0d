"""JSON document of a diagnosis."""

import math
from math import isfinite
from typing import Any, Final

from simgap.common.report import to_json
from simgap.report.details import detail_lines
from simgap.report.sentences import level, verdict_lines, verdict_word
from simgap.result import Base, Diagnosis, Finding

FORMAT: Final = "diagnosis 1"
"""Name and version of the document."""


def to_document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as a document that JSON can hold; unknown numbers are null."""
    return {
        "format": FORMAT,
        "robot": diagnosis.robot,
        "kind": diagnosis.kind,
        "method": diagnosis.method,
        "remarks": list(diagnosis.remarks),
        "seed": diagnosis.seed,
        "verdict": verdict_word(diagnosis),
        "lines": list(verdict_lines(diagnosis)),
        "details": detail_lines(diagnosis),
        "closure_share": diagnosis.closure,
        "findings": [_finding(one) for one in diagnosis.findings],
        "base": [_base(one) for one in diagnosis.base],
        "errors": to_json(diagnosis.errors),
        "remaining": to_json(diagnosis.remaining),
        "refused": to_json(diagnosis.refused),
        "rejected": to_json(diagnosis.rejected),
        "fitted_motions": list(diagnosis.fitted_motions),
        "judged_motions": list(diagnosis.judged_motions),
        "effects": [
            {
                "key": effect.key,
                "kind": kind,
                "size": {one.name: number(value) for one, value in zip(effect.sizes, size, strict=True)},
            }
            for kind in diagnosis.kinds
            for effect, size in zip(*diagnosis.fitted_to(kind), strict=True)
        ],
    }


def number(value: float) -> float | str | None:
    """Return a number as JSON can hold it: NaN is null, infinity a text."""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return float(value) if isfinite(value) else None


def _finding(one: Finding) -> dict[str, Any]:
    sizes = zip(one.size_names, one.size, one.interval, strict=True)
    return {
        "place": one.place,
        "family": str(one.family),
        "effect": one.effect,
        "text": one.text,
        "level": level(one),
        "sizes": [
            {"name": name, "value": number(size), "low_90": number(low), "high_90": number(high)}
            for name, size, (low, high) in sizes
        ],
        "share": number(one.share),
        "not_excluded": {
            "places": list(one.places),
            "families": [str(family) for family in one.families],
            "effects": list(one.effects),
        },
        "next_motion": one.next_motion,
    }


def _base(one: Base) -> dict[str, Any]:
    low, high = one.interval
    return {
        "place": one.place,
        "name": one.name,
        "nominal": number(one.nominal),
        "value": number(one.value),
        "low_90": number(low),
        "high_90": number(high),
        "is_identifiable": one.is_identifiable,
        "is_at_bound": one.is_pushed,
        "share": number(one.share),
    }
