"""Refusal of wrong tables and mappings; each message names the place and the remedy."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from marsarm.cli.app import app
from marsarm.telemetry.imports import job
from marsarm.telemetry.imports.files import BadImport
from marsarm.telemetry.imports.job import convert_table

TIME = '[time]\ncolumn = "t"\nunit = "s"\n'
CURRENT = '[[channel]]\nname = "/sensors.current_A"\ncolumns = ["a", "b", "c", "d", "e"]\nunit = "A"\n'
FREE = '[[channel]]\nname = "/imported/arm.speed_m_s"\ncolumns = "a"\nunit = "m/s"\n'


def table(t: Any = (0.0, 1 / 64, 2 / 64), **changed: Any) -> bytes:
    """Return three rows of five currents; a column that is None is left out."""
    columns = {"t": t} | {name: [0.1 * k, 0.2, 0.3] for k, name in enumerate("abcde")} | changed
    sink = io.BytesIO()
    parquet.write_table(pa.table({k: v for k, v in columns.items() if v is not None}), sink)
    return sink.getvalue()


def refusal(mapping: str, data: bytes, name: str = "t.parquet") -> str:
    with pytest.raises(BadImport) as caught:
        convert_table(data, name, mapping.encode(), "m.toml")
    return str(caught.value)


def text(*lines: str) -> bytes:
    return "\n".join(lines).encode()


MAPPINGS = {
    "torn": ("[time\n", "m.toml: is not TOML"),
    "unknown table": (TIME + CURRENT + "[times]\n", "times: is not known here; did you mean time?"),
    "unknown key": (
        TIME + "colum = 1\n" + CURRENT,
        "m.toml: time.colum: is not known here; did you mean column?",
    ),
    "no time": (CURRENT, "time: give column and unit, or rate_Hz"),
    "two times": (TIME + "rate_Hz = 64\n" + CURRENT, "one of the two"),
    "unit and format": (TIME + 'format = "%s"\n' + CURRENT, "unit is of numbers, format of text"),
    "time unit": (
        TIME.replace('"s"', '"sec"') + CURRENT,
        "m.toml: time.unit: 'sec' is not known; there are s, ms, us, ns",
    ),
    "grid": (TIME + 'grid = "nearst"\n' + CURRENT, "did you mean nearest?"),
    "first tick": (TIME + "first_tick = -1\n" + CURRENT, "first_tick -1 is outside 0 .. 549755813888"),
    "no channel": (TIME, "channel: is missing; write [[channel]]"),
    "unknown channel": (
        TIME + CURRENT.replace("current_A", "curent_A"),
        "m.toml: channel[1].name: '/sensors.curent_A' is not known; did you mean /sensors.current_A?",
    ),
    "unknown topic": (TIME + FREE.replace("/imported/arm", "/arm"), "write /imported/NAME.FIELD"),
    "no unit": (
        TIME + CURRENT.replace('unit = "A"\n', ""),
        "unit: is missing; there are A, mA, uA; /sensors.current_A is kept in A",
    ),
    "wrong unit": (TIME + CURRENT.replace('"A"', '"rad"'), "unit: 'rad' does not fit; there are A, mA, uA"),
    "free unit": (TIME + FREE.replace('"m/s"', '"mph"'), "unit: 'mph' does not fit; "),
    "free suffix": (TIME + FREE.replace("speed_m_s", "speed"), "write speed_m_s"),
    "free other suffix": (
        TIME + FREE.replace("speed_m_s", "speed_rad"),
        "ends in rad, not in what m/s is kept in; write speed_m_s",
    ),
    "free name": (TIME + FREE.replace("/arm", "/Arm__x"), "words of a-z and 0-9 joined by one _"),
    "taken name": (TIME + FREE.replace("/arm", "/sensors"), "is reserved for an incomplete /sensors"),
    "too few columns": (
        TIME + CURRENT.replace(', "e"', ""),
        "m.toml: channel[1].columns: 4 given; /sensors.current_A takes 5, one for each joint: AZIMUTH",
    ),
    "a column twice": (TIME + CURRENT.replace('"e"', '"a"'), "columns: 'a' is there twice"),
    "mapped twice": (TIME + CURRENT + CURRENT, "/sensors.current_A: is mapped by channel[1] already"),
    "columns and value": (TIME + CURRENT + "value = 1\n", "give columns, or value"),
    "neither": (TIME + '[[channel]]\nname = "/sensors.current_A"\nunit = "A"\n', "give columns, or value"),
    "gains": (
        TIME + CURRENT + "gain = [1, 2]\n",
        "gain: 2 given; /sensors.current_A takes one for all, or 5",
    ),
    "gain of NaN": (TIME + CURRENT + "gain = nan\n", "should be a finite number, not nan"),
    "constant": (
        TIME + CURRENT + '[[channel]]\nname = "/joint.mode"\nvalue = "STOWD"\n',
        "did you mean STOWED?",
    ),
    "constant flag": (
        TIME + CURRENT + '[[channel]]\nname = "/joint.busy"\nvalue = 1\n',
        "is not true or false",
    ),
    "constant count": (
        TIME + CURRENT + '[[channel]]\nname = "/sensors.cycle"\nvalue = 1.5\n',
        'is not a whole number of 64 bits, or "tick"',
    ),
    "constant without end": (
        TIME
        + CURRENT
        + '[[channel]]\nname = "/sensors.winding_C"\nvalue = 1e200\nunit = "K"\ngain = 1e200\n',
        "m.toml: channel[2].value: is too large for its gain, offset and unit",
    ),
    "only constants": (
        TIME.replace('column = "t"\nunit = "s"', "rate_Hz = 64")
        + '[[channel]]\nname = "/sensors.cycle"\nvalue = "tick"\n',
        "none has columns",
    ),
    "separator": (TIME + "[csv]\nseparator = ';;'\n" + CURRENT, "is not one character"),
    "decimal": (TIME + "[csv]\nseparator = ','\ndecimal = ','\n" + CURRENT, "are both ','"),
    "command without start": (TIME + CURRENT + '[[command]]\ntype = "STOP"\nat_s = 0\n', "write [start] too"),
    "start mode": (TIME + CURRENT + '[start]\nmode = "ready"\n', "mode: 'ready' is not known"),
    "start params": (
        TIME + CURRENT + '[start]\nmode = "stowed"\nparams = "none.toml"\n',
        "params: none.toml: cannot be read",
    ),
    "start reference": (
        TIME + CURRENT + '[start]\nmode = "stowed"\n[start.reference]\ncalibrated = [true]\n',
        "start.reference.calibrated[2]: is missing",
    ),
    "start without sensors": (
        TIME + CURRENT + '[start]\nmode = "stowed"\n',
        "start: replay needs all of /sensors, it lacks cycle, encoder_count, resolver_rad",
    ),
    "bad command": (
        TIME + CURRENT + '[start]\nmode = "stowed"\n[[command]]\ntype = "STOPP"\nat_s = 0\n',
        "did you mean STOP?",
    ),
}


@pytest.mark.parametrize("case", MAPPINGS)
def test_a_mapping_is_refused(case: str) -> None:
    mapping, words = MAPPINGS[case]
    assert words in refusal(mapping, table())


def test_all_problems_of_a_mapping_are_reported_together() -> None:
    bad = TIME.replace('"s"', '"h"') + CURRENT.replace('"A"', '"V"') + FREE.replace('"m/s"', '"m"')
    lines = refusal(bad, table()).splitlines()
    assert [line.split(": ")[1] for line in lines] == ["time.unit", "channel[1].unit", "channel[2].name"]


TABLES = {
    "missing column": (table(c=None), "t.parquet: there is no column 'c'; there are t, a, b, d, e"),
    "misspelt time": (table(t=None, T=[0.0, 1.0, 2.0]), "there is no column 't'; did you mean T?"),
    "shuffled time": (
        table(t=(0.0, 2 / 64, 1 / 64)),
        "t.parquet: row 3, column 't': time 0.015625 is before 0.03125 in row 2; sort the table",
    ),
    "duplicate time": (
        table(t=(0.0, 1 / 64, 1 / 64)),
        "row 3, column 't': time 0.015625 is that of row 2 too",
    ),
    "NaN time": (table(t=(0.0, np.nan, 1.0)), "row 2, column 't': the time is nan"),
    "infinite time": (table(t=(0.0, 1 / 64, np.inf)), "row 3, column 't': the time is inf"),
    "no time": (table(t=(0.0, None, 1.0)), "row 2, column 't': has no time"),
    "text as time": (table(t=("0", "1", "2")), "column 't': holds text, not numbers"),
    "flags as time": (table(t=(False, True, True)), "holds flags, not times"),
    "milliseconds": (
        table(t=(0.0, 15.625, 31.25)),
        'rows come at 0.064 Hz, the log has 64 Hz; with unit = "ms" they would come at 64 Hz',
    ),
    "another rate": (
        table(t=(0.0, 0.01, 0.02)),
        "rows come at 100 Hz, the log has 64 Hz; under [time] write grid",
    ),
    "jitter": (
        table(t=(0.0, 1.1 / 64, 2 / 64)),
        "is 0.1 of a cycle beside the grid of 64 Hz, 0.01 is allowed",
    ),
    "an age": (table(t=(0.0, 1 / 64, 1e12)), "is the unit right?"),
    "empty": (table(t=[], **{k: pa.array([], pa.float64()) for k in "abcde"}), "has no row"),
    "text as current": (table(b=["x", "y", "z"]), "column 'b': holds text, not numbers or flags"),
    "a list": (table(b=[[1.0], [2.0], [3.0]]), "column 'b' holds lists"),
    "half a message": (
        table(b=[1.0, None, 1.0]),
        "row 2, column 'b': has no value, but 'a' has; a message of /sensors",
    ),
    "no message": (
        table(**{k: pa.array([None] * 3, pa.float64()) for k in "abcde"}),
        "no row has a value for /sensors",
    ),
    "huge integer": (table(b=[1, 2, (1 << 60) + 1]), "is too large to be a number without loss"),
    "cut short": (table()[:200], "cannot be read as Parquet"),
    "nothing": (b"", "is an empty file"),
    "not Parquet": (b"t,a\n0,1\n", "is text, not Parquet"),
    "zipped": (b"PK\x03\x04....", "is a zip file, as spreadsheets are"),
    "a log": (b"\x89MCAP0\r\n", "is an MCAP log"),
}


@pytest.mark.parametrize("case", TABLES)
def test_a_table_is_refused(case: str) -> None:
    data, words = TABLES[case]
    assert words in refusal(TIME + CURRENT, data)


HEAD = "t,a,b,c,d,e"
TEXTS = {
    "a word": (text(HEAD, "0,1,2,3,4,x"), "row 1, column 'e': 'x' is no number"),
    "an infinity in digits": (text(HEAD, "0,1,2,3,4,-1e400"), "row 1, column 'e': '-1e400' is too large"),
    "digits with a line": (text(HEAD, "0,1,2,3,4,1_0"), "row 1, column 'e': '1_0' is no number"),
    "digits of another script": (text(HEAD, "0,1,2,3,4,٣"), "row 1, column 'e': '٣' is no number"),
    "decimal comma": (text(HEAD, '0,1,2,3,4,"5,5"'), "'5,5' is no number; write decimal = \",\" under [csv]"),
    "separator": (text(HEAD.replace(",", ";"), "0;1;2;3;4;5"), "its separator is ','"),
    "ragged": (text(HEAD, "0,1,2,3,4,5", "1,2,3"), "cannot be read as text in columns"),
    "a name twice": (text("t,a,b,c,d,e,a", "0,1,2,3,4,5,6"), "there are 2 columns 'a'"),
    "header only": (text(HEAD), "has no row"),
    "a blank line": (text(HEAD, "0,1,2,3,4,5", "", "1,1,2,3,4,5"), "row 2, column 't': has no time"),
    "zeros": (b"t,a\0\0\n0,1\n", "there are bytes of zero in it"),
    "UTF-16": ("t,a\n".encode("utf-16"), "is text in UTF-16"),
    "Parquet": (table(), "is Parquet; name it .parquet"),
    "Latin": (HEAD.encode() + b",\xe9\n0,1,2,3,4,5,6\n", "is not text in UTF-8"),
}


@pytest.mark.parametrize("case", TEXTS)
def test_a_text_table_is_refused(case: str) -> None:
    data, words = TEXTS[case]
    assert words in refusal(TIME + CURRENT, data, "t.csv")


def test_a_foreign_ending_is_refused() -> None:
    assert "must end in .parquet or .csv" in refusal(TIME + CURRENT, table(), "t.xlsx")


VALUES = {
    "part of a count": ("/joint.tick", [0, 1.5, 2], "cycle", "row 2, column 'a': 1.5 is no whole number"),
    "flags as a count": ("/joint.tick", [True, True, True], "cycle", "holds flags; /joint.tick is counted"),
    "half a flag": ("/joint.busy", [0, 0.5, 1], "bool", "0.5 is neither true nor false, 1 nor 0"),
    "an unknown mode": (
        "/joint.mode",
        ["STOWED", "FREE", "FREE"],
        None,
        "row 2, column 'a': 'FREE' is not known",
    ),
    "a mode too many": ("/joint.mode", [0, 1, 9], None, "row 3, column 'a': '9' is not known"),
    "NaN as a count": ("/joint.tick", [0, np.nan, 1], "cycle", "nan is no whole number"),
}


@pytest.mark.parametrize("case", VALUES)
def test_a_value_is_refused(case: str) -> None:
    name, values, unit, words = VALUES[case]
    mapping = f'{TIME}[[channel]]\nname = "{name}"\ncolumns = "a"\n' + (f'unit = "{unit}"\n' if unit else "")
    assert words in refusal(mapping, table(a=values))


def test_a_number_that_its_gain_makes_infinite_is_refused() -> None:
    message = refusal(TIME + CURRENT + "gain = 1e300\n", table(b=[1.0, 2.0, 1e300]))
    assert "row 3, column 'b': 1e+300 is too large for its gain, offset and unit" in message


LOSSES = {
    "a gain": ([1, 2, (1 << 53) + 1], "gain = 0.5", "row 3, column 'a': 9007199254740993 is too large to be"),
    "64 bits": ([1, -(1 << 63), 2], "gain = -1", "row 2, column 'a': -9223372036854775808 with its gain"),
    "a large gain": ([1, 2048, 2], f"gain = {1 << 53}", "row 2, column 'a': 2048 with its gain"),
    "floats": ([1.0, 2.0**53 + 2, 2.0], "", "row 2, column 'a': 9007199254740994 is too large to be counted"),
    "a fine gain": ([1, 2, 3], "gain = 1e16", "row 1, column 'a': 10000000000000000 is too large to be"),
}


@pytest.mark.parametrize("case", LOSSES)
def test_a_count_that_would_lose_bits_is_refused(case: str) -> None:
    counts, scale, words = LOSSES[case]
    mapping = '[[channel]]\nname = "/imported/arm.n_count"\ncolumns = "a"\nunit = "count"\n'
    assert words in refusal(TIME + mapping + scale, table(a=counts))


def test_two_rows_in_one_cycle_are_refused() -> None:
    close = table(t=(0.0, 1 / 64, 1.001 / 64))
    assert "row 3, column 't': is in the same cycle as row 2" in refusal(
        TIME + 'grid = "nearest"\n' + CURRENT, close
    )


def test_a_missing_cycle_is_refused_with_the_words_to_leave_or_bridge_it() -> None:
    gap = table(t=np.array([0, 1, 2, 3, 6, 7]) / 64, **{name: np.zeros(6) for name in "abcde"})
    message = refusal(TIME + CURRENT, gap)
    assert "row 5, column 't': 3 cycles after the row before" in message
    assert 'grid = "nearest" to leave the gap, or "hold" or "linear" to bridge it' in message


@pytest.mark.parametrize("grid", ["hold", "linear"])
def test_a_wide_gap_is_not_bridged_unasked(grid: str) -> None:
    wide = table(t=(0.0, 1.0, 5.0))
    assert "4 s after the row before" in refusal(TIME + f'grid = "{grid}"\n' + CURRENT, wide)
    convert_table(
        wide, "t.parquet", (TIME + f'grid = "{grid}"\nmax_interval_s = 4\n' + CURRENT).encode(), "m.toml"
    )


def test_a_table_of_more_numbers_than_fit_is_refused() -> None:
    with pytest.raises(BadImport, match="3 rows of 6 columns are more than 10 numbers"):
        convert_table(table(), "t.parquet", (TIME + CURRENT).encode(), "m.toml", cells=10)


def test_more_cycles_between_the_rows_than_fit_are_refused() -> None:
    mapping = (TIME + 'grid = "hold"\nmax_interval_s = 60\n' + CURRENT).encode()
    with pytest.raises(BadImport, match="spans 2561 cycles, more than 20; give it in parts"):
        convert_table(table(t=(0.0, 20.0, 40.0)), "t.parquet", mapping, "m.toml", cells=100)


def test_the_command_line_refuses_with_status_2_and_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "t.parquet").write_bytes(table(t=(0.0, 0.5, 0.25)))
    (tmp_path / "m.toml").write_text(TIME + CURRENT)
    out = tmp_path / "out.mcap"
    out.write_bytes(b"before")
    words = ["log", "import", *(str(tmp_path / name) for name in ("t.parquet", "m.toml", "out.mcap"))]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "row 3" in result.output
    assert out.read_bytes() == b"before"
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("name", ["t.parquet", "m.toml"])
def test_a_file_of_more_bytes_than_any_is_refused_unread(tmp_path: Path, name: str) -> None:
    (tmp_path / "t.parquet").write_bytes(table())
    (tmp_path / "m.toml").write_text(TIME + CURRENT)
    with (tmp_path / name).open("wb") as sparse:
        sparse.truncate(30 << 30)
    words = ["log", "import", *(str(tmp_path / each) for each in ("t.parquet", "m.toml", "o.mcap"))]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert f"{name}: has 32212254720 bytes, more than" in " ".join(result.output.split())
    assert not (tmp_path / "o.mcap").exists()


def test_a_table_that_does_not_fit_the_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise MemoryError

    (tmp_path / "t.parquet").write_bytes(table())
    (tmp_path / "m.toml").write_text(TIME + CURRENT)
    monkeypatch.setattr(job, "build_topics", full)
    words = ["log", "import", *(str(tmp_path / each) for each in ("t.parquet", "m.toml", "o.mcap"))]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "t.parquet: is too large for the memory; give it in parts" in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("paths", "words"),
    [
        (("none.parquet", "m.toml", "o.mcap"), "none.parquet: cannot be read"),
        (("t.parquet", "none.toml", "o.mcap"), "none.toml: cannot be read"),
        (("t.parquet", "m.toml", "o.log"), "its name must end in .mcap"),
        (("t.parquet", "m.toml", "no/o.mcap"), "there is no folder"),
        (("t.parquet", "t.parquet", "o.mcap"), "this is the file of table too"),
    ],
)
def test_paths_are_refused(tmp_path: Path, paths: tuple[str, ...], words: str) -> None:
    (tmp_path / "t.parquet").write_bytes(table())
    (tmp_path / "m.toml").write_text(TIME + CURRENT)
    result = CliRunner().invoke(app, ["log", "import", *(str(tmp_path / name) for name in paths)])
    assert result.exit_code == 2
    assert words in " ".join(result.output.split())
    assert len(list(tmp_path.iterdir())) == 2
