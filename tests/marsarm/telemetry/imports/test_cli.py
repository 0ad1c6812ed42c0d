"""`marsarm log import` as a user runs it."""

import io
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from marsarm.cli.app import app
from marsarm.telemetry.imports.targets import ChannelTarget, known_targets
from marsarm.telemetry.read import read_log

MAPPING = """[time]
rate_Hz = 64
[[channel]]
name = "/sensors.current_A"
columns = ["a", "b", "c", "d", "e"]
unit = "mA"
"""


def channel(target: ChannelTarget) -> str:
    """Return the part of a mapping that takes a flight channel from columns of the same name."""
    columns = [f"{target.name}.{k}" for k in range(target.size)]
    return f'[[channel]]\nname = "{target.name}"\ncolumns = {json.dumps(columns)}\nunit = "{target.unit}"\n'


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    sink = io.BytesIO()
    parquet.write_table(pa.table({name: np.arange(3.0) for name in "abcde"}), sink)
    (tmp_path / "t.parquet").write_bytes(sink.getvalue())
    (tmp_path / "m.toml").write_text(MAPPING)
    return ["log", "import", *(str(tmp_path / name) for name in ("t.parquet", "m.toml", "out.mcap"))]


def test_the_document_says_what_was_made_and_what_it_lacks(words: list[str]) -> None:
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert (report["rows"], report["replayable"], report["commands"]) == (3, False, 0)
    assert [(t["topic"], t["messages"], t["missing_ticks"]) for t in report["topics"]] == [
        ("/imported/sensors", 3, 0)
    ]
    assert "gravity_R_m_s2" in report["incomplete"][0]["fields"]
    assert read_log(report["log"])["/imported/sensors"]["current_A"][2] == pytest.approx([2e-3] * 5)


def test_people_read_why_a_packet_is_not_whole(words: list[str]) -> None:
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0
    output = " ".join(result.output.split())
    assert "/sensors is incomplete, so it is kept as /imported/sensors; it lacks cycle" in output


def test_one_is_counted_as_one(words: list[str], tmp_path: Path) -> None:
    sensors = [one for name, one in known_targets().items() if name.startswith("/sensors.")]
    (tmp_path / "m.toml").write_text(
        "[time]\nrate_Hz = 64\n"
        + "".join(map(channel, sensors))
        + '[start]\nmode = "stowed"\n[[command]]\ntype = "STOP"\nat_s = 0\n'
    )
    table = pa.table({f"{one.name}.{k}": [0.0] for one in sensors for k in range(one.size)})
    parquet.write_table(table, tmp_path / "t.parquet")
    output = "".join(
        CliRunner().invoke(app, words).output.split()
    )  # line breaks depend on the length of the path
    assert "cap:1row┏" in output
    assert "replay1command;`marsarmreplay" in output


def test_what_is_wrong_is_in_the_document(words: list[str], tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MAPPING.replace("mA", "mm"))
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 2
    assert "m.toml: channel[1].unit: 'mm' does not fit" in json.loads(result.stdout)["error"]
