"""`marsarm log import`: tables become logs; units, factors and the grid of 64 Hz; what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from marsarm.diagnosis.arm.logs import NotForDiagnosis, load_recording
from marsarm.replaying.replay import ReplayRequest, replay
from marsarm.telemetry.format import TICK_NS
from marsarm.telemetry.import_mapping import known_channels
from marsarm.telemetry.import_table import ImportedLog, convert_table, import_table
from marsarm.telemetry.read import Log, read_log
from simgap.common.errors import BadRequest, RobotError
from simgap.common.progress import no_progress
from tests.marsarm.command import marsarm, marsarm_json
from tests.marsarm.telemetry.lab import cycle_at, record

GRID_S = np.arange(4) / 64
N_CYCLES = 64


def channel(name: str, rest: str) -> str:
    return f'[channels."{name}"]\n{rest}\n'


PLAIN = {
    "/drive.setpoint_count": "value = 0",
    "/drive.setpoint_rate_rad_s": 'value = 0\nunit = "rad/s"',
    "/drive.current_limit_A": 'value = 0\nunit = "A"',
    "/drive.vibrate": "value = 0",
    "/drive.power_on": "value = 0",
    "/drive.brake_release": "value = 0",
}
"""A constant for each channel of /drive."""
FIVE = '["a", "a2", "a3", "a4", "a5"]'


def drive(name: str, rest: str) -> str:
    """Return a mapping of /drive whose channels are constant but for one."""
    return "".join(channel(one, text) for one, text in (PLAIN | {f"/drive.{name}": rest}).items())


STEPS = drive("setpoint_count", f"columns = {FIVE}")
SPEED = drive("setpoint_rate_rad_s", f'columns = {FIVE}\nunit = "rad/s"')
FLAG = drive("vibrate", 'columns = "a"')


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("import")


@pytest.fixture(scope="module")
def mapped(folder: Path) -> Any:
    """Return a function that converts columns by a mapping; columns a2 to a5 are as column a."""

    def convert(mapping: str, time: str = "", t: Any = GRID_S, **columns: Any) -> ImportedLog:
        columns = {f"a{k}": columns.get("a") for k in range(2, 6)} | columns
        parquet.write_table(pa.table({"t": t} | columns), folder / "t.parquet")
        (folder / "m.toml").write_text(f'[time]\ncolumn = "t"\n{time}\n{mapping}')
        return convert_table(folder / "t.parquet", folder / "m.toml")

    return convert


def values(made: ImportedLog, field: str) -> Any:
    """Return the first number of a field in each message."""
    (series,) = made.series
    return series.data[field].reshape(series.ticks.size, -1)[:, 0]


@pytest.fixture(scope="module")
def run(folder: Path) -> Log:
    return read_log(record(folder / "run.mcap", map(cycle_at, range(N_CYCLES))))


def exported(log: Log) -> tuple[dict[str, Any], str]:
    """Return a column for each number of the log that is exact as a float, and the mapping of them all."""
    columns: dict[str, Any] = {"t": np.arange(N_CYCLES) / 64}
    mapping = '[time]\ncolumn = "t"\n'
    units = {"_rad": "rad", "rad_s": "rad/s", "_A": "A", "_C": "degC", "m_s2": "m/s2"}
    for name, field in known_channels().items():
        topic, _, key = name.partition(".")
        numbers = log[topic][key].reshape(N_CYCLES, -1)
        numbers = numbers % 1000 if field.kind == "<i8" else numbers
        names = [f"{name}.{k}" for k in range(numbers.shape[1])]
        columns |= dict(zip(names, numbers.T, strict=True))
        unit = next((f'unit = "{unit}"' for end, unit in units.items() if name.endswith(end)), "")
        mapping += channel(name, f"columns = {json.dumps(names)}\n{unit}")
    return columns, mapping


def imported(folder: Path) -> Log:
    """Import the table of a folder by its mapping."""
    import_table(folder / "t.parquet", folder / "m.toml", folder / "o.mcap", no_progress)
    return read_log(folder / "o.mcap")


def test_a_table_of_a_run_is_that_run(run, tmp_path):
    columns, mapping = exported(run)
    parquet.write_table(pa.table(columns), tmp_path / "t.parquet")
    (tmp_path / "m.toml").write_text(f'arm = "theirs"\n{mapping}')
    log = imported(tmp_path)
    assert set(log.packets) == {"/sensors", "/drive"}
    for name, field in known_channels().items():
        topic, _, key = name.partition(".")
        if field.kind != "<i8":
            assert log[topic][key].tobytes() == run[topic][key].tobytes(), name
    assert log["/sensors"]["cycle"].tolist() == list(range(N_CYCLES))
    assert json.loads(log.header["request"])["import"]["table"].endswith("t.parquet")
    assert (log.header["arm"], log.header["mjcf_sha256"], log.end) == ("theirs", "unknown", "closed")


def test_the_drive_of_a_log_is_imported_again(run, tmp_path):
    names = json.dumps([f"/drive.current_limit_a[{k}]" for k in range(5)])
    (tmp_path / "m.toml").write_text(drive("current_limit_A", f'columns = {names}\nunit = "A"'))
    (series,) = convert_table(run.path, tmp_path / "m.toml").series
    assert series.data["current_limit_A"].tobytes() == run["/drive"]["current_limit_A"].tobytes()


@pytest.mark.parametrize(("unit", "given_value"), [("deg/s", 180.0), ("rpm", 30.0)])
def test_units_are_converted_to_those_of_a_log(mapped, unit, given_value):
    made = mapped(SPEED.replace("rad/s", unit), a=[given_value] * 4)
    assert values(made, "setpoint_rate_rad_s") == pytest.approx(np.full(4, np.pi), rel=1e-15)


def test_counts_stay_whole_and_are_rounded_only_where_a_factor_asks_for_it(mapped):
    made = mapped(STEPS, a=[0, 1 << 53, -5, 2])
    assert values(made, "setpoint_count").tolist() == [0, 1 << 53, -5, 2]
    scaled = drive("setpoint_count", f"columns = {FIVE}\nfactor = [0.4, 1, 1, 1, 1]")
    assert values(mapped(scaled, a=[0, 1, 2, 4]), "setpoint_count").tolist() == [0, 0, 1, 2]


def test_flags_may_be_numbers_and_may_be_turned_round(mapped):
    assert values(mapped(FLAG, a=[0, 1, 1, 0]), "vibrate").tolist() == [False, True, True, False]
    turned = drive("vibrate", 'columns = "a"\nfactor = -1\noffset = 1')
    made = mapped(turned, a=[True, False, True, True])
    assert values(made, "vibrate").tolist() == [False, True, False, False]


def test_a_constant_stands_in_every_message(mapped):
    made = mapped(STEPS.replace('value = 0\nunit = "A"', 'value = 2000\nunit = "mA"'), a=[1] * 4)
    assert made.series[0].data["current_limit_A"].tolist() == [[2.0] * 5] * 4
    assert not made.series[0].data["power_on"].any()


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_the_unit_of_the_time_is_that_of_the_column(mapped, unit):
    t = GRID_S * {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    assert mapped(STEPS, f'unit = "{unit}"', t + t[1], a=[1] * 4).series[0].ticks.tolist() == [0, 1, 2, 3]


def test_the_file_may_know_its_times(mapped):
    t = pa.array(np.arange(4) * TICK_NS + 10**18, pa.timestamp("ns"))
    assert mapped(STEPS, t=t, a=[1] * 4).series[0].ticks.tolist() == [0, 1, 2, 3]


def test_linear_is_between_the_rows_and_flags_are_held(mapped):
    t, k, at_s = np.arange(9) / 100, np.arange(9), np.arange(6) / 64
    made = mapped(SPEED, 'grid = "linear"', t, a=10.0 * t)
    assert made.series[0].ticks.tolist() == list(range(6))
    assert values(made, "setpoint_rate_rad_s") == pytest.approx(10 * at_s, rel=1e-12)
    made = mapped(STEPS, 'grid = "linear"', t, a=k * 1001)
    assert values(made, "setpoint_count").tolist() == np.rint(at_s * 100_100).astype(int).tolist()
    made = mapped(FLAG, 'grid = "linear"', t, a=k % 2 == 1)
    assert values(made, "vibrate").tolist() == (np.floor(at_s * 100).astype(int) % 2 == 1).tolist()


def test_rows_on_the_grid_keep_every_bit_whatever_comes_beside_them(mapped):
    a = np.array([1.0, -0.0, np.nan, np.inf])
    made = mapped(SPEED, 'grid = "linear"', a=a)
    assert values(made, "setpoint_rate_rad_s").tobytes() == a.tobytes()
    far = mapped(SPEED, 'grid = "linear"', 2 * GRID_S[:2], a=[-1.5e308, 1.5e308])
    assert values(far, "setpoint_rate_rad_s").tolist() == [-1.5e308, 0.0, 1.5e308]


def test_a_topic_of_a_lower_rate_has_its_own_rows(mapped):
    made = mapped(STEPS, 'grid = "linear"', a=[0, None, 4, None])
    assert values(made, "setpoint_count").tolist() == [0, 2, 4]


def test_a_repeat_is_known_as_one_to_the_diagnosis(run, tmp_path):
    columns, mapping = exported(run)
    for name in ("gravity_R_m_s2", "winding_C", "structure_C"):
        columns |= {key: np.zeros(N_CYCLES) for key in columns if key.startswith(f"/sensors.{name}")}
    columns["/sensors.gravity_R_m_s2.2"] = np.full(N_CYCLES, 3.721)
    columns |= {f"/sensors.winding_C.{k}": np.full(N_CYCLES, 263.15) for k in range(5)}
    before, name, after = mapping.partition('[channels."/sensors.winding_C"]')
    mapping = before + name + after.replace("degC", "K", 1)
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
    assert here.temperature_C == pytest.approx(-10.0)
    with pytest.raises(BadRequest, match="was imported, so its commands are unknown"):
        replay(ReplayRequest(tmp_path / "o.mcap"))


A = {"a": [1.0, 2.0, 3.0, 4.0]}
WRONG = {
    "an unknown channel": (
        STEPS + channel("/drive.vibrates", "value = 0"),
        A,
        "did you mean '/drive.vibrate'",
    ),
    "an unknown key": (STEPS + "gain = 2\n", A, "brake_release.gain: is not known; remove it"),
    "the cycle": (STEPS + channel("/sensors.cycle", "value = 0"), A, "it counts the cycles"),
    "an empty constant": (STEPS.replace("value = 0\n", "value = []\n", 1), A, "value: 0 given"),
    "no flag in the mapping": (
        STEPS.replace('vibrate"]\nvalue = 0', 'vibrate"]\nvalue = 0.5'),
        A,
        "m.toml: channels./drive.vibrate.value: 0.5 is neither true nor false",
    ),
    "a count of an angle": (
        STEPS + channel("/sensors.resolver_rad", 'value = 1\nunit = "count"'),
        A,
        "'count' is no unit of angle; write one of rad, mrad, urad, deg, turn; /sensors",
    ),
    "a count of a speed": (SPEED.replace("rad/s", "count/s"), A, "no unit of angular speed"),
    "a unit of a flag": (drive("vibrate", 'columns = "a"\nunit = "deg"'), A, "kept in bool, write that"),
    "neither": (drive("vibrate", 'unit = "bool"'), A, "give columns, or value"),
    "no columns": (drive("vibrate", "value = 0"), A, "all of /drive is constant"),
    "too few columns": (
        drive("setpoint_count", 'columns = ["a"]'),
        A,
        "1 given; /drive.setpoint_count takes 5",
    ),
    "too few factors": (STEPS.replace(FIVE, f"{FIVE}\nfactor = [1, 2]"), A, "factor: 2 given"),
    "twice": (STEPS.replace("a5", "a4"), A, "is there twice"),
    "a part": (channel("/drive.vibrate", 'columns = "a"'), A, "/drive lacks /drive.setpoint_count"),
    "no unit": (SPEED.replace('"rad/s"', '""'), A, "unit: is missing; /drive.setpoint_rate_rad_s"),
    "another unit": (SPEED.replace("rad/s", "N"), A, "no unit of angular speed"),
    "a unit of counts": (STEPS.replace(FIVE, f'{FIVE}\nunit = "rad"'), A, "is kept in count"),
    "a column": (STEPS.replace("a5", "b"), A, "has no column 'b', which robot file or mapping names"),
    "no whole number": (STEPS, {"a": [0.5] * 4}, "row 1, column 'a': 0.5 is no whole number"),
    "a large count": (STEPS, {"a": [0.0, 1e17, 0.0, 0.0]}, "row 2, column 'a'"),
    "no flag": (FLAG, {"a": [0, 1, 2, 1]}, "row 3, column 'a': 2 is neither true nor false"),
    "an overflow": (SPEED.replace(FIVE, f"{FIVE}\nfactor = 1e300"), {"a": [1e300] * 4}, "too large for its"),
    "a gap": (STEPS, {**A, "a3": [1.0, None, 1.0, 1.0]}, "row 2, column 'a3': has no value"),
    "no value": (STEPS, {"a": pa.array([None] * 4, pa.float64())}, "no row has a value"),
    "text": (STEPS, {"a": ["x"] * 4}, "a signal needs numbers"),
}


@pytest.mark.parametrize(("mapping", "columns", "why"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_mapping_or_column_is_refused(mapped, mapping, columns, why):
    with pytest.raises(RobotError) as caught:
        mapped(mapping, **columns)
    assert why in str(caught.value)


def test_nan_in_csv_is_an_empty_cell(tmp_path):
    (tmp_path / "t.csv").write_text("t,a,a2,a3,a4,a5\n0,1,1,1,1,1\n0.015625,1,nan,1,1,1\n")
    (tmp_path / "m.toml").write_text(f'[time]\ncolumn = "t"\n{SPEED}')
    with pytest.raises(RobotError, match="row 2, column 'a2': has no value"):
        convert_table(tmp_path / "t.csv", tmp_path / "m.toml")


TIMES = {
    "back": ([0, 2, 1, 3], "exact", "row 3, column 't': its time is not after"),
    "twice": ([0, 1, 1, 2], "linear", "row 3, column 't': its time is not after"),
    "another rate": ([0, 2, 4, 6], "exact", "row 2: 2 cycles of 64 Hz after the row before"),
    "a gap": ([0, 1, 2, 5], "exact", "3 cycles of 64 Hz after the row before"),
    "beside": ([0, 1, 2.2, 3], "exact", "1.2 cycles of 64 Hz after the row before"),
    "a long gap": ([0, 1, 2, 99], "linear", "row 4: 1.51562 s after the row before; at most 1 s"),
    "no time": ([0, np.nan, 2, 3], "exact", "row 2, column 't': has no time"),
}


@pytest.mark.parametrize(("t", "grid", "why"), TIMES.values(), ids=TIMES.keys())
def test_times_that_do_not_fit_are_refused(mapped, t, grid, why):
    with pytest.raises(RobotError) as caught:
        mapped(STEPS, f'grid = "{grid}"', np.array(t) / 64, **A)
    assert why in str(caught.value)


def test_the_verb_reports_what_was_made(tmp_path):
    parquet.write_table(pa.table({"t": GRID_S, "a": [0, 1, 1, 0]}), tmp_path / "t.parquet")
    (tmp_path / "m.toml").write_text(f'[time]\ncolumn = "t"\n{FLAG}')
    words = ("log", "import", "t.parquet", "m.toml", "out.mcap")
    topics = marsarm_json(tmp_path, *words)["topics"]
    assert topics == [{"topic": "/drive", "messages": 4, "first_tick": 0}]
    assert "4 messages from cycle 0 on" in " ".join(marsarm(tmp_path, *words).stdout.split())
