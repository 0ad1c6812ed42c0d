"""A target for fuzzers: any bytes as mapping and table; a sentence of ours, or a log that reads back."""

import io
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Final

from ground.imports.errors import BadImport
from ground.imports.job import imported
from ground.telemetry.read import read_log
from ground.telemetry.table_log import write_table_log

BETWEEN: Final = b"\n#---\n"
"""What stands between the mapping and the table."""
CELLS: Final = 50_000
NOWHERE: Final = "/nowhere/m.toml"
"""So that no path of a mapping leads to a file."""


def import_once(data: bytes) -> bool:
    """Import these bytes; whether they made a log. Anything raised is a bug."""
    mapping, _, table = data.partition(BETWEEN)
    name = "t.parquet" if table.startswith(b"PAR1") else "t.csv"
    try:
        made = imported(table, name, mapping, NOWHERE, cells=CELLS)
    except BadImport:
        return False
    file = io.BytesIO()
    write_table_log(file, made.header, made.series, made.commands)
    with NamedTemporaryFile(suffix=".mcap") as kept:
        kept.write(file.getvalue())
        kept.flush()
        log = read_log(Path(kept.name))
    for one in made.series:
        assert log[one.topic].tobytes() == one.data.tobytes()
    return True
