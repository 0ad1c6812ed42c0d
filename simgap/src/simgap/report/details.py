"""Sentences of a diagnosis below its verdict: findings, what remains, is not known, and took no part."""

from collections.abc import Sequence
from math import isfinite
from typing import Final

from simgap.common.console import pluralize
from simgap.report.sentences import (
    EARLIER,
    MAX_MEMBERS,
    base_words,
    certainty_words,
    finding_words,
    join_words,
    level,
    list_differing,
    percent,
    rank_findings,
    regime_words,
)
from simgap.result import Base, Diagnosis, Finding, JointError, Rejected, Remainder
from simgap.units import quantity

GAINS: Final = {
    "gain_ratio": "the gain",
    "torque_constant_Nm_A": "the torque constant",
    "torque_constant_N_A": "the force constant",
}
"""Base parameters to which others are known as ratios where gravity gives no scale, by their names."""


def detail_lines(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence for each finding, for what remains, cannot be known, and took no part."""
    return [*finding_lines(diagnosis), *log_lines(diagnosis)]


def log_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the remarks on the logs, and a sentence for all that took no part."""
    sizes = [(one, pluralize(one.n_samples, "sample")) for one in diagnosis.refused]
    refused = [f"{one.motion}: {size} took no part: {one.reason}." for one, size in sizes]
    return [
        *_shorten(diagnosis.remarks, "remark on the logs", "remarks on the logs"),
        *_shorten(refused, "refusal"),
    ]


def finding_lines(diagnosis: Diagnosis) -> list[str]:
    """Return sentences of each finding, of what remains, is not named, and cannot be known."""
    return [*finding_sentences(rank_findings(diagnosis)), *rest_lines(diagnosis)]


def rest_lines(diagnosis: Diagnosis) -> list[str]:
    """Return sentences of what remains, is not named, and cannot be known."""
    has_start = bool(diagnosis.start)
    errors = [error_sentence(one, has_start) for one in diagnosis.errors if diagnosis.is_base_only]
    base = [base_sentence(one, has_start) for one in list_differing(diagnosis)]
    return [
        *errors,
        *remainder_sentences(diagnosis.remaining, diagnosis.is_base_only),
        *_shorten(rejected_sentences(diagnosis.rejected), "refusal of a name", "refusals of names"),
        *_shorten(base, "base parameter that differs", "base parameters that differ"),
        *bound_sentences(diagnosis.base),
        *unknown_sentences(diagnosis.base),
    ]


def _shorten(lines: Sequence[str], noun: str, nouns: str = "") -> list[str]:
    """Return the first sentences of a list, and a sentence that counts the others."""
    rest = len(lines) - MAX_MEMBERS
    if rest <= 0:
        return list(lines)
    counted = f"1 more {noun} is" if rest == 1 else f"{rest} more {nouns or noun + 's'} are"
    return [*lines[:MAX_MEMBERS], f"{counted} in the JSON document."]


def finding_sentences(findings: Sequence[Finding]) -> list[str]:
    """Return a sentence for each finding, and before findings that are equally sure one that says so."""
    groups: dict[str, list[Finding]] = {}
    for one in findings:
        groups.setdefault(certainty_words(one), []).append(one)
    sentences = []
    for certainty, alike in groups.items():
        if len(alike) == 1:
            sentences.append(f"{_capital(finding_words(alike[0]))}: {certainty}.{_evidence(alike[0])}")
            continue
        words = certainty.replace(": ", "; ")
        sentences.append(f"For each of the next {len(alike)} findings: {words}.")
        sentences += [f"{_capital(finding_words(one))}.{_evidence(one)}" for one in alike]
    return sentences


def _capital(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}"


def _evidence(finding: Finding) -> str:
    """Return the intervals and the own share of an effect that is told."""
    if level(finding) != "effect":
        return ""
    sizes = zip(finding.size_names, finding.interval, strict=True)
    intervals = ", ".join(f"{name} from {low:.4g} to {high:.4g}" for name, (low, high) in sizes)
    own = f" With 90 % probability {intervals}." if intervals else ""
    lost = f" Without it, {percent(finding.share)} of the explainable error of its joint comes back."
    return own + (lost if isfinite(finding.share) else "")


def base_sentence(one: Base, has_start: bool = False) -> str:
    """Return a base parameter that differs from the model with its interval and its own share."""
    is_ratio = one.name.endswith("_ratio")
    low, high = (f"{100 * end:+.4g} %" if is_ratio else f"{end:.4g}" for end in one.interval)
    before = EARLIER if has_start else "model"
    lost = f" With that of the {before}, {percent(one.share)} of the error of its joint comes back."
    words = f"{base_words(one, has_start)}; with 90 % probability from {low} to {high}."
    return words + (lost if isfinite(one.share) else "")


def error_sentence(one: JointError, has_start: bool = False) -> str:
    """Return the mean error of a joint, before and after its base parameters are fitted."""
    nominal, base = (quantity(value, one.unit) for value in (one.nominal, one.base))
    before = f"with the {EARLIER}" if has_start else "as it is"
    return f"Mean error of {one.joint}: {nominal} {before}, {base} with base parameters."


def remainder_sentences(remaining: Sequence[Remainder], is_base_only: bool = False) -> list[str]:
    """Return one sentence about what remains at all joints, and on which variables it depends."""
    parts = [
        f"{quantity(one.mean_abs, one.unit)} at {one.joint} {regime_words(one.regime)}"
        + (f", {percent(one.depends_share)} of which {one.depends_on} explains" if one.depends_on else "")
        for one in remaining
    ]
    cause = "Base parameters do not explain" if is_base_only else "No effect explains"
    return [f"{cause} what remains: {'; '.join(parts)}."] if parts else []


def rejected_sentences(rejected: Sequence[Rejected]) -> list[str]:
    """Return a sentence for the effects of a place that are not named for the same reason."""
    groups: dict[tuple[str, str], list[str]] = {}
    for one in rejected:
        groups.setdefault((one.place, one.reason.removeprefix(f"{one.place}: ")), []).append(one.effect)
    return [
        f"{_capital(join_words(names, 'and', len(names)))} at {place} "
        f"{'is' if len(names) == 1 else 'are'} not named: {reason}."
        for (place, reason), names in groups.items()
    ]


def bound_sentences(base: Sequence[Base]) -> list[str]:
    """Return a sentence about the base parameters that end at bounds which the motions contradict."""
    pushed = [one for one in base if one.is_pushed]
    if not pushed:
        return []
    named = join_words([f"{one.name} of {one.place} ({one.value:.3g})" for one in pushed], "and", len(pushed))
    ends = "ends at its bound" if len(pushed) == 1 else "end at their bounds"
    return [
        f"{named} {ends}, and the motions ask for more: another number of the model is wrong, such as a "
        "mass, or something acts that is not in the catalogue. No effect at "
        f"{join_words([one.place for one in pushed], 'or', len(pushed))} is sure."
    ]


def unknown_sentences(base: Sequence[Base]) -> list[str]:
    """Return a sentence for the joints or links of which the same numbers cannot be known."""
    unknown = [one for one in base if not one.is_identifiable]
    places: dict[str, list[str]] = {}
    for place in dict.fromkeys(one.place for one in unknown):
        names = [one.name for one in unknown if one.place == place]
        rest = [name for name in names if name not in GAINS]
        gain = next((words for name, words in GAINS.items() if name in names), "")
        if gain and rest:
            what = f"only ratios to {gain} can be known of: {join_words(rest, 'and', len(rest))}"
        else:
            what = f"the logs do not determine: {join_words(names, 'and', len(names))}"
        places.setdefault(what, []).append(place)
    return [f"At {join_words(alike, 'and', len(alike))}, {what}." for what, alike in places.items()]
