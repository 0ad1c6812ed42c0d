"""Sentences about a diagnosis, used by its page and by the console."""

from collections.abc import Sequence
from math import exp, inf, isfinite
from typing import Final

from ground.diagnosis.diagnose import Finding
from ground.diagnosis.model import DiagnosisModel
from ground.diagnosis.problem import LOG_UNIT, Hypothesis
from ground.diagnosis.residual_analysis import LackOfFit, ResidualCell
from ground.diagnosis.result import DiagnosisResult, has_lack_of_fit, list_alternatives, probability_of

MAX_NAMES: Final = 3
"""Largest number of names in a list within a sentence."""
MIN_SEPARATION: Final = 1.0
"""Separation in sigmas from which on a motion is worth recording."""
DEPENDS: Final = {"nothing": "a constant offset", "noise": "no condition, as if it were noise"}


def verdict_sentences(result: DiagnosisResult) -> tuple[str, str]:
    """Return the verdict, and a sentence on its strength."""
    verdict = result.diagnosis.verdict
    if verdict == "none":
        return _no_effect_sentence(), _detectable_sentence(result.model)
    if verdict == "unknown":
        return _unknown_sentence(result), closure_sentence(result) if is_doubtful(
            result
        ) else _nearest_sentence(result)
    return _causes_sentence(result), closure_sentence(result)


def closure_sentence(result: DiagnosisResult) -> str:
    """Return the share of the explainable residual that the findings remove."""
    found, tool = result.closure, result.tool
    if found is None:
        return "No motion was held out, so how far the gap shrinks is not known."
    if not isfinite(found.share):
        return "On held-out motion the gap is hardly above the noise, so no share is given."
    at_tool = "" if tool is None else f"; at the tool {tool.before_mm:.2g} mm become {tool.after_mm:.2g}"
    closed = f"{format_percent(found.share)} {_format_percent_interval(found.least, found.most)}"
    return (
        f"With {_effects_pronoun(result)} in the simulator, {closed} of the explainable gap closes on motion "
        f"that was held out{at_tool}."
    )


def finding_words(model: DiagnosisModel, finding: Finding) -> str:
    """Return a finding with its aliases and its alternatives."""
    own = model.sensitivities.hypotheses[finding.hypothesis].name
    alike = [
        model.sensitivities.hypotheses[one].name
        for one in finding.equivalence_class
        if one != finding.hypothesis
    ]
    if alike:
        own += f" (or {join_names(alike, ' or ')}, which these motions cannot distinguish)"
    if not list_alternatives(finding):
        return own
    sure = format_percent(probability_of(finding.hypothesis, finding.alternatives))
    return f"either {own} ({sure}) or {alternatives_words(model, finding, ' or ')}"


def alternatives_words(model: DiagnosisModel, finding: Finding, between: str = ", ") -> str:
    """Return the most probable alternatives of a finding with their probabilities."""
    rest = list_alternatives(finding)
    named = [
        f"{model.sensitivities.hypotheses[one].name} ({format_percent(probability)})"
        for one, probability in rest[:MAX_NAMES]
    ]
    more = [f"one of {len(rest) - MAX_NAMES} more"] if len(rest) > MAX_NAMES else []
    return between.join([*named, *more])


def join_names(names: Sequence[str], between: str = ", ") -> str:
    """Join the first names, and the number of others."""
    more = [f"{len(names) - MAX_NAMES} more"] if len(names) > MAX_NAMES else []
    return between.join([*names[:MAX_NAMES], *more])


def size_words(hypothesis: Hypothesis, finding: Finding) -> list[str]:
    """Return the fitted parameters with their intervals."""
    return [
        f"{parameter.name} {format_quantity(value, parameter.unit)} "
        f"({format_value_interval(least, most, parameter.unit)})"
        for parameter, value, least, most in zip(
            hypothesis.parameters, finding.values, finding.least, finding.most, strict=True
        )
        if isfinite(least)
    ]


