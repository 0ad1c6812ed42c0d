"""What a diagnosis says, in sentences: the same on its page and on the console."""

from collections.abc import Sequence
from math import exp, inf, isfinite
from typing import Final

from ground.diagnosis.diagnose import Finding
from ground.diagnosis.hypothesis import FACTOR, Hypothesis
from ground.diagnosis.ready import Ready
from ground.diagnosis.result import Result
from ground.diagnosis.structure import Remains
from ground.diagnosis.told import others, probability_of, remains_unexplained
from ground.diagnosis.where import Cell

FEW: Final = 3
"""Names of a kind in a sentence."""
APART: Final = 1.0
"""Sigmas by which a motion must set two effects apart to be worth its time."""
DEPENDS: Final = {"nothing": "a constant offset", "noise": "no condition, as if it were noise"}


def verdict_sentences(result: Result) -> tuple[str, str]:
    """The verdict, and what it is worth."""
    verdict = result.diagnosis.verdict
    if verdict == "none":
        return _none(), _seen(result.ready)
    if verdict == "unknown":
        return _unknown(result), closure_sentence(result) if doubted(result) else _nearest(result)
    return _causes(result), closure_sentence(result)


def closure_sentence(result: Result) -> str:
    """How far the gap shrinks."""
    found, tool = result.closure, result.tool
    if found is None:
        return "No motion was held out, so how far the gap shrinks is not known."
    if not isfinite(found.share):
        return "On held-out motion there is hardly a gap above the noise, so no share of it can be told."
    at_tool = "" if tool is None else f"; at the tool {tool.before_mm:.2g} mm become {tool.after_mm:.2g}"
    closed = f"{percent(found.share)} {_interval_percent(found.least, found.most)}"
    return (
        f"With {_switched_on(result)} in the simulator, {closed} of the explainable gap closes on motion "
        f"that was held out{at_tool}."
    )


def finding_words(ready: Ready, finding: Finding) -> str:
    """What was found, what it cannot be told from, and what may stand in its stead."""
    own = ready.found.hypotheses[finding.hypothesis].name
    alike = [ready.found.hypotheses[one].name for one in finding.confusable if one != finding.hypothesis]
    if alike:
        own += f" (or {listed(alike, ' or ')}, which these motions do not tell from it)"
    if not others(finding):
        return own
    sure = percent(probability_of(finding.hypothesis, finding.alternatives))
    return f"either {own} ({sure}) or {alternatives_words(ready, finding, ' or ')}"


def alternatives_words(ready: Ready, finding: Finding, between: str = ", ") -> str:
    """What may stand in the stead of a finding, the most probable with their probabilities."""
    rest = others(finding)
    named = [
        f"{ready.found.hypotheses[one].name} ({percent(probability)})" for one, probability in rest[:FEW]
    ]
    more = [f"one of {len(rest) - FEW} more"] if len(rest) > FEW else []
    return between.join([*named, *more])


def listed(names: Sequence[str], between: str = ", ") -> str:
    """The first of them, and how many more."""
    more = [f"{len(names) - FEW} more"] if len(names) > FEW else []
    return between.join([*names[:FEW], *more])


def size_words(hypothesis: Hypothesis, finding: Finding) -> list[str]:
    """The fitted parameters with their intervals."""
    return [
        f"{parameter.name} {quantity(value, parameter.unit)} ({value_interval(least, most, parameter.unit)})"
        for parameter, value, least, most in zip(
            hypothesis.parameters, finding.values, finding.least, finding.most, strict=True
        )
        if isfinite(least)
    ]


def remains_words(one: Remains) -> str:
    """What remains in a group."""
    depends = f"it depends on {DEPENDS.get(one.depends_on, one.depends_on)}"
    if one.channel == "all":
        return "in all channels together, in none of them clearly"
    regime = "in all regimes" if one.regime == "all" else f"in regime {one.regime}"
    return f"in {channel_words(one.channel, one.place)}, {regime}, and {depends}"


def channel_words(channel: str, place: str) -> str:
    """A channel and where it is, unless its name says that."""
    return channel if channel.startswith(place) else f"{channel} at {place}"


def unexplained_sentence(result: Result) -> str:
    """Whether anything remains."""
    said = result.diagnosis
    odds = f"surprise {number(said.unexplained_surprise)}, let pass below {number(_limit(result))}"
    if not remains_unexplained(result):
        return f"No structure is seen in what remains ({odds})."
    if said.unexplained[0].surprise < said.unexplained_surprise:
        return f"One more hypothesis beside those found would explain more than chance does ({odds})."
    return f"Structure remains {remains_words(said.unexplained[0])} ({odds})."


def next_sentence(result: Result) -> str:
    """What to do next, in one sentence."""
    said = result.diagnosis
    if result.next_motion:
        best = result.next_motion[0]
        if best.separation < APART:
            return (
                f"No motion of this campaign would tell apart what cannot be told apart now: the best, "
                f"{best.name}, sets it {number(best.separation)} sigmas apart."
            )
        return (
            f"Record {best.name}: what cannot be told apart now ({number(best.now)} sigmas) it would set "
            f"{number(best.separation)} sigmas apart."
        )
    near = best_of(result)
    if near is not None:
        name, blocks = result.ready.found.hypotheses[near].name, result.ready.limits[near].blocks
        return f"Record more motions that would show {name}: these show it in {number(blocks)}, effectively."
    if doubted(result):
        return "Repeat the motions that show it: that makes it surer, or leaves something unexplained."
    if said.verdict == "unknown":
        return "Write an effect that would show so, and diagnose again with it in the catalogue."
    if result.notes:
        return f"See to what the audit says: {result.notes[0]}."
    if result.closure is None:
        return "Hold motion out, to see how far the gap shrinks."
    return "Nothing that this campaign could tell."


