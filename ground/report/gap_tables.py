"""A diagnosis printed for people: a screenful at most."""

from collections.abc import Iterator

from rich.table import Table

from ground.gap.result import Result
from ground.gap.told import others, probability_of
from ground.report.console import plain_console
from ground.report.gap_words import (
    FEW,
    alternatives_words,
    cell_interval,
    channel_words,
    closure_sentence,
    interval,
    listed,
    next_sentence,
    percent,
    quantity,
    unexplained_sentence,
    verdict_sentences,
)
from ground.report.words import counted


def gap_table(result: Result) -> None:
    """Print verdict, effects, where, how far, what remains, and what to do next."""
    console, said = plain_console(), result.diagnosis
    first, second = verdict_sentences(result)
    console.print(f"{said.verdict}: {first} {second}\n")
    if said.findings:
        console.print(_effects(result))
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
        console.print(f"{counted(len(result.notes), 'note')} of the audit are on the page and in --json.")


def _effects(result: Result) -> Table:
    table = Table(title_justify="left", box=None, pad_edge=False)
    if result.diagnosis.verdict == "unknown":
        table.title = "Nearest, and no name"
    for name in ("effect", "parameter", "value", "90 %", "probability", "own share"):
        table.add_column(name, justify="left" if name in ("effect", "parameter") else "right", no_wrap=True)
    for finding in result.diagnosis.findings:
        sure = percent(probability_of(finding.hypothesis, finding.alternatives))
        hypothesis = result.ready.found.hypotheses[finding.hypothesis]
        rows = zip(hypothesis.parameters, finding.values, finding.least, finding.most, strict=True)
        first = (hypothesis.name, sure, percent(finding.share))
        for parameter, value, least, most in rows:
            name, probability, share = first
            table.add_row(
                name,
                parameter.name,
                quantity(value, parameter.unit),
                interval(least, most),
                probability,
                share,
            )
            first = ("", "", "")
    return table


def _beside(result: Result) -> Iterator[str]:
    """What is not told from a finding, and what may stand in its stead."""
    names = [hypothesis.name for hypothesis in result.ready.found.hypotheses]
    for finding in result.diagnosis.findings:
        own = names[finding.hypothesis]
        alike = [names[one] for one in finding.confusable if one != finding.hypothesis]
        if alike:
            yield f"Not told from {own}: {listed(alike)}"
        if others(finding):
            yield f"Or, for {own}: {alternatives_words(result.ready, finding)}"
