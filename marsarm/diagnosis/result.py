"""Result of a diagnosis: its document for JSON, and the sentences of its page and of the console.

NaN and infinity become None in the document.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import expm1, inf, isfinite
from typing import Any, Final

from marsarm.diagnosis.closure import CandidateMotion, Closure
from marsarm.diagnosis.diagnose import MAX_MEMBERS, Diagnosis, Finding, LackOfFit, ResidualCell
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.problem import LOG_UNIT, Hypothesis
from simgap import Trace
from simgap.common import report
from simgap.common.console import plain_console, pluralize

MAX_LISTED: Final = 10
"""Number of groups with structure in the output."""

MIN_SEPARATION: Final = 1.0
"""Separation in sigmas from which on a motion is worth recording."""

IF_LISTED: Final = "If the cause is in the catalogue, it is"

DEPENDS: Final = {"nothing": "a constant offset", "noise": "no condition, as if it were noise"}


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
    diagnosis, tool = result.diagnosis, result.tool
    document: dict[str, Any] = report.to_json({
        "verdict": diagnosis.verdict,
        "effects": [_finding_json(result, finding) for finding in diagnosis.findings],
        "residual_map": diagnosis.residual_map,
        "closure": result.closure,
        "next_motion": result.next_motion,
        "unexplained": {
            "has_remainder": diagnosis.has_remainder,
            "neg_log10_p": diagnosis.unexplained[0].neg_log10_p,
            "limit": result.model.lack_of_fit_limit,
            "groups": diagnosis.unexplained[:MAX_LISTED],
        },
        "tool_mm": tool and {name.removesuffix("_mm"): mm for name, mm in asdict(tool).items()},
        "notes": result.notes,
        "noise_floor": result.noise_floor,
    })  # fmt: skip
    return document


def _finding_json(result: DiagnosisResult, finding: Finding) -> dict[str, Any]:
    hypothesis, limit = result.hypothesis(finding.hypothesis), result.model.limits[finding.hypothesis]
    numbers = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)

    def named(index: int) -> dict[str, str]:
        one = result.hypothesis(index)
        return {"name": one.effect, "place": one.place}

    return {
        **named(finding.hypothesis),
        "family": result.model.families[finding.hypothesis],
        "level": finding.level,
        "places": finding.places,
        "families": finding.families,
        "effects": [named(one) for one in finding.effects],
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "is_amplitude": parameter.is_amplitude,
                "value": value,
                "least": least,
                "most": most,
                "seen_from": limit.limit * abs(parameter.typical),
                "named_from": limit.family_wise_limit * abs(parameter.typical),
            }
            for parameter, value, least, most in numbers
        ],
        "share": finding.share,
        "alternatives": [{**named(one.hypothesis), "p": one.p} for one in finding.alternatives[1:]],
        "aliases": [named(one) for one in finding.equivalence_class if one != finding.hypothesis],
    }


def verdict_lines(result: DiagnosisResult) -> tuple[tuple[str, str], ...]:
    """Return four lines: where the gap is, its cause, how far it shrinks, and what to record next."""
    return (
        ("Where", where_sentence(result)),
        ("What", what_sentence(result)),
        ("How far", closure_sentence(result)),
        ("Next", next_sentence(result)),
    )


def where_sentence(result: DiagnosisResult) -> str:
    """Return the places of the findings; without one, that of what remains."""
    diagnosis = result.diagnosis
    if diagnosis.findings:
        places = [join_names(one.places, " or ") or "not located" for one in diagnosis.findings]
        largest = diagnosis.residual_map[0]
        return (
            f"{'; '.join(dict.fromkeys(places))}. The largest residual is {largest.ratio:.1f} times the "
            f"noise, in {channel_words(largest.channel, largest.place)}."
        )
    if diagnosis.has_remainder:
        return f"Something remains {lack_of_fit_words(diagnosis.unexplained[0])}."
    return "Nowhere: all differences are within the noise and the uncertainty of the calibration."


def what_sentence(result: DiagnosisResult) -> str:
    """Return the causes at the level at which they are known, and how sure that is."""
    diagnosis = result.diagnosis
    if diagnosis.findings:
        found = " ".join(finding_sentence(result, finding) for finding in diagnosis.findings)
        if not diagnosis.has_remainder:
            return found
        return f"{found} More remains {lack_of_fit_words(diagnosis.unexplained[0])}."
    if diagnosis.has_remainder:
        return "No effect of the catalogue explains it, so no cause is named."
    seen = sum(one.family_wise_limit <= 1.0 for one in result.model.limits)
    return (
        f"No effect is seen. These motions would show {seen} of {len(result.model.limits)} hypotheses at "
        "their typical size; smaller effects may exist."
    )


def finding_sentence(result: DiagnosisResult, finding: Finding) -> str:
    """Return what is known of one cause: 95 % of the sets of a level hold it, if it is in the catalogue."""
    names = [result.hypothesis(one.hypothesis).name for one in finding.alternatives]
    own = name_with_aliases(result, finding)
    sizes = ", ".join(size_words(result.hypothesis(finding.hypothesis), finding))
    families = join_names([str(one) for one in finding.families], " or ")
    if finding.level == "size":
        return f"{IF_LISTED} {own}: {sizes}. All other effects in it are excluded at 95 %."
    if finding.level == "effect":
        return (
            f"{IF_LISTED} one of {len(names)} effects: {own} ({sizes}), or {join_names(names[1:], ' or ')}."
        )
    if finding.level == "family":
        return f"{IF_LISTED} of the family {families}; the best of {len(names)} effects is {own}."
    if finding.level == "place":
        return (
            f"The cause is at {join_names(finding.places, ' or ')}, and may be outside the catalogue. "
            f"In these motions it acts like {own} ({sizes})."
        )
    others = f", as would {len(names) - 1} others" if names[1:] else ""
    return f"A cause is not located: {own} would explain a part of the gap{others}."


def name_with_aliases(result: DiagnosisResult, finding: Finding) -> str:
    """Return the name of a finding, with the effects that these motions cannot distinguish from it."""
    own = result.hypothesis(finding.hypothesis).name
    alike = [result.hypothesis(one).name for one in finding.equivalence_class if one != finding.hypothesis]
    return f"{own} (or {join_names(alike, ' or ')}, which is the same here)" if alike else own


def closure_sentence(result: DiagnosisResult) -> str:
    """Return the share of the explainable residual that the findings remove."""
    found, tool = result.closure, result.tool
    if not result.diagnosis.findings:
        return "No effect is switched on, so no gap shrinks."
    if found is None:
        return "No motion was held out that an arm with these effects can do, so no share is given."
    if not isfinite(found.share):
        return "On held-out motion the gap is hardly above the noise, so no share is given."
    at_tool = "" if tool is None else f"; at the tool {tool.before_mm:.2g} mm become {tool.after_mm:.2g}"
    # noise of held-out motion can make the share more than 1
    closed = "all" if found.share >= 1.0 else format_percent(found.share)
    interval = _format_percent_interval(found.least, found.most)
    return f"On held-out motion {closed} of the explainable gap closes {interval}{at_tool}."


def join_names(names: Sequence[str], between: str = ", ") -> str:
    """Join the first names, and the number of others."""
    more = [f"{len(names) - MAX_MEMBERS} more"] if len(names) > MAX_MEMBERS else []
    return between.join([*names[:MAX_MEMBERS], *more])


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
    largest = result.diagnosis.unexplained[0]
    odds = (
        f"-log10 p {format_number(largest.neg_log10_p)}, "
        f"limit {format_number(result.model.lack_of_fit_limit)}"
    )
    if not result.diagnosis.has_remainder:
        return f"The residual shows no structure ({odds})."
    return f"Structure remains {lack_of_fit_words(largest)} ({odds})."


def next_sentence(result: DiagnosisResult) -> str:
    """Return the recommended next step."""
    diagnosis = result.diagnosis
    if result.next_motion:
        best = result.next_motion[0]
        if best.separation < MIN_SEPARATION:
            return (
                "No motion of this campaign would distinguish the possible causes: the best, "
                f"{best.name}, separates them by less than {MIN_SEPARATION:.0f} sigma."
            )
        return (
            f"Record {best.name}: it would separate the possible causes by "
            f"{format_number(best.separation)} sigmas (now {format_number(best.separation_now)})."
        )
    if diagnosis.has_remainder:
        return "Repeat the motions that show what remains, and add an effect that would cause it."
    if any(one.level == "place" for one in diagnosis.findings):
        return "Repeat the motions that show it: they confirm the effect, or reveal that something remains."
    if result.notes:
        return f"Resolve the note of the audit: {result.notes[0]}."
    if diagnosis.findings and result.closure is None:
        return "Hold out motion, to measure how far the gap shrinks."
    return "Nothing: this campaign cannot show more."


def format_percent(share: float) -> str:
    """Format a share as a percentage."""
    return f"{100.0 * share:.0f} %"


def format_number(value: float) -> str:
    """Format a number with three digits, infinity as words."""
    return "infinite" if value == inf else f"{value:.3g}"


def format_quantity(value: float, unit: str) -> str:
    """Format a number with three digits and its unit; the logarithm of a factor becomes percent."""
    if unit == LOG_UNIT:
        return f"{_format_change(value)} %"
    return f"{value:.3g}" if unit in ("", "1") else f"{value:.3g} {unit}"


def format_interval(least: float, most: float, without: str = "assumed") -> str:
    """Format a 90 % interval; `without` says why there is none."""
    return f"{least:.3g} to {most:.3g}" if isfinite(least) and isfinite(most) else without


def format_value_interval(least: float, most: float, unit: str) -> str:
    """Format the interval of a parameter; the logarithm of a factor becomes a change in percent."""
    if unit == LOG_UNIT and isfinite(least) and isfinite(most):
        return f"{_format_change(least)} to {_format_change(most)} %"
    return format_interval(least, most)


def _format_change(logarithm: float) -> str:
    """Format the change in percent by a factor, with its sign, from the logarithm of the factor."""
    return f"{100.0 * expm1(logarithm):+.3g}"


def format_cell_interval(cell: ResidualCell) -> str:
    """Format the interval of a residual ratio."""
    return format_interval(cell.least, cell.most, "one motion")


def _format_percent_interval(least: float, most: float) -> str:
    if not (isfinite(least) and isfinite(most)):
        return "(anything is possible)"
    return f"({100.0 * least:.0f} to {100.0 * most:.0f} %)"


def print_diagnosis(result: DiagnosisResult) -> None:
    """Print where the gap is, its cause, how far it shrinks, and what to record next."""
    console = plain_console()
    for label, text in verdict_lines(result):
        console.print(f"{label + ':':<9}{text}")
    if result.notes:
        console.print(f"{pluralize(len(result.notes), 'note')} of the audit are on the page and in --json.")
