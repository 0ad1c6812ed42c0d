"""What was imported as a table for people and as a document for programs."""

from dataclasses import asdict
from typing import Any

from rich.table import Table

from ground.render.console import plain_console
from ground.render.words import counted
from ground.telemetry.imports.job import ImportReport, duration_s


def import_json(report: ImportReport) -> dict[str, Any]:
    """An import as a JSON document."""
    return {
        "log": str(report.request.log),
        "rows": report.rows,
        "rows_moved": report.rows_moved,
        "topics": [{**asdict(topic), "duration_s": duration_s(topic)} for topic in report.topics],
        "commands": report.commands,
        "incomplete": [asdict(one) for one in report.lacking],
        "replayable": report.replayable,
    }


def import_tables(report: ImportReport) -> None:
    """Print an import: a row for each topic, and what keeps packets from being whole."""
    console = plain_console()
    table = Table(title=f"{report.request.log}: {counted(report.rows, 'row')}", title_justify="left")
    for name in ("topic", "messages", "first tick", "last tick", "ticks without"):
        table.add_column(name, justify="left" if name == "topic" else "right")
    for topic in report.topics:
        numbers = (topic.messages, topic.first_tick, topic.last_tick, topic.missing_ticks)
        table.add_row(topic.topic, *map(str, numbers))
    console.print(table)
    if report.rows_moved:
        console.print(f"sorted    in {counted(report.rows_moved, 'place')} the file was not in order of time")
    for one in report.lacking:
        lacks = ", ".join(one.fields)
        console.print(f"{one.topic} is not whole, so it is kept as {one.kept_as}; it lacks {lacks}")
    if report.replayable:
        console.print(
            f"replay    {counted(report.commands, 'command')}; `marsarm replay {report.request.log}`"
        )
    else:
        console.print("replay    no: the mapping does not say what flight software began with")
