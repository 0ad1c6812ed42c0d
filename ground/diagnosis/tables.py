"""A diagnosis printed for people: a screenful at most."""

from collections.abc import Iterator

from ground.diagnosis.result import Result
from ground.diagnosis.sentences import (
    FEW,
    cell_interval,
    channel_words,
    closure_sentence,
    next_sentence,
    percent,
    quantity,
    unexplained_sentence,
    value_interval,
    verdict_sentences,
)
from ground.diagnosis.told import others, probability_of
from ground.render.console import plain_console, pluralize


def gap_table(result: Result) -> None:
    """Print verdict, effects, where, how far, what remains, and what to do next."""
    console, said = plain_console(), result.diagnosis
    first, second = verdict_sentences(result)
    console.print(f"{said.verdict}: {first} {second}\n")
    if said.findings:
        for line in _effects(result):
            console.print(line)
        if len(said.findings) > 1:  # of one, the verdict says it
            for line in _beside(result):
                console.print(line)
    console.print("Where:")
    for cell in said.where[:FEW]:
        name = f"{channel_words(cell.channel, cell.place)}, {cell.regime}"
        console.print(f"  {name}: {cell.ratio:.1f} times the floor ({cell_interval(cell)})")
    if said.findings and second != closure_sentence(result):
        console.print(closure_sentence(result))
    console.print(unexplained_sentence(result))
    console.print(f"Next: {next_sentence(result)}")
    if result.notes:
        console.print(f"{pluralize(len(result.notes), 'note')} of the audit are on the page and in --json.")


def _effects(result: Result) -> Iterator[str]:
    """What was found, and its parameters below."""
    yield "Nearest, and no name:" if result.diagnosis.verdict == "unknown" else "Effects:"
    for finding in result.diagnosis.findings:
        sure = percent(probability_of(finding.hypothesis, finding.alternatives))
        hypothesis = result.ready.found.hypotheses[finding.hypothesis]
        yield f"  {hypothesis.name}: probability {sure}, own share {percent(finding.share)}"
        rows = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
        for parameter, value, least, most in rows:
            told = value_interval(least, most, parameter.unit)
            yield f"    {parameter.name}: {quantity(value, parameter.unit)} ({told})"


def _beside(result: Result) -> Iterator[str]:
    """How many are not told from a finding, and how many may stand in its stead."""
    for finding in result.diagnosis.findings:
        alike, rest = len(finding.confusable) - 1, len(others(finding))
        if alike or rest:
            own = result.ready.found.hypotheses[finding.hypothesis].name
            yield f"{own}: {alike} not told from it, {rest} that may stand in its stead"
