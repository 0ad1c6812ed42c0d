"""HTML page of a diagnosis: verdict, residual map, effects, closure, lack of fit, next motion, thresholds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from ground.diagnosis.closure import Closure
from ground.diagnosis.diagnose import Finding
from ground.diagnosis.figures import amplitude_figure, closure_figure, probability_figure, residual_map_figure
from ground.diagnosis.result import (
    MAX_LISTED,
    DiagnosisResult,
    has_lack_of_fit,
    list_alternatives,
    probability_of,
)
from ground.diagnosis.sentences import (
    channel_words,
    closure_sentence,
    format_cell_interval,
    format_number,
    format_percent,
    format_quantity,
    format_value_interval,
    is_doubtful,
    lack_of_fit_limit,
    next_sentence,
    unexplained_sentence,
    verdict_sentences,
)
from ground.render.page import Origin, Requirement, figures, heading, paragraph, save_page, table

TITLES: Final = {
    "named": "The gap has a name",
    "set": "The gap has one of several names",
    "none": "No effect is seen",
    "unknown": "The gap is not in the catalogue",
}
DOUBTFUL_TITLE: Final = "The gap has no sure name"
Rows = list[tuple[str, ...]]


def save_diagnosis_page(result: DiagnosisResult, origin: Origin, path: Path) -> None:
    """Write the page.

    Args:
        result: Diagnosis.
        origin: Command and digests.
        path: The HTML file.

    Raises:
        BadOutput: The file cannot be written.
    """
    parts = [
        *_residual_section(result),
        *_effect_section(result),
        *_closure_section(result),
        *_lack_of_fit_section(result),
        *_next_section(result),
        *_threshold_section(result),
    ]
    title = DOUBTFUL_TITLE if is_doubtful(result) else TITLES[result.diagnosis.verdict]
    save_page(title, " ".join(verdict_sentences(result)), list_requirements(result), origin, parts, path)


def list_requirements(result: DiagnosisResult) -> list[Requirement]:
    """List the conditions of a verdict that names a cause, or says that there is none."""
    diagnosis, limits = result.diagnosis, result.model.thresholds
    rows = [
        Requirement(
            "one cause is named, or no effect is seen",
            "named or none",
            diagnosis.verdict,
            {"named": True, "none": True, "set": None, "unknown": False}[diagnosis.verdict],
        ),
        Requirement(
            "the residual has no structure, -log10 p",
            f"below {format_number(lack_of_fit_limit(result))}",
            format_number(diagnosis.unexplained_neg_log10_p),
            not has_lack_of_fit(result),
        ),
    ]
    if diagnosis.findings and np.isfinite(diagnosis.log_odds):
        least = limits.confidence.least
        rows.append(
            Requirement(
                "log-odds that the effects are the cause",
                f"{format_number(least)} or more",
                format_number(diagnosis.log_odds),
                bool(diagnosis.log_odds >= least),
            )
        )
    if result.closure is None:
        rows.append(Requirement("the gap shrinks on held-out motion", "", "nothing was held out", None))
    return rows


def _residual_section(result: DiagnosisResult) -> Iterator[str]:
    cells = result.diagnosis.residual_map
    yield heading("Where the gap is")
    yield paragraph(
        "Root mean square of measured less simulated, over the noise floor between repeats: 1 means only "
        "noise. The nuisance parameters are fitted, and no effect is on."
    )
    yield figures(residual_map_figure(cells))
    rows = [
        (channel_words(one.channel, one.place), one.regime, str(one.features), f"{one.ratio:.2f}",
         format_cell_interval(one))
        for one in cells[:MAX_LISTED]
    ]  # fmt: skip
    yield paragraph("The largest:")
    yield table(("channel", "regime", "features", "over the floor", "90 %"), rows)


def _effect_section(result: DiagnosisResult) -> Iterator[str]:
    findings = result.diagnosis.findings
    yield heading("Which effect")
    if findings and result.diagnosis.verdict == "unknown":
        yield paragraph(
            "The effects here are the nearest. They do not explain the gap, so no cause is named."
        )
    if findings:
        yield figures(probability_figure(result), amplitude_figure(result))
        head = ("effect", "parameter", "value", "90 %", "bounds", "probability", "own share")
        yield table(head, [row for finding in findings for row in _finding_rows(result, finding)])
        yield from _remarks(result)
    yield paragraph("The best as single hypotheses, best first, and from which size on each would be seen:")
    yield table(("hypothesis", "", "seen from"), _ranking_rows(result))


def _finding_rows(result: DiagnosisResult, finding: Finding) -> Rows:
    hypothesis = result.model.sensitivities.hypotheses[finding.hypothesis]
    sure = format_percent(probability_of(finding.hypothesis, finding.alternatives))
    numbers = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
    return [
        (
            hypothesis.name,
            parameter.name,
            format_quantity(value, parameter.unit),
            format_value_interval(least, most, parameter.unit),
            format_value_interval(parameter.least, parameter.most, parameter.unit)
            + (", at one" if parameter.name in finding.at_bound else ""),
            sure,
            format_percent(finding.share),
        )
        for parameter, value, least, most in numbers
    ]


def _remarks(result: DiagnosisResult) -> Iterator[str]:
    """Yield the aliases and the alternatives of each finding."""
    names = [hypothesis.name for hypothesis in result.model.sensitivities.hypotheses]
    for finding in result.diagnosis.findings:
        own, alike = names[finding.hypothesis], [names[one] for one in finding.equivalence_class]
        if len(alike) > 1:
            yield paragraph(f"These motions cannot distinguish: {', '.join(alike)}.")
        if rest := list_alternatives(finding):
            named = ", ".join(f"{names[one]} ({format_percent(share)})" for one, share in rest)
            yield paragraph(f"Alternatives to {own}: {named}.")


def _ranking_rows(result: DiagnosisResult) -> Rows:
    model, chosen = result.model, {finding.hypothesis for finding in result.diagnosis.findings}
    alike = {one for finding in result.diagnosis.findings for one in finding.equivalence_class}
    rows: Rows = []
    for one in result.diagnosis.ranking[:MAX_LISTED]:
        hypothesis, limit = model.sensitivities.hypotheses[one], model.limits[one].limit
        role = "chosen" if one in chosen else "alias" if one in alike else ""
        seen = " and ".join(format_quantity(abs(limit * p.typical), p.unit) for p in hypothesis.amplitudes)
        rows.append((hypothesis.name, role, f"{seen} from neutral" if np.isfinite(limit) else "never"))
    return rows


def _closure_section(result: DiagnosisResult) -> Iterator[str]:
    found, tool = result.closure, result.tool
    yield heading("How far the gap shrinks")
    if not result.diagnosis.findings:
        yield paragraph("No effect was found, so it does not shrink.")
    elif found is None:
        yield paragraph(closure_sentence(result))
    else:
        yield paragraph(closure_sentence(result))
        yield figures(closure_figure(found))
        yield table(("on held-out motion", "before", "after", "floor"), _closure_rows(found))
    if tool is not None and result.diagnosis.findings:
        rows = [("tool", *(f"{mm:.3g} mm" for mm in (tool.before_mm, tool.after_mm, tool.noise_floor_mm)))]
        yield table(("at the tool", "before", "after", "floor"), rows)


def _closure_rows(found: Closure) -> Rows:
    rows: Rows = [
        (
            one.channel,
            *(format_quantity(value, one.unit) for value in (one.before, one.after, one.noise_floor)),
        )
        for one in found.channels
    ]
    return [
        *rows,
        ("what can be explained, over noise", format_number(found.before), format_number(found.after), "1"),
    ]


def _lack_of_fit_section(result: DiagnosisResult) -> Iterator[str]:
    yield heading("What is still unexplained")
    yield paragraph(unexplained_sentence(result))
    if has_lack_of_fit(result):
        rows = [
            (
                channel_words(one.channel, one.place),
                one.regime,
                one.depends_on,
                format_number(one.neg_log10_p),
            )
            for one in result.diagnosis.unexplained[:MAX_LISTED]
        ]
        yield table(("channel", "regime", "depends on", "-log10 p"), rows)
    yield paragraph("p is the probability of as much without structure.")


def _next_section(result: DiagnosisResult) -> Iterator[str]:
    yield heading("What to do next")
    yield paragraph(next_sentence(result))
    if result.next_motion:
        rows = [
            (one.name, format_number(one.separation_now), format_number(one.separation))
            for one in result.next_motion
        ]
        yield table(("motion", "sigmas apart now", "with it"), rows)
    if result.notes:
        yield paragraph("Notes of the audit:")
        yield table(("note",), [(note,) for note in result.notes])
    if result.noise_floor:
        yield paragraph("Origin of the noise floor:")
        yield table(("floor",), [(note,) for note in result.noise_floor])


def _threshold_section(result: DiagnosisResult) -> Iterator[str]:
    limits = result.model.thresholds
    yield heading("How sure a verdict must be")
    known = format_percent(limits.withheld)
    wrong = format_percent(limits.wrong_names) if np.isfinite(limits.wrong_names) else "an unknown share"
    rows = [
        (
            "an effect may be claimed from",
            format_number(limits.effect),
            f"{format_percent(limits.false_alarm)} of cases without any are called one, or unknown",
        ),
        ("without an effect, structure from", format_number(limits.structure), ""),
        (
            "beside effects, structure from",
            format_number(limits.unexplained),
            f"{known} of correct choices get no name, "
            f"{wrong} of {limits.left_out_cases} left-out effects get one",
        ),
    ]
    yield table(("", "-log10 p", f"on {limits.cases} simulated cases of this campaign"), rows)
