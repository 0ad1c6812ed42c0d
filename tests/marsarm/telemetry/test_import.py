"""`marsarm log import`: tables become logs; units, gains and the grid of 64 Hz; what is refused."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from marsarm.cli.app import app
from marsarm.diagnosis.arm.logs import NotForDiagnosis, load_recording
from marsarm.replaying.replay import ReplayRequest, replay
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.import_mapping import known_targets
from marsarm.telemetry.import_table import ImportedLog, convert_table, import_table
from marsarm.telemetry.read import Log, read_log
from simgap.common.errors import BadRequest, RobotError
from simgap.common.progress import no_progress

DOC = Path(__file__).parents[3] / "docs" / "logs.md"
GRID_S = np.arange(4) / 64
N_CYCLES = 64


def channel(name: str, rest: str) -> str:
    return f'[channels."{name}"]\n{rest}\n'


SPEED = channel("/imported/arm.x_m", 'columns = "a"\nunit = "m"')
STEPS = channel("/imported/arm.n_count", 'columns = "n"')
FLAG = channel("/imported/arm.on", 'columns = "on"\nunit = "bool"')


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("import")


@pytest.fixture(scope="module")
def mapped(folder: Path) -> Any:
    """Return a function that converts columns by a mapping."""

    def convert(mapping: str, time: str = "", t: Any = GRID_S, **columns: Any) -> ImportedLog:
        parquet.write_table(pa.table({"t": t} | columns), folder / "t.parquet")
        (folder / "m.toml").write_text(f'[time]\ncolumn = "t"\n{time}\n{mapping}')
        return convert_table(folder / "t.parquet", folder / "m.toml")

    return convert


def values(made: ImportedLog) -> Any:
    (series,) = made.series
    return series.data[series.layout.fields[0].name]


@pytest.fixture(scope="module")
def run(make: Any, folder: Path) -> Log:
    return read_log(make.record(folder / "run.mcap", map(make.cycle_at, range(N_CYCLES))))


def exported(log: Log) -> tuple[dict[str, Any], str]:
    """Return a column for each number of the log that is exact as a float, and the mapping of them all."""
    columns: dict[str, Any] = {"t": np.arange(N_CYCLES) / 64}
    mapping = '[time]\ncolumn = "t"\n'
    for name, target in known_targets().items():
        numbers = log[target.topic][target.field.name].reshape(N_CYCLES, -1)
        if target.field.kind == "<i8" and target.field.members is None:
            numbers = numbers % 1000
        names = [f"{name}.{k}" for k in range(target.size)]
        columns |= dict(zip(names, numbers.T, strict=True))
        unit = "" if target.field.members is not None else f'unit = "{target.unit}"'
        mapping += channel(name, f"columns = {json.dumps(names)}\n{unit}")
    return columns, mapping


def imported(folder: Path) -> Log:
    """Import the table of a folder by its mapping."""
    import_table(folder / "t.parquet", folder / "m.toml", folder / "o.mcap", no_progress)
    return read_log(folder / "o.mcap")


def test_a_table_of_a_run_is_that_run(run: Log, tmp_path: Path) -> None:
    columns, mapping = exported(run)
    parquet.write_table(pa.table(columns), tmp_path / "t.parquet")
    (tmp_path / "m.toml").write_text(f'arm = "theirs"\n{mapping}')
    log = imported(tmp_path)
    assert log.packets.keys() == run.packets.keys()
    assert log.truth == run.truth
    for name, target in known_targets().items():
        if target.field.kind != "<i8" or target.field.members is not None:
            here, there = (one[target.topic][target.field.name] for one in (log, run))
            assert here.tobytes() == there.tobytes(), name
    assert json.loads(log.header["request"])["import"]["table"].endswith("t.parquet")
    assert (log.header["arm"], log.header["mjcf_sha256"], log.end) == ("theirs", "unknown", "closed")


def test_the_channel_of_a_log_is_imported_again(run: Log, tmp_path: Path) -> None:
    names = [f"/sensors.current_a[{k}]" for k in range(5)]
    (tmp_path / "m.toml").write_text(
        '[time]\ngrid = "nearest"\n'
        + channel("/sensors.current_A", f'columns = {json.dumps(names)}\nunit = "A"')
    )
    (series,) = convert_table(run.path, tmp_path / "m.toml").series
    assert series.spec.topic == "/imported/sensors"
    assert series.data["current_A"].tobytes() == run["/sensors"]["current_A"].tobytes()


@pytest.mark.parametrize(
    ("name", "unit", "given_value", "kept"),
    [
        ("arm.x_rad", "deg", 180.0, np.pi),
        ("arm.x_rad_s", "rpm", 60.0, 2 * np.pi),
        ("arm.x_C", "K", 273.15, 0.0),
        ("arm.x_K", "degC", 0.0, 273.15),
    ],
)
def test_units_are_converted_to_those_of_a_log(
    mapped: Any, name: str, unit: str, given_value: float, kept: float
) -> None:
    made = mapped(channel(f"/imported/{name}", f'columns = "a"\nunit = "{unit}"'), a=[given_value] * 4)
    assert values(made) == pytest.approx(np.full(4, kept), rel=1e-15, abs=1e-15)


def test_counts_stay_whole_and_are_rounded_only_where_a_factor_asks_for_it(mapped: Any) -> None:
    assert values(mapped(STEPS, n=[0, 1 << 53, -5, 2])).tolist() == [0, 1 << 53, -5, 2]
    assert values(mapped(STEPS + "factor = 0.4\n", n=[0, 1, 2, 4])).tolist() == [0, 0, 1, 2]


def test_flags_may_be_numbers_and_may_be_turned_round(mapped: Any) -> None:
    assert values(mapped(FLAG, on=[0, 1, 1, 0])).tolist() == [False, True, True, False]
    turned = mapped(FLAG + "factor = -1\noffset = 1\n", on=[True, False, True, True])
    assert values(turned).tolist() == [False, True, False, False]


def test_modes_are_numbers_and_held(mapped: Any) -> None:
    made = mapped(channel("/joint.mode", 'columns = "a"'), 'grid = "linear"', 2 * GRID_S[:2], a=[0, 3])
    assert values(made).tolist() == [0, 0, 3]


def test_a_constant_stands_in_every_message_and_the_cycle_counts(mapped: Any) -> None:
    made = mapped(
        channel("/sensors.current_A", 'columns = ["a", "b", "c", "d", "e"]\nunit = "A"')
        + channel("/sensors.gravity_R_m_s2", 'value = [0, 0, 1]\nunit = "g0"')
        + channel("/sensors.winding_C", 'value = 300\nunit = "K"')
        + channel("/sensors.switch_closed", "value = false")
        + channel("/sensors.cycle", 'value = "tick"'),
        time="first_tick = 7",
        **{name: [1.0] * 4 for name in "abcde"},
    )
    (series,) = made.series
    assert series.ticks.tolist() == series.data["cycle"].tolist() == [7, 8, 9, 10]
    assert series.data["gravity_R_m_s2"].tolist() == [[0.0, 0.0, 9.80665]] * 4
    assert series.data["winding_C"] == pytest.approx(np.full((4, 5), 26.85))
    assert not series.data["switch_closed"].any()
    assert "resolver_rad" in series.missing_fields


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_the_unit_of_the_time_is_that_of_the_column(mapped: Any, unit: str) -> None:
    t = GRID_S * {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    assert mapped(SPEED, f'unit = "{unit}"', t + t[1], a=[1.0] * 4).series[0].ticks.tolist() == [0, 1, 2, 3]


def test_the_file_may_know_its_times(mapped: Any) -> None:
    t = pa.array(np.arange(4) * TICK_NS + 10**18, pa.timestamp("ns"))
    assert mapped(SPEED, t=t, a=[1.0] * 4).series[0].ticks.tolist() == [0, 1, 2, 3]


def test_rows_at_a_rate_need_no_time(folder: Path) -> None:
    (folder / "t.csv").write_text("a\n1\n2\n3\n")
    (folder / "m.toml").write_text(f"[time]\nrate_Hz = 32\ngrid = 'nearest'\n{SPEED}")
    assert convert_table(folder / "t.csv", folder / "m.toml").series[0].ticks.tolist() == [0, 2, 4]


def test_rows_may_be_put_in_order_and_the_report_can_say_so(mapped: Any) -> None:
    made = mapped(SPEED, "sort = true", GRID_S[[0, 2, 1, 3]], a=[0.0, 2.0, 1.0, 3.0])
    assert values(made).tolist() == [0.0, 1.0, 2.0, 3.0]
    assert made.rows_moved == 3


def test_linear_is_between_the_rows_and_flags_are_held(mapped: Any) -> None:
    t, k = np.arange(9) / 100, np.arange(9)
    made = mapped(SPEED + STEPS + FLAG, 'grid = "linear"', t, a=10.0 * t, n=k * 1001, on=k % 2 == 1)
    data, at_s = made.series[0].data, np.arange(6) / 64
    assert made.series[0].ticks.tolist() == list(range(6))
    assert data["x_m"] == pytest.approx(10 * at_s, rel=1e-12)
    assert data["n_count"].tolist() == np.rint(at_s * 100_100).astype(int).tolist()
    assert data["on"].tolist() == (np.floor(at_s * 100).astype(int) % 2 == 1).tolist()
    held = mapped(SPEED, 'grid = "hold"', t, a=k.astype(float))
    assert values(held).tolist() == [0.0, 1.0, 3.0, 4.0, 6.0, 7.0]


@pytest.mark.parametrize("grid", ["hold", "linear"])
def test_rows_on_the_grid_keep_every_bit_whatever_comes_beside_them(mapped: Any, grid: str) -> None:
    a = np.array([1.0, -0.0, np.nan, np.inf])
    assert values(mapped(SPEED, f'grid = "{grid}"', a=a)).tobytes() == a.tobytes()
    far = mapped(SPEED, 'grid = "linear"', 2 * GRID_S[:2], a=[-1.5e308, 1.5e308])
    assert values(far).tolist() == [-1.5e308, 0.0, 1.5e308]


def test_a_channel_of_a_lower_rate_has_messages_where_it_has_values(mapped: Any) -> None:
    slow = channel("/imported/slow.y_m", 'columns = "b"\nunit = "m"')
    made = mapped(SPEED + slow, a=[1.0, 2.0, 3.0, 4.0], b=[5.0, None, 6.0, None])
    assert {s.spec.topic: s.ticks.tolist() for s in made.series} == {
        "/imported/arm": [0, 1, 2, 3],
        "/imported/slow": [0, 2],
    }


def test_a_repeat_is_known_as_one_to_the_diagnosis(run: Log, tmp_path: Path) -> None:
    columns, mapping = exported(run)
    for name in ("gravity_R_m_s2", "winding_C", "structure_C"):
        columns |= {key: np.zeros(N_CYCLES) for key in columns if key.startswith(f"/sensors.{name}")}
    columns["/sensors.gravity_R_m_s2.2"] = np.full(N_CYCLES, 3.721)
    parquet.write_table(pa.table(columns), tmp_path / "t.parquet")
    (tmp_path / "m.toml").write_text(f'{mapping}[session]\nname = "cold-again"\nblock = "cold"\n')
    imported(tmp_path)
    with pytest.raises(NotForDiagnosis, match=r"import it with a \[reference\]"):
        load_recording(tmp_path / "o.mcap")
    (tmp_path / "arm.toml").write_text("[monitors]\ntilt_rad = 0.02\n")
    with (tmp_path / "m.toml").open("a") as file:
        file.write("[reference]\nzero_rad = [0.1, -0.2, 0.3, 0.0, 1.5]\n")
    text = (tmp_path / "m.toml").read_text()
    (tmp_path / "m.toml").write_text(f'params = "arm.toml"\n{text}')
    imported(tmp_path)
    here = load_recording(tmp_path / "o.mcap")
    assert (here.name, here.block, here.params.monitors.tilt_rad) == ("cold-again", "cold", 0.02)
    assert here.start.zero_rad.tolist() == [0.1, -0.2, 0.3, 0.0, 1.5]
    with pytest.raises(BadRequest, match="was imported, so its commands are unknown"):
        replay(ReplayRequest(tmp_path / "o.mcap"))


A = {"a": [1.0, 2.0, 3.0, 4.0]}
WRONG = {
    "an unknown channel": (
        channel("/joint.motor_red", 'columns = "a"'),
        "",
        A,
        "did you mean '/joint.motor_rad'",
    ),
    "an unknown key": (SPEED + "gain = 2\n", "", A, "arm.x_m.gain: is not known; remove it"),
    "neither": (channel("/imported/arm.x_m", 'unit = "m"'), "", A, "give columns, or value"),
    "too few columns": (
        channel("/joint.motor_rad", 'columns = ["a"]\nunit = "rad"'),
        "",
        A,
        "1 given; /joint.motor_rad takes 5",
    ),
    "twice": (channel("/imported/x.y_m", 'columns = ["a", "a"]\nunit = "m"'), "", A, "is there twice"),
    "no unit": (channel("/imported/arm.x_m", 'columns = "a"'), "", A, "is kept in m"),
    "another unit": (channel("/imported/arm.x_m", 'columns = "a"\nunit = "N"'), "", A, "no unit of length"),
    "a name": (channel("/imported/Arm.x", 'columns = "a"'), "", A, "words of a-z"),
    "a reserved name": (channel("/imported/joint.x", 'columns = "a"'), "", A, "is reserved"),
    "a scaled name": (channel("/joint.mode", 'columns = "a"\nfactor = 2'), "", A, "it has no unit"),
    "a column": (SPEED, "", {"b": A["a"]}, "has no column 'a'"),
    "no times": (SPEED, 'column = ""', A, "Cannot overwrite a value"),
    "two kinds of times": (SPEED, "rate_Hz = 64", A, "one of the two"),
    "no mode": (channel("/joint.mode", 'columns = "a"'), "", {"a": [0, 99] * 2}, "99 is none of 0 STOWED"),
    "no whole number": (STEPS, "", {"n": [0.5] * 4}, "row 1, column 'n': 0.5 is no whole number"),
    "a large count": (STEPS, "", {"n": [0.0, 1e17, 0.0, 0.0]}, "row 2, column 'n'"),
    "no flag": (FLAG, "", {"on": [0, 1, 2, 1]}, "row 3, column 'on': 2 is neither true nor false"),
    "an overflow": (SPEED + "factor = 1e300\n", "", {"a": [1e300] * 4}, "too large for its factor"),
    "a part": (
        channel("/imported/x.y_m", 'columns = ["a", "b"]\nunit = "m"'),
        "",
        {**A, "b": [1.0, None, 1.0, 1.0]},
        "row 2, column 'b': has no value",
    ),
    "no value": (SPEED, "", {"a": pa.array([None] * 4, pa.float64())}, "no row has a value"),
    "text": (SPEED, "", {"a": ["x"] * 4}, "a signal needs numbers"),
}


@pytest.mark.parametrize(("mapping", "time", "columns", "why"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_mapping_or_column_is_refused(
    mapped: Any, mapping: str, time: str, columns: dict[str, Any], why: str
) -> None:
    with pytest.raises(RobotError) as caught:
        mapped(mapping, time, **columns)
    assert why in str(caught.value)


TIMES = {
    "back": ([0, 2, 1, 3], "", "is not after that of row 2"),
    "twice": ([0, 1, 1, 2], "", "is not after that of row 2"),
    "another rate": ([0, 2, 4, 6], "", "row 2, column 't': 2 cycles of 64 Hz after the row before"),
    "a gap": ([0, 1, 2, 5], "", "3 cycles of 64 Hz after the row before"),
    "beside": ([0, 1, 2.2, 3], "", "1.2 cycles of 64 Hz after the row before"),
    "two in a cycle": ([0, 0.3, 1, 2], 'grid = "nearest"', "row 2, column 't': is in the same cycle"),
    "a long gap": ([0, 1, 2, 99], 'grid = "hold"', "most max_interval_s = 1"),
    "between": ([0.2, 0.3, 0.4, 0.5], 'grid = "linear"', ""),
    "no time": ([0, np.nan, 2, 3], "", "row 2, column 't': has no time"),
    "forever": ([0, 1, 2, 1e15], 'grid = "nearest"', "is the unit right?"),
}


@pytest.mark.parametrize(("t", "time", "why"), TIMES.values(), ids=TIMES.keys())
def test_times_that_do_not_fit_are_refused(mapped: Any, t: list[float], time: str, why: str) -> None:
    if not why:  # the grid begins at the first row
        assert mapped(SPEED, time, np.array(t) / 64, **A).series[0].ticks.tolist() == [0]
        return
    with pytest.raises(RobotError) as caught:
        mapped(SPEED, time, np.array(t) / 64, **A)
    assert why in str(caught.value)


def test_the_verb_reports_what_was_made_and_what_it_lacks(tmp_path: Path) -> None:
    parquet.write_table(pa.table({name: np.arange(3.0) for name in "abcde"}), tmp_path / "t.parquet")
    rest = 'columns = ["a", "b", "c", "d", "e"]\nunit = "mA"'
    (tmp_path / "m.toml").write_text("[time]\nrate_Hz = 64\n" + channel("/sensors.current_A", rest))
    words = ["log", "import", *(str(tmp_path / name) for name in ("t.parquet", "m.toml", "out.mcap"))]
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    (topic,) = report["topics"]
    assert (report["rows"], topic["topic"], topic["messages"]) == (3, "/imported/sensors", 3)
    assert "gravity_R_m_s2" in topic["missing_fields"]
    assert read_log(report["log"])["/imported/sensors"]["current_A"][2] == pytest.approx([2e-3] * 5)
    output = " ".join(CliRunner().invoke(app, words).output.split())
    assert (
        "/imported/sensors is kept apart from flight topics, for it is incomplete; it lacks cycle" in output
    )


@pytest.mark.real_data
def test_the_tracker_s_table_of_the_page_becomes_a_log(real_data: Path, tmp_path: Path) -> None:
    examples = re.findall(r"```toml\n(.*?)```", DOC.read_text(), re.DOTALL)
    (tmp_path / "m.toml").write_text(next(text for text in examples if "UR10" in text))
    table = real_data / "ur10-tracker" / "series_a_grid.csv"
    made = import_table(table, tmp_path / "m.toml", tmp_path / "o.mcap", no_progress)
    assert made.rows == 11_911
    assert made.rows_moved > 0
    log = read_log(tmp_path / "o.mcap")
    tracker, arm = log["/imported/tracker"][0], log["/imported/ur10"][0]  # the first line, converted by hand
    assert tracker["target_m"] == pytest.approx([2.3619831, -1.3685474, 0.11939713])
    assert arm["motor_rad"] == pytest.approx([-1.5708, -1.5708, 0.0, -1.5708, 0.0, 0.0])
    rounded = real_data / "ur10-tracker" / "series_c_random_poses.csv"
    with pytest.raises(RobotError, match=r"row 1, column 'Timestamp': '2,02011E\+13' is no time"):
        convert_table(rounded, tmp_path / "m.toml")
