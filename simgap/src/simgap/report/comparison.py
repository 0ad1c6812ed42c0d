"""Sentences and JSON document of a comparison."""

from collections.abc import Sequence
from typing import Any

from simgap.common.report import to_json
from simgap.report.details import finding_lines
from simgap.report.document import to_document
from simgap.report.sentences import verdict_lines
from simgap.result import Comparison, Limit
from simgap.units import quantity

FORMAT = "comparison 1"
"""Name and version of the document."""


def comparison_lines(made: Comparison) -> tuple[str, str, str, str]:
    """Return where something changed, what, how far the error falls with it, and what is not seen."""
    where, what, _, following = verdict_lines(made.found)
    limits = f"Not seen: {_limit_words(made.limits)}."
    if not made.found.findings:
        return (
            "Where: nowhere; one model fits both sets of logs.",
            "What: nothing changed that these logs show.",
            f"How far: {_how_far(made)}",
            limits,
        )
    asked = following if "record" in following else limits
    return where, what, f"How far: {_how_far(made)}", asked


def comparison_details(made: Comparison) -> list[str]:
    """Return a sentence for each change, for each one that is not named, and the limits of all joints."""
    joints = dict.fromkeys(one.place for one in made.limits)
    limits = (_limit_words([one for one in made.limits if one.place == joint]) for joint in joints)
    return [*finding_lines(made.found), *(f"Beside what was found, {one}." for one in limits)]


def comparison_document(made: Comparison) -> dict[str, Any]:
    """Return a comparison as a document that JSON can hold."""
    found = to_document(made.found)
    return found | {
        "format": FORMAT,
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
    """Return the changes of base parameters that may have happened unseen."""
    words = [f"{one.name} of {one.place} from {one.low:+.3g} to {one.high:+.3g}" for one in limits]
    return f"changes may lie within {', '.join(words)} (90 %)" if words else "no base parameter can be told"
