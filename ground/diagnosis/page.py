"""A diagnosis as a page: verdict, where, the race, before and after, what is unexplained, what to do next."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from ground.diagnosis.closure import Closure
from ground.diagnosis.diagnose import Finding
from ground.diagnosis.figures import closure_picture, race_picture, where_picture
from ground.diagnosis.result import Result
from ground.diagnosis.sentences import (
    cell_interval,
    channel_words,
    closure_sentence,
    doubted,
    next_sentence,
    number,
    percent,
    quantity,
    unexplained_sentence,
    value_interval,
    verdict_sentences,
)
from ground.diagnosis.told import MOST, others, probability_of, remains_unexplained
from ground.render.page import heading, image, paragraph, save_page, table

TITLES: Final = {
    "named": "The gap has a name",
    "set": "The gap has one of several names",
    "none": "No effect is seen",
    "unknown": "The gap is not in the catalogue",
}
DOUBTED: Final = "The gap has no sure name"
Rows = list[tuple[str, ...]]


def save_gap_page(result: Result, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: the file cannot be written.
    """
    parts = [
        paragraph(" ".join(verdict_sentences(result))),
        *_where(result),
        *_race(result),
        *_closure(result),
        *_unexplained(result),
        *_next(result),
        *_thresholds(result),
    ]
    title = DOUBTED if doubted(result) else TITLES[result.diagnosis.verdict]
    save_page(title, parts, path)


def _where(result: Result) -> Iterator[str]:
    cells = result.diagnosis.where
    yield heading("Where the gap is")
    yield paragraph(
        "Root mean square of measured less simulated, over what repeats differ by: 1 is the floor. What "
        "calibration leaves uncertain is fitted, and no effect is on."
    )
    yield image(where_picture(cells), "map of the gap: channels by regimes")
    rows = [
        (channel_words(one.channel, one.place), one.regime, str(one.features), f"{one.ratio:.2f}",
         cell_interval(one))
        for one in cells[:MOST]
    ]  # fmt: skip
    yield paragraph("The largest:")
    yield table(("channel", "regime", "features", "over the floor", "90 %"), rows)


def _race(result: Result) -> Iterator[str]:
    findings = result.diagnosis.findings
    yield heading("Which effect")
    if findings and result.diagnosis.verdict == "unknown":
        yield paragraph("What is chosen here comes nearest. It does not explain the gap, and is no name.")
    if findings:
        yield image(race_picture(result), "probabilities and sizes")
        head = ("effect", "parameter", "value", "90 %", "bounds", "probability", "own share")
        yield table(head, [row for finding in findings for row in _finding_rows(result, finding)])
        yield from _remarks(result)
    yield paragraph("The best as single hypotheses, best first, and from which size on each would be seen:")
    yield table(("hypothesis", "", "seen from"), _ranking_rows(result))


def _finding_rows(result: Result, finding: Finding) -> Rows:
    hypothesis = result.ready.found.hypotheses[finding.hypothesis]
    sure = percent(probability_of(finding.hypothesis, finding.alternatives))
    numbers = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
    return [
        (
            hypothesis.name,
            parameter.name,
            quantity(value, parameter.unit),
            value_interval(least, most, parameter.unit),
            value_interval(parameter.least, parameter.most, parameter.unit)
            + (", at one" if parameter.name in finding.at_bound else ""),
            sure,
            percent(finding.share),
        )
        for parameter, value, least, most in numbers
    ]


def _remarks(result: Result) -> Iterator[str]:
    """What is alike, and what may stand in another's stead."""
    names = [hypothesis.name for hypothesis in result.ready.found.hypotheses]
    for finding in result.diagnosis.findings:
        own, alike = names[finding.hypothesis], [names[one] for one in finding.confusable]
        if len(alike) > 1:
            yield paragraph(f"One to these motions, whatever their sizes: {', '.join(alike)}.")
        if rest := others(finding):
            said = ", ".join(f"{names[one]} ({percent(share)})" for one, share in rest)
            yield paragraph(f"In the stead of {own} may stand: {said}.")


def _ranking_rows(result: Result) -> Rows:
    ready, chosen = result.ready, {finding.hypothesis for finding in result.diagnosis.findings}
    alike = {one for finding in result.diagnosis.findings for one in finding.confusable}
    rows: Rows = []
    for one in result.diagnosis.ranking[:MOST]:
        hypothesis, limit = ready.found.hypotheses[one], ready.limits[one].limit
        role = "chosen" if one in chosen else "not told from it" if one in alike else ""
        seen = " and ".join(quantity(abs(limit * p.typical), p.unit) for p in hypothesis.sizes)
        rows.append((hypothesis.name, role, f"{seen} from neutral" if np.isfinite(limit) else "never"))
    return rows


def _closure(result: Result) -> Iterator[str]:
    found, tool = result.closure, result.tool
    yield heading("How far the gap shrinks")
    if not result.diagnosis.findings:
        yield paragraph("There is nothing to switch on, so it does not.")
    elif found is None:
        yield paragraph(closure_sentence(result))
    else:
        yield paragraph(closure_sentence(result))
        yield image(closure_picture(found), "before and after, channel by channel")
        yield table(("on held-out motion", "before", "after", "floor"), _closure_rows(found))
    if tool is not None and result.diagnosis.findings:
        rows = [("tool", *(f"{mm:.3g} mm" for mm in (tool.before_mm, tool.after_mm, tool.floor_mm)))]
        yield table(("at the tool", "before", "after", "floor"), rows)


def _closure_rows(found: Closure) -> Rows:
    rows: Rows = [
        (one.channel, *(quantity(value, one.unit) for value in (one.before, one.after, one.floor)))
        for one in found.channels
    ]
    return [*rows, ("what can be explained, over noise", number(found.before), number(found.after), "1")]


def _unexplained(result: Result) -> Iterator[str]:
    yield heading("What is still unexplained")
    yield paragraph(unexplained_sentence(result))
    if remains_unexplained(result):
        rows = [
            (channel_words(one.channel, one.place), one.regime, one.depends_on, number(one.surprise))
            for one in result.diagnosis.unexplained[:MOST]
        ]
        yield table(("channel", "regime", "depends on", "surprise"), rows)
    yield paragraph("Surprise is -log10 of the probability of as much if nothing were there.")


def _next(result: Result) -> Iterator[str]:
    yield heading("What to do next")
    yield paragraph(next_sentence(result))
    if result.next_motion:
        rows = [(one.name, number(one.now), number(one.separation)) for one in result.next_motion]
        yield table(("motion", "sigmas apart now", "with it"), rows)
    if result.notes:
        yield paragraph("What the audit of the logs said:")
        yield table(("note",), [(note,) for note in result.notes])
    if result.floor:
        yield paragraph("Where the floor is from:")
        yield table(("floor",), [(note,) for note in result.floor])


def _thresholds(result: Result) -> Iterator[str]:
    limits = result.ready.thresholds
    yield heading("How sure a verdict must be")
    known = percent(limits.disowned)
    strange = percent(limits.wrong) if np.isfinite(limits.wrong) else "nobody knows how many"
    rows = [
        (
            "an effect may be claimed from",
            number(limits.effect),
            f"{percent(limits.false_alarm)} of cases without any are called one, or unknown",
        ),
        ("without an effect, structure from", number(limits.structure), ""),
        (
            "beside effects, structure from",
            number(limits.unexplained),
            f"{known} of those rightly chosen get no name, {strange} of {limits.strangers} strangers get one",
        ),
    ]
    yield table(("", "surprise", f"on {limits.cases} simulated cases of this campaign"), rows)
