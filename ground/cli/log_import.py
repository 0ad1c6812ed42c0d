"""The verb `log import`; thin."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import BAD_INPUT, JsonOption, end, show


def import_log(
    table: Annotated[
        Path, typer.Argument(help="Telemetry as .parquet, .csv, .tsv or .txt.", metavar="TABLE")
    ],
    mapping: Annotated[
        Path, typer.Argument(help="Which columns are which channels.", metavar="MAPPING.toml")
    ],
    log: Annotated[Path, typer.Argument(help="The log; what was there is replaced.", metavar="OUT.mcap")],
    as_json: JsonOption = False,
) -> None:
    """Read someone else's telemetry, a table with named columns, into a log like ours.

    docs/import.md says how a mapping is written. Nothing is made up: a channel that is not mapped is not in
    the log, and a packet that lacks a field is kept under /imported/ with those that it has.

    Example: marsarm log import arm.csv arm.toml arm.mcap
    """
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest
    from ground.telemetry.imports.job import ImportRequest, import_json, import_table, import_tables

    try:
        with progress_bar() as progress:
            report = import_table(ImportRequest(table, mapping, log), progress)
    except BadRequest as error:
        end(str(error), BAD_INPUT, as_json)
    show(import_json(report), as_json, lambda: import_tables(report))
