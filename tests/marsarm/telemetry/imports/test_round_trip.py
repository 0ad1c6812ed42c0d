"""An exported and imported log is bit for bit the same, and replays without a difference."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import csv

from fsw.config import configure, digest
from fsw.cycle import step
from fsw.dictionary.enums import Mode
from fsw.messages import Sensors
from fsw.state import boot
from marsarm.diagnosis.arm.logs import load_recording
from marsarm.telemetry.imports.job import ImportRequest, import_table
from marsarm.telemetry.imports.targets import known_targets
from marsarm.telemetry.read import Log, read_log
from sim.params import nominal_params
from simgap.common.errors import BadRequest


def import_into(folder: Path, table: bytes, mapping: str, name: str = "table.parquet") -> Log:
    (folder / name).write_bytes(table)
    (folder / "map.toml").write_text(mapping)
    request = ImportRequest(folder / name, folder / "map.toml", folder / "out.mcap")
    import_table(request, lambda *_: None)
    return read_log(request.log)


def same_packets(one: Log, other: Log) -> None:
    assert one.packets.keys() == other.packets.keys()
    for topic, packets in one.packets.items():
        assert packets.tobytes() == other[topic].tobytes(), topic
        assert np.array_equal(one.time_ns[topic], other.time_ns[topic]), topic


def test_a_parquet_table_of_a_run_is_that_run(run: Log, as_parquet: bytes, make: Any, tmp_path: Path) -> None:
    log = import_into(tmp_path, as_parquet, make.TIME + make.channels() + make.start())
    same_packets(run, log)
    assert log.commands == run.commands
    assert not log.truncated


def test_a_text_table_of_a_run_is_that_run(
    run: Log, columns: dict[str, Any], make: Any, tmp_path: Path
) -> None:
    sink = io.BytesIO()
    csv.write_csv(pa.table(columns), sink)
    same_packets(run, import_into(tmp_path, sink.getvalue(), make.TIME + make.channels(), "table.csv"))


def test_it_replays_as_it_ran(run: Log, as_parquet: bytes, make: Any, tmp_path: Path) -> None:
    log = import_into(tmp_path, as_parquet, make.TIME + make.channels() + make.start())
    params = nominal_params()
    assert log.header["params_sha256"] == digest(params)
    config = configure(params)
    state = boot(config, Mode[json.loads(log.header["boot"])["mode"]], make.reference())
    names = log["/sensors"].dtype.names or ()
    for tick, packet in enumerate(log["/sensors"]):
        sensors = Sensors(
            **{name: np.array(packet[name]) for name in names} | {"cycle": int(packet["cycle"])}
        )
        commands = (make.ASKED[tick],) if tick in make.ASKED else ()
        state, outputs = step(config, state, sensors, commands)
        recorded = run["/joint"][tick]
        for name in recorded.dtype.names or ():
            assert np.array_equal(recorded[name], getattr(outputs.joint, name), equal_nan=False), (tick, name)
        assert np.array_equal(run["/drive"][tick]["setpoint_count"], outputs.drive.setpoint_count), tick


def test_the_first_mode_is_a_name_in_capitals_or_not(as_parquet: bytes, make: Any, tmp_path: Path) -> None:
    sensors = [name for name in known_targets() if name.startswith("/sensors.")]
    start = make.start().replace('"deployed"', '"DEPLOYED"')
    log = import_into(tmp_path, as_parquet, make.TIME + make.channels(*sensors) + start)
    assert json.loads(log.header["boot"])["mode"] == "DEPLOYED"


def test_a_command_behind_the_table_is_refused_with_its_line(
    as_parquet: bytes, make: Any, tmp_path: Path
) -> None:
    sensors = [name for name in known_targets() if name.startswith("/sensors.")]
    mapping = make.TIME + make.channels(*sensors) + make.start()
    ends_s = (make.N_CYCLES - 1) / 64
    last = f'[[command]]\ntype = "STOP"\nat_s = {ends_s}\n'
    log = import_into(tmp_path, as_parquet, mapping + last)
    assert log.commands[-1].tick == make.N_CYCLES - 1
    with pytest.raises(BadRequest) as caught:
        import_into(tmp_path, as_parquet, mapping + last + last.replace(str(ends_s), "100"))
    line = len((mapping + last).splitlines()) + 1
    message = f"map.toml:{line}: command: at_s is 100, the table ends at {ends_s}; it would never be given"
    assert message in str(caught.value)


def test_the_header_says_where_it_comes_from(as_parquet: bytes, make: Any, tmp_path: Path) -> None:
    log = import_into(
        tmp_path, as_parquet, 'arm = "theirs"\n' + make.TIME + make.channels("/sensors.current_A")
    )
    about = json.loads(log.header["request"])["import"]
    assert about["table"].endswith("table.parquet")
    assert (log.header["arm"], log.header["mjcf_sha256"]) == ("theirs", "unknown")
    assert "params" not in log.header
    topics = json.loads(log.header["channels"])
    assert topics["/imported/sensors"]["layout"] == [["current_A", "<f8", [5]]]


def test_a_repeat_is_known_as_one_to_the_diagnosis(
    as_parquet: bytes, make: Any, tmp_path: Path, run: Log
) -> None:
    session = '[session]\nname = "cold-again"\nblock = "cold"\n'
    import_into(tmp_path, as_parquet, make.TIME + session + make.channels() + make.start())
    (path,) = tmp_path.glob("*.mcap")
    here = load_recording(path)
    assert (here.name, here.block) == ("cold-again", "cold")
    assert here.temperature_C == pytest.approx(run["/sensors"]["winding_C"][0].mean())


def test_what_is_not_whole_is_kept_apart(as_parquet: bytes, make: Any, tmp_path: Path, run: Log) -> None:
    log = import_into(tmp_path, as_parquet, make.TIME + make.channels("/sensors.current_A", "/truth.time_s"))
    assert sorted(log.packets) == ["/imported/sensors", "/imported/truth"]
    assert np.array_equal(log["/imported/sensors"]["current_A"], run["/sensors"]["current_A"])


@pytest.mark.parametrize("tick", [0, 17, 1 << 38])
def test_the_first_row_may_be_any_cycle(as_parquet: bytes, make: Any, tmp_path: Path, tick: int) -> None:
    mapping = make.TIME + f"first_tick = {tick}\n" + make.channels("/sensors.current_A")
    log = import_into(tmp_path, as_parquet, mapping)
    assert log.ticks("/imported/sensors")[[0, -1]].tolist() == [tick, tick + make.N_CYCLES - 1]


START = """
[start]
mode = "deployed"
params = "arm.toml"

[start.reference]
calibrated = [true, true, true, true, true]
zero_rad = [0.1, -0.2, 0.3, 0.0, 1.5]
friction_Nm = [20.0, 20.0, 15.0, 5.0, 5.0]

[[command]]
type = "MOVE_JOINTS"
at_s = 0.125
angle_deg = [0, -60, 110, 130, 90]
"""


def test_a_start_and_a_command_are_understood(as_parquet: bytes, make: Any, tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text("[monitors]\ntilt_rad = 0.02\n")
    sensors = [name for name in known_targets() if name.startswith("/sensors.")]
    log = import_into(tmp_path, as_parquet, make.TIME + make.channels(*sensors) + START)
    assert json.loads(log.header["params"])["monitors"]["tilt_rad"] == 0.02
    began = json.loads(log.header["boot"])
    assert (began["mode"], began["reference"]["zero_rad"][0]) == ("DEPLOYED", 0.1)
    assert [(entry.tick, entry.name) for entry in log.commands] == [(8, "MoveJoints")]
    assert list(log.packets) == ["/sensors"]
