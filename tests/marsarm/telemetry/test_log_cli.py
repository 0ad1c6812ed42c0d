"""The verbs of logs: info, recover and export."""

import csv
import json
from dataclasses import replace
from math import prod
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from fsw.dictionary.enums import Mode
from marsarm.telemetry.export import export, index_suffixes
from marsarm.telemetry.inspection import select_channels
from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.tables import channels_document
from sim.record import CycleRecord
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from tests.marsarm.command import marsarm
from tests.marsarm.telemetry.lab import cycle_at, packet_of, record
from validation.benchmarks import record_log

CYCLES = 130


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return record_log(tmp_path_factory.mktemp("log") / "run.mcap", CYCLES, 1).read_bytes()


@pytest.fixture
def folder(tmp_path, written):
    (tmp_path / "run.mcap").write_bytes(written)
    begin, _ = read_records(written).chunks[60]
    broken = bytearray(written)
    broken[begin + 80] ^= 8
    (tmp_path / "broken.mcap").write_bytes(broken)
    (tmp_path / "cut.mcap").write_bytes(written[: begin + 50])
    return tmp_path


def run_json(folder, *words):
    ran = marsarm(folder, "log", *words, "--json")
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def test_a_log_cut_short_is_said_to_be(folder):
    found = run_json(folder, "info", "cut.mcap")
    assert not found["closed"]
    assert 0 < found["cycles"] < CYCLES
    assert "cut short" in marsarm(folder, "log", "info", "cut.mcap").stdout


def test_channels_of_a_part(folder):
    found = run_json(folder, "info", "run.mcap", "/joint/tick", "--from", "0.5", "--to", "1")["channels"]
    assert [(one["messages"], one["min"], one["max"]) for one in found] == [(32, 32, 63)]


def test_one_number_is_a_channel_and_both_spellings_are_taken(folder):
    values = read_log(folder / "run.mcap")["/joint"]["motor_rad"][:, 2]
    for pattern in ("/joint.motor_rad[2]", "/joint/motor_rad[2]"):
        (found,) = run_json(folder, "info", "run.mcap", pattern)["channels"]
        assert (found["channel"], found["type"]) == ("/joint.motor_rad[2]", "float64")
        assert (found["min"], found["max"]) == (values.min(), values.max())


def test_recover_saves_what_is_undamaged_and_says_what_is_lost(folder):
    found = run_json(folder, "recover", "broken.mcap", "good.mcap")
    assert found["saved"]["/joint"] == CYCLES - 1
    assert run_json(folder, "info", "good.mcap")["lost"] == found["lost"]
    assert "recovered from a damaged one" in marsarm(folder, "log", "info", "good.mcap").stdout
    assert "recovered" not in marsarm(folder, "log", "info", "run.mcap").stdout


def test_what_stands_behind_a_log_is_said_by_every_verb(folder, written):
    (folder / "two.mcap").write_bytes(written + written)
    found = run_json(folder, "info", "two.mcap")
    assert (found["closed"], found["trailing_bytes"], found["cycles"]) == (True, len(written), CYCLES)
    for words in (("export", "two.mcap", "tables"), ("info", "two.mcap", "*")):
        assert "after the end of the log" in marsarm(folder, "log", *words).stderr
    assert "after the end of the log" in run_json(folder, "recover", "two.mcap", "g.mcap")["notes"][0]


def test_a_log_is_never_replaced_by_what_is_made_of_it(folder, written):
    (folder / "joint.parquet").write_bytes(written)
    assert marsarm(folder, "log", "export", "joint.parquet", ".").returncode == 2
    assert (folder / "joint.parquet").read_bytes() == written


def test_tables_have_a_folder_and_no_name_of_a_file(folder):
    done = marsarm(folder, "log", "export", "run.mcap", "out.csv")
    assert done.returncode == 2
    assert "out out.csv: is no name of a folder" in done.stderr