def percent(share: float) -> str:
    """Of 1."""
    return f"{100.0 * share:.0f} %"


def number(value: float) -> str:
    """Three digits; infinity in words."""
    return "beyond count" if value == inf else f"{value:.3g}"


def quantity(value: float, unit: str) -> str:
    """Three digits and the unit; a logarithm is told as the factor that it is."""
    if unit == FACTOR:
        return f"times {exp(value):.3g}"
    return f"{value:.3g}" if unit in ("", "1") else f"{value:.3g} {unit}"


def interval(least: float, most: float, without: str = "assumed") -> str:
    """A 90 % interval; in words why there is none, by default that the number was not fitted."""
    return f"{least:.3g} to {most:.3g}" if isfinite(least) and isfinite(most) else without


def value_interval(least: float, most: float, unit: str) -> str:
    """Of a parameter: of a logarithm, that of the factor that it is."""
    return interval(exp(least), exp(most)) if unit == FACTOR else interval(least, most)


def cell_interval(cell: Cell) -> str:
    """Of a ratio."""
    return interval(cell.least, cell.most, "one motion")


def _interval_percent(least: float, most: float) -> str:
    if not (isfinite(least) and isfinite(most)):
        return "(anything is possible)"
    return f"({100.0 * least:.0f} to {100.0 * most:.0f})"


def _limit(result: Result) -> float:
    limits = result.ready.thresholds
    return limits.unexplained if result.diagnosis.findings else limits.structure


def _switched_on(result: Result) -> str:
    verdict, count = result.diagnosis.verdict, len(result.diagnosis.findings)
    words = {"set": "what is named first", "unknown": "what comes nearest"}
    return words.get(verdict, "it" if count == 1 else "them")


def _causes(result: Result) -> str:
    ready, findings = result.ready, result.diagnosis.findings
    if len(findings) > 1:
        names = ", ".join(ready.found.hypotheses[one.hypothesis].name for one in findings)
        open_for = sum(bool(others(one)) for one in findings)
        rest = f"; others may stand in the stead of {open_for} of them" if open_for else ""
        return f"The gap has {len(findings)} causes: {names}{rest}."
    (finding,) = findings
    name = finding_words(ready, finding)
    if others(finding):
        return f"The cause of the gap is {name}."
    sure = percent(probability_of(finding.hypothesis, finding.alternatives))
    sizes = size_words(ready.found.hypotheses[finding.hypothesis], finding)
    return f"The cause of the gap is {name}, with probability {sure}{', '.join(['', *sizes])}."


def _none() -> str:
    return (
        "No effect is seen: all that differs from the simulator is within the floor and within what "
        "calibration leaves uncertain."
    )


def _seen(ready: Ready) -> str:
    seen = sum(one.limit <= 1.0 for one in ready.limits)
    return (
        f"Of {len(ready.limits)} hypotheses these motions would have shown {seen} at their typical size; "
        "smaller ones may be there."
    )


def _unknown(result: Result) -> str:
    said = result.diagnosis
    if doubted(result):
        return (
            f"{_nearest_names(result)} would explain the gap, but might as well imitate a cause outside the "
            "catalogue: no name is forced."
        )
    if not remains_unexplained(result):
        return "No effect of the catalogue explains the gap within its bounds."
    if said.unexplained[0].surprise < said.unexplained_surprise:
        return (
            "The gap is not explained: beside what comes nearest, one more hypothesis would explain more "
            "than chance does."
        )
    what = (
        "There is a gap that nothing in the catalogue surely explains"
        if best_of(result) is not None
        else "There is an effect that is not in the catalogue"
    )
    return f"{what}: {remains_words(said.unexplained[0])}."


def doubted(result: Result) -> bool:
    """Whether what was found explains all, within its bounds, and has no name for its odds alone."""
    said = result.diagnosis
    inside = bool(said.findings) and not any(one.at_bound for one in said.findings)
    return said.verdict == "unknown" and inside and not remains_unexplained(result)


def _nearest_names(result: Result) -> str:
    hypotheses = result.ready.found.hypotheses
    return " and ".join(hypotheses[one.hypothesis].name for one in result.diagnosis.findings)


def best_of(result: Result) -> int | None:
    """The best single hypothesis, if it explains more than chance does and yet was not chosen."""
    said = result.diagnosis
    surprising = said.surprise >= result.ready.thresholds.effect
    return said.ranking[0] if said.ranking and surprising and not said.findings else None


def _nearest(result: Result) -> str:
    said, ready = result.diagnosis, result.ready
    best = best_of(result)
    if best is not None:
        return (
            f"Nearest comes {ready.found.hypotheses[best].name}, which explains more than chance does but "
            "does not predict motions that it was not fitted to; no name is forced."
        )
    if not said.findings:
        return "None of the catalogue comes near it, and no name is forced."
    names = _nearest_names(result)
    bounds = [name for one in said.findings for name in one.at_bound]
    beyond = f", and would go beyond the bounds of {', '.join(bounds)}" if bounds else ""
    return f"Nearest comes {names}{beyond}; it is no name for it."