def lack_of_fit_words(one: LackOfFit) -> str:
    """Return the description of a group with lack of fit."""
    depends = f"it depends on {DEPENDS.get(one.depends_on, one.depends_on)}"
    if one.channel == "all":
        return "in all channels together, in none of them clearly"
    regime = "in all regimes" if one.regime == "all" else f"in regime {one.regime}"
    return f"in {channel_words(one.channel, one.place)}, {regime}, and {depends}"


def channel_words(channel: str, place: str) -> str:
    """Return a channel with its place, unless its name begins with the place."""
    return channel if channel.startswith(place) else f"{channel} at {place}"


def unexplained_sentence(result: DiagnosisResult) -> str:
    """Return the result of the lack-of-fit test."""
    diagnosis = result.diagnosis
    found = format_number(diagnosis.unexplained_neg_log10_p)
    odds = f"-log10 p {found}, threshold {format_number(lack_of_fit_limit(result))}"
    if not has_lack_of_fit(result):
        return f"The residual shows no structure ({odds})."
    if diagnosis.unexplained[0].neg_log10_p < diagnosis.unexplained_neg_log10_p:
        return f"One more hypothesis beside the findings would be significant ({odds})."
    return f"Structure remains {lack_of_fit_words(diagnosis.unexplained[0])} ({odds})."


def next_sentence(result: DiagnosisResult) -> str:
    """Return the recommended next step."""
    diagnosis = result.diagnosis
    if result.next_motion:
        best = result.next_motion[0]
        if best.separation < MIN_SEPARATION:
            return (
                "No motion of this campaign would distinguish the possible causes: the best, "
                f"{best.name}, separates them by {format_number(best.separation)} sigmas."
            )
        return (
            f"Record {best.name}: it would separate the possible causes by "
            f"{format_number(best.separation)} sigmas (now {format_number(best.separation_now)})."
        )
    near = best_rejected(result)
    if near is not None:
        name, blocks = result.model.sensitivities.hypotheses[near].name, result.model.limits[near].blocks
        shown = format_number(blocks)
        return f"Record more motions that would show {name}: these show it in effectively {shown}."
    if is_doubtful(result):
        return "Repeat the motions that show it: this confirms it, or reveals unexplained structure."
    if diagnosis.verdict == "unknown":
        return "Add an effect that would show this to the catalogue, and diagnose again."
    if result.notes:
        return f"Resolve the note of the audit: {result.notes[0]}."
    if result.closure is None:
        return "Hold out motion, to measure how far the gap shrinks."
    return "This campaign cannot show more."


def format_percent(share: float) -> str:
    """Format a share as a percentage."""
    return f"{100.0 * share:.0f} %"


def format_number(value: float) -> str:
    """Format a number with three digits, infinity as words."""
    return "infinite" if value == inf else f"{value:.3g}"


def format_quantity(value: float, unit: str) -> str:
    """Format a number with three digits and its unit; a logarithm becomes a factor."""
    if unit == LOG_UNIT:
        return f"times {exp(value):.3g}"
    return f"{value:.3g}" if unit in ("", "1") else f"{value:.3g} {unit}"


def format_interval(least: float, most: float, without: str = "assumed") -> str:
    """Format a 90 % interval; `without` says why there is none."""
    return f"{least:.3g} to {most:.3g}" if isfinite(least) and isfinite(most) else without


def format_value_interval(least: float, most: float, unit: str) -> str:
    """Format the interval of a parameter; a logarithm becomes a factor."""
    return format_interval(exp(least), exp(most)) if unit == LOG_UNIT else format_interval(least, most)


def format_cell_interval(cell: ResidualCell) -> str:
    """Format the interval of a residual ratio."""
    return format_interval(cell.least, cell.most, "one motion")


def _format_percent_interval(least: float, most: float) -> str:
    if not (isfinite(least) and isfinite(most)):
        return "(anything is possible)"
    return f"({100.0 * least:.0f} to {100.0 * most:.0f})"


def lack_of_fit_limit(result: DiagnosisResult) -> float:
    """Return the -log10 p from which on remaining structure counts."""
    limits = result.model.thresholds
    return limits.unexplained if result.diagnosis.findings else limits.structure


