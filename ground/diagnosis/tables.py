"""Console output of a diagnosis, at most a screenful."""

from collections.abc import Iterator

from ground.diagnosis.result import DiagnosisResult, list_alternatives, probability_of
from ground.diagnosis.sentences import (
    MAX_NAMES,
    channel_words,
    closure_sentence,
    format_cell_interval,
    format_percent,
    format_quantity,
    format_value_interval,
    next_sentence,
    unexplained_sentence,
    verdict_sentences,
)
from ground.render.console import plain_console, pluralize


def print_diagnosis(result: DiagnosisResult) -> None:
    """Print verdict, effects, residual map, closure, lack of fit, and the next step."""
    console, diagnosis = plain_console(), result.diagnosis
    first, second = verdict_sentences(result)
    console.print(f"{diagnosis.verdict}: {first} {second}\n")
    if diagnosis.findings:
        for line in _effect_lines(result):
            console.print(line)
        if len(diagnosis.findings) > 1:  # for one finding, the verdict contains them
            for line in _alternative_lines(result):
                console.print(line)
    console.print("Where:")
    for cell in diagnosis.residual_map[:MAX_NAMES]:
        name = f"{channel_words(cell.channel, cell.place)}, {cell.regime}"
        console.print(f"  {name}: {cell.ratio:.1f} times the floor ({format_cell_interval(cell)})")
    if diagnosis.findings and second != closure_sentence(result):
        console.print(closure_sentence(result))
    console.print(unexplained_sentence(result))
    console.print(f"Next: {next_sentence(result)}")
    if result.notes:
        console.print(f"{pluralize(len(result.notes), 'note')} of the audit are on the page and in --json.")


def _effect_lines(result: DiagnosisResult) -> Iterator[str]:
    """Yield the findings with their parameters."""
    yield "Nearest, not named:" if result.diagnosis.verdict == "unknown" else "Effects:"
    for finding in result.diagnosis.findings:
        sure = format_percent(probability_of(finding.hypothesis, finding.alternatives))
        hypothesis = result.model.sensitivities.hypotheses[finding.hypothesis]
        yield f"  {hypothesis.name}: probability {sure}, own share {format_percent(finding.share)}"
        rows = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
        for parameter, value, least, most in rows:
            interval = format_value_interval(least, most, parameter.unit)
            yield f"    {parameter.name}: {format_quantity(value, parameter.unit)} ({interval})"


def _alternative_lines(result: DiagnosisResult) -> Iterator[str]:
    """Yield the number of aliases and of alternatives of each finding."""
    for finding in result.diagnosis.findings:
        alike, rest = len(finding.equivalence_class) - 1, len(list_alternatives(finding))
        if alike or rest:
            own = result.model.sensitivities.hypotheses[finding.hypothesis].name
            yield f"{own}: {alike} aliases, {rest} alternatives"