HOSTILE = b"\x01\x00\x00\x00\x00\x00\xf0\x7f"
"""A signalling NaN with a payload; as an integer a large one, as a flag true."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    hostile = packet_of(CycleRecord, lambda size: (HOSTILE * size)[:size], tick=40)
    cycles = [*map(cycle_at, range(40)), hostile]
    return read_log(record(tmp_path_factory.mktemp("log") / "run.mcap", cycles))


def assert_same_bits(log: Log, topic: str, path: Path) -> None:
    table = pq.read_table(path)
    assert table["time_ns"].to_numpy().tolist() == log.time_ns[topic].tolist()
    for field in log[topic].dtype.names or ():
        values = log[topic][field].reshape(len(log[topic]), prod(log[topic][field].shape[1:]))
        for k, end in enumerate(index_suffixes(log[topic][field].shape[1:])):
            column = f"{field}{end}" if field != "tick" else "packet.tick"
            assert table[column].null_count == 0
            read = table[column].to_numpy()
            if field == "mode":
                assert read.tolist() == [Mode(one).name for one in values[:, k]]
                continue
            assert (read.dtype, read.tobytes()) == (values.dtype, values[:, k].tobytes()), column


def test_parquet_keeps_every_bit_of_every_topic(log: Log, tmp_path: Path) -> None:
    files = export(log, tmp_path / "tables", [], no_progress)
    assert files.keys() == log.time_ns.keys()
    for topic in log.packets:
        assert_same_bits(log, topic, files[topic])


def test_a_mode_that_is_not_known_is_named_with_those_that_are(log: Log, tmp_path: Path) -> None:
    joint = log["/joint"].copy()
    joint["mode"][3] = 99
    with pytest.raises(BadRequest, match=r"/joint\.mode: 99 is no mode; there are 0 STOWED, .* --topic$"):
        export(replace(log, packets={**log.packets, "/joint": joint}), tmp_path, ["/joint"], no_progress)


def test_parquet_keeps_header_and_units(log: Log, tmp_path: Path) -> None:
    (path,) = export(log, tmp_path, ["/joint"], no_progress).values()
    schema = pq.read_schema(path)
    assert json.loads(schema.metadata[b"marsarm.header"]) == dict(log.header)
    assert schema.metadata[b"marsarm.topic"] == b"/joint"
    assert schema.field("motor_rate_rad_s[3]").metadata == {b"unit": b"rad/s"}
    assert schema.field("mode").metadata is None
    assert b"marsarm.truth" not in schema.metadata
    (truth,) = export(log, tmp_path, ["/truth"], no_progress).values()
    assert b"marsarm.truth" in pq.read_schema(truth).metadata


def test_csv_reads_back_exactly(log: Log, tmp_path: Path) -> None:
    (path,) = export(log, tmp_path, ["/sensors"], no_progress, ".csv").values()
    with path.open(newline="") as file:
        names, *rows = csv.reader(file)
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    for k in range(5):
        due = log["/sensors"]["resolver_rad"][:, k]
        assert np.array_equal([float(word) for word in columns[f"resolver_rad[{k}]"]], due, equal_nan=True)
        counts = log["/sensors"]["encoder_count"][:, k].tolist()
        assert [int(word) for word in columns[f"encoder_count[{k}]"]] == counts
    assert set(columns["switch_closed[0]"]) <= {"0", "1"}


def test_events_and_commands_are_tables_too(log: Log, tmp_path: Path) -> None:
    files = export(log, tmp_path / "tables", ["/evr", "/command"], no_progress)
    evrs = pq.read_table(files["/evr"]).to_pylist()
    assert (evrs[0]["name"], evrs[0]["severity"]) == ("Booted", "ACTIVITY_HI")
    assert json.loads(evrs[0]["fields_json"]) == {"params_sha256": "ééé"}
    assert pq.read_table(files["/command"])["name"].to_pylist()[:2] == ["Stop", "GuardedMove"]


def test_channels_by_pattern_with_their_ranges(log: Log) -> None:
    chosen = select_channels(log, ["/joint/motor_rad*", "/sensors/switch_closed"])
    rad, flags = channels_document(log, chosen)["channels"]
    assert (rad["channel"], rad["type"], rad["unit"]) == ("/joint.motor_rad", "float64[5]", "rad")
    finite = log["/joint"]["motor_rad"][np.isfinite(log["/joint"]["motor_rad"])]
    assert (rad["min"], rad["max"]) == (finite.min(), finite.max())
    assert rad["not_finite"] >= 5
    assert (flags["min"], flags["max"]) == (0, 1)
    every = sum(len(packets.dtype.names or ()) for packets in log.packets.values())
    assert len(select_channels(log)) == every