def _effects_pronoun(result: DiagnosisResult) -> str:
    verdict, count = result.diagnosis.verdict, len(result.diagnosis.findings)
    words = {"set": "the first effect", "unknown": "the nearest effect"}
    return words.get(verdict, "it" if count == 1 else "them")


def _causes_sentence(result: DiagnosisResult) -> str:
    model, findings = result.model, result.diagnosis.findings
    if len(findings) > 1:
        names = ", ".join(model.sensitivities.hypotheses[one.hypothesis].name for one in findings)
        open_for = sum(bool(list_alternatives(one)) for one in findings)
        rest = f"; {open_for} of them may have another cause instead" if open_for else ""
        return f"The gap has {len(findings)} causes: {names}{rest}."
    (finding,) = findings
    name = finding_words(model, finding)
    if list_alternatives(finding):
        return f"The cause of the gap is {name}."
    sure = format_percent(probability_of(finding.hypothesis, finding.alternatives))
    sizes = size_words(model.sensitivities.hypotheses[finding.hypothesis], finding)
    return f"The cause of the gap is {name}, with probability {sure}{', '.join(['', *sizes])}."


def _no_effect_sentence() -> str:
    return (
        "No effect is seen: all differences from the simulator are within the noise floor and the "
        "uncertainty of the calibration."
    )


def _detectable_sentence(model: DiagnosisModel) -> str:
    seen = sum(one.limit <= 1.0 for one in model.limits)
    return (
        f"These motions would show {seen} of {len(model.limits)} hypotheses at their typical size; "
        "smaller effects may exist."
    )


def _unknown_sentence(result: DiagnosisResult) -> str:
    diagnosis = result.diagnosis
    if is_doubtful(result):
        return (
            f"{_nearest_names(result)} would explain the gap, but could also imitate a cause outside the "
            "catalogue, so no cause is named."
        )
    if not has_lack_of_fit(result):
        return "No effect of the catalogue explains the gap within its bounds."
    if diagnosis.unexplained[0].neg_log10_p < diagnosis.unexplained_neg_log10_p:
        return (
            "The gap is not explained: beside the nearest effects, one more hypothesis would be significant."
        )
    what = (
        "No effect of the catalogue surely explains the gap"
        if best_rejected(result) is not None
        else "There is an effect that is not in the catalogue"
    )
    return f"{what}: {lack_of_fit_words(diagnosis.unexplained[0])}."


def is_doubtful(result: DiagnosisResult) -> bool:
    """Check that the findings explain everything within bounds, and lack a name only for low confidence."""
    diagnosis = result.diagnosis
    inside = bool(diagnosis.findings) and not any(one.at_bound for one in diagnosis.findings)
    return diagnosis.verdict == "unknown" and inside and not has_lack_of_fit(result)


def _nearest_names(result: DiagnosisResult) -> str:
    hypotheses = result.model.sensitivities.hypotheses
    return " and ".join(hypotheses[one.hypothesis].name for one in result.diagnosis.findings)


def best_rejected(result: DiagnosisResult) -> int | None:
    """Return the best single hypothesis if it is significant but nothing was selected; else None."""
    diagnosis = result.diagnosis
    significant = diagnosis.neg_log10_p >= result.model.thresholds.effect
    return diagnosis.ranking[0] if diagnosis.ranking and significant and not diagnosis.findings else None


def _nearest_sentence(result: DiagnosisResult) -> str:
    diagnosis, model = result.diagnosis, result.model
    best = best_rejected(result)
    if best is not None:
        return (
            f"The nearest is {model.sensitivities.hypotheses[best].name}. It is significant, but does "
            "not predict motions that it was not fitted to, so no cause is named."
        )
    if not diagnosis.findings:
        return "No effect of the catalogue comes near, so no cause is named."
    names = _nearest_names(result)
    bounds = [name for one in diagnosis.findings for name in one.at_bound]
    beyond = f", and would go beyond the bounds of {', '.join(bounds)}" if bounds else ""
    return f"The nearest is {names}{beyond}; no cause is named."
