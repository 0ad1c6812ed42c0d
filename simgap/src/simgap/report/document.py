"""JSON document of a diagnosis, and sentences and document of a comparison."""

import math
from collections.abc import Sequence
from math import isfinite
from typing import Any, Final

import numpy as np

from simgap.common.report import to_json
from simgap.report.details import detail_lines, finding_lines, log_lines
from simgap.report.sentences import level, verdict_lines, verdict_word
from simgap.result import Base, Comparison, Diagnosis, Finding, Limit
from simgap.units import quantity

FORMAT: Final = "diagnosis 1"
"""Name and version of the document."""


def to_document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as a document that JSON can hold; unknown numbers are null."""
    return {
        "format": FORMAT,
        **_own(diagnosis, "robot", "kind", "method", "remarks", "seed"),
        "verdict": verdict_word(diagnosis),
        "lines": list(verdict_lines(diagnosis)),
        "details": detail_lines(diagnosis),
        "closure_share": diagnosis.closure,
        "findings": [_finding(one) for one in diagnosis.findings],
        "base": [_base(one) for one in diagnosis.base],
        **_own(diagnosis, "errors", "remaining", "refused", "rejected", "fitted_motions", "judged_motions"),
        "effects": [
            {
                "key": effect.key,
                "kind": kind,
                "size": {name: number(value) for name, value in effect.name_sizes(np.array(size)).items()},
            }
            for kind in diagnosis.kinds
            for effect, size in zip(*diagnosis.fitted_to(kind), strict=True)
        ],
    }


def _own(record: Diagnosis | Finding | Base, *names: str) -> dict[str, Any]:
    return {name: to_json(getattr(record, name)) for name in names}


def number(value: float) -> float | str | None:
    """Return a number as JSON can hold it: NaN is null, infinity a text."""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return float(value) if isfinite(value) else None


def _finding(one: Finding) -> dict[str, Any]:
    sizes = zip(one.size_names, one.size, one.interval, strict=True)
    return {
        **_own(one, "place", "family", "effect", "text"),
        "level": level(one),
        "sizes": [
            {"name": name, "value": number(size), "low_90": number(low), "high_90": number(high)}
            for name, size, (low, high) in sizes
        ],
        "share": number(one.share),
        "not_excluded": _own(one, "places", "families", "effects"),
        "next_motion": one.next_motion,
    }


def _base(one: Base) -> dict[str, Any]:
    low, high = one.interval
    numbers = {"nominal": one.nominal, "value": one.value, "low_90": low, "high_90": high}
    return {
        **_own(one, "place", "name"),
        **{name: number(value) for name, value in numbers.items()},
        "is_identifiable": one.is_identifiable,
        "is_at_bound": one.is_pushed,
        "share": number(one.share),
    }


COMPARISON = "comparison 1"
"""Name and version of the document."""


def comparison_lines(made: Comparison) -> tuple[str, str, str, str]:
    """Return where something changed, what, how far the error falls with it, and what is not seen."""
    where, what, _, following = verdict_lines(made.found)
    small = "Not seen: smaller changes; the limits of each joint follow."
    limits = small if made.limits else "No base parameter can be told."
    if not made.found.findings:
        where = "Where: nowhere; one model fits both sets of logs."
        if not all(one.noise_floor > 0.0 for one in made.found.errors):
            where = "Where: nowhere that shows; the error left is not judged, as no repeats tell its noise."
        if made.found.remaining:
            where = "Where: nowhere that these logs show; one model leaves an error in both sets."
        what = "What: nothing changed that these logs show."
        return where, what, f"How far: {_how_far(made)}", limits
    asked = following if "record" in following else limits
    return where, what, f"How far: {_how_far(made)}", asked


def comparison_details(made: Comparison) -> list[str]:
    """Return sentences of changes, of what is not named or took no part, and the limits of all joints."""
    joints = dict.fromkeys(one.place for one in made.limits)
    limits = (_limit_words([one for one in made.limits if one.place == joint]) for joint in joints)
    beside = "Beside what was found, changes" if made.found.findings else "Changes"
    return [
        *finding_lines(made.found),
        *log_lines(made.found),
        *(f"{beside} may lie within {one}." for one in limits),
    ]


def comparison_document(made: Comparison) -> dict[str, Any]:
    """Return a comparison as a document that JSON can hold."""
    found = to_document(made.found)
    return found | {
        "format": COMPARISON,
        "verdict": found["verdict"] if made.found.findings else "none",
        "lines": list(comparison_lines(made)),
        "details": comparison_details(made),
        "limits": to_json(made.limits),
    }


def _how_far(made: Comparison) -> str:
    """Return the largest error of a joint with one model for both sets, and with the changes."""
    one = max(made.found.errors, key=lambda each: each.base)
    noise = quantity(one.noise_floor, one.unit) if one.noise_floor > 0.0 else "not known without repeats"
    far = f"with one model for both, the error of {one.joint} is {quantity(one.base, one.unit)}"
    changed = f"; with the changes {quantity(one.explained, one.unit)}" if made.found.findings else ""
    return f"{far}{changed} (noise: {noise})."


def _limit_words(limits: Sequence[Limit]) -> str:
    """Return the limits of the changes of base parameters that may have happened unseen."""
    words = [
        f"{one.name} of {one.place} from {one.low:+.3g} to {one.high:+.3g}"
        f"{'' if one.low <= 0.0 <= one.high else ', not sure enough to be named'}"
        for one in limits
    ]
    return f"{', '.join(words)} (90 %)"
