"""The verbs of logs: info, recover and export; what is recovered, bit for bit; other tools read the logs."""

import csv
import json
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import NonSeekingReader, make_reader

from fsw.dictionary.enums import Mode
from marsarm.telemetry.export import export, index_suffixes
from marsarm.telemetry.format import TICK_NS, LogDamaged, LostMessages
from marsarm.telemetry.inspection import select_channels
from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recover import RecoveryReport, recover
from marsarm.telemetry.tables import channels_document
from sim.record import CycleRecord
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from simgap.files.mcap_log import BadMessage, make_decoder
from tests.marsarm.command import SHORT_RUN, marsarm, marsarm_json
from tests.marsarm.runs.conftest import initialise_exactly
from tests.marsarm.telemetry.lab import cycle_at, packet_of, record
from validation.benchmarks import record_log
from validation.broken_logs import CUT_EVERY, change_records, flip_bits, is_part, original, truncate_file

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


def test_a_log_cut_short_is_said_to_be(folder):
    found = marsarm_json(folder, "log", "info", "cut.mcap")
    assert not found["closed"]
    assert 0 < found["cycles"] < CYCLES
    assert "cut short" in marsarm(folder, "log", "info", "cut.mcap").stdout


def test_channels_of_a_part(folder):
    words = ("/joint/tick", "--from", "0.5", "--to", "1")
    found = marsarm_json(folder, "log", "info", "run.mcap", *words)["channels"]
    assert [(one["messages"], one["min"], one["max"]) for one in found] == [(32, 32, 63)]


def test_one_number_is_a_channel_and_both_spellings_are_taken(folder):
    values = read_log(folder / "run.mcap")["/joint"]["motor_rad"][:, 2]
    for pattern in ("/joint.motor_rad[2]", "/joint/motor_rad[2]"):
        (found,) = marsarm_json(folder, "log", "info", "run.mcap", pattern)["channels"]
        assert (found["channel"], found["type"]) == ("/joint.motor_rad[2]", "float64")
        assert (found["min"], found["max"]) == (values.min(), values.max())


def test_recover_saves_what_is_undamaged_and_says_what_is_lost(folder):
    found = marsarm_json(folder, "log", "recover", "broken.mcap", "good.mcap")
    assert found["saved"]["/joint"] == CYCLES - 1
    assert marsarm_json(folder, "log", "info", "good.mcap")["lost"] == found["lost"]
    assert "recovered from a damaged one" in marsarm(folder, "log", "info", "good.mcap").stdout
    assert "recovered" not in marsarm(folder, "log", "info", "run.mcap").stdout


def test_what_stands_behind_a_log_is_said_by_every_verb(folder, written):
    (folder / "two.mcap").write_bytes(written + written)
    found = marsarm_json(folder, "log", "info", "two.mcap")
    assert (found["closed"], found["trailing_bytes"], found["cycles"]) == (True, len(written), CYCLES)
    for words in (("export", "two.mcap", "tables"), ("info", "two.mcap", "*")):
        assert "after the end of the log" in marsarm(folder, "log", *words).stderr
    found = marsarm_json(folder, "log", "recover", "two.mcap", "g.mcap")
    assert "after the end of the log" in found["notes"][0]


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


def test_parquet_keeps_every_bit_of_every_topic(log, tmp_path):
    files = export(log, tmp_path / "tables", [], no_progress)
    assert files.keys() == log.time_ns.keys()
    for topic in log.packets:
        assert_same_bits(log, topic, files[topic])


def test_a_mode_that_is_not_known_is_named_with_those_that_are(log, tmp_path):
    joint = log["/joint"].copy()
    joint["mode"][3] = 99
    with pytest.raises(BadRequest, match=r"/joint\.mode: 99 is no mode; there are 0 STOWED, .* --topic$"):
        export(replace(log, packets={**log.packets, "/joint": joint}), tmp_path, ["/joint"], no_progress)


def test_parquet_keeps_header_and_units(log, tmp_path):
    (path,) = export(log, tmp_path, ["/joint"], no_progress).values()
    schema = pq.read_schema(path)
    assert json.loads(schema.metadata[b"marsarm.header"]) == dict(log.header)
    assert schema.metadata[b"marsarm.topic"] == b"/joint"
    assert schema.field("motor_rate_rad_s[3]").metadata == {b"unit": b"rad/s"}
    assert schema.field("mode").metadata is None
    assert b"marsarm.truth" not in schema.metadata
    (truth,) = export(log, tmp_path, ["/truth"], no_progress).values()
    assert b"marsarm.truth" in pq.read_schema(truth).metadata


def test_csv_reads_back_exactly(log, tmp_path):
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


def test_events_and_commands_are_tables_too(log, tmp_path):
    files = export(log, tmp_path / "tables", ["/evr", "/command"], no_progress)
    evrs = pq.read_table(files["/evr"]).to_pylist()
    assert (evrs[0]["name"], evrs[0]["severity"]) == ("Booted", "ACTIVITY_HI")
    assert json.loads(evrs[0]["fields_json"]) == {"params_sha256": "ééé"}
    assert pq.read_table(files["/command"])["name"].to_pylist()[:2] == ["Stop", "GuardedMove"]


def test_channels_by_pattern_with_their_ranges(log):
    chosen = select_channels(log, ["/joint/motor_rad*", "/sensors/switch_closed"])
    rad, flags = channels_document(log, chosen)["channels"]
    assert (rad["channel"], rad["type"], rad["unit"]) == ("/joint.motor_rad", "float64[5]", "rad")
    finite = log["/joint"]["motor_rad"][np.isfinite(log["/joint"]["motor_rad"])]
    assert (rad["min"], rad["max"]) == (finite.min(), finite.max())
    assert rad["not_finite"] >= 5
    assert (flags["min"], flags["max"]) == (0, 1)
    every = sum(len(packets.dtype.names or ()) for packets in log.packets.values())
    assert len(select_channels(log)) == every


N_CYCLES = 12
PACKETS = ["/sensors", "/drive", "/joint", "/tool", "/truth"]


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the log of another run, longer than the first."""
    folder = tmp_path_factory.mktemp("other")
    cycles = map(cycle_at, range(2 * N_CYCLES))
    return bytes(record(folder / "run.mcap", cycles, chunk_cycles=1).read_bytes())


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("log")
    path = record(folder / "run.mcap", map(cycle_at, range(N_CYCLES)), chunk_cycles=1)
    return path.read_bytes()


def chunk_of(data: bytes, tick: int) -> int:
    """Return the byte where the chunk with the messages of a tick begins."""
    found = original(data).chunks
    return next(one.at for one in found if one.first_ns <= tick * TICK_NS <= one.last_ns)


def saved(folder: Path, data: bytes) -> RecoveryReport:
    (folder / "bad.mcap").write_bytes(data)
    return recover(folder / "bad.mcap", folder / "good.mcap", lambda *_: None)


def broken(data: bytes, *places: int) -> bytes:
    changed = bytearray(data)
    for at in places:
        changed[at] ^= 1
    return bytes(changed)


def test_the_losses_of_a_broken_chunk_are_reported_by_topic_and_time(tmp_path, data):
    recovered = saved(tmp_path, broken(data, chunk_of(data, 5) + 200))
    due = {topic: LostMessages(topic, 1, 4 * TICK_NS, 6 * TICK_NS) for topic in PACKETS}
    lost = {one.topic: one for one in recovered.lost}
    assert {topic: lost[topic] for topic in PACKETS} == due
    assert (lost["/evr"].count, lost["/command"].count) == (2, 2)
    with pytest.raises(LogDamaged):
        read_log(tmp_path / "bad.mcap")
    log = read_log(tmp_path / "good.mcap")
    assert log.lost == recovered.lost
    assert log.ticks("/joint").tolist() == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert not log.truncated


def test_losses_at_the_end_are_of_an_unknown_number(tmp_path, data):
    recovered = saved(tmp_path, broken(data, chunk_of(data, N_CYCLES - 1) + 200))
    assert recovered.lost == (LostMessages(None, None, (N_CYCLES - 2) * TICK_NS, None),)
    assert recovered.lost[0].sentence == "an unknown number of messages of all topics lost, after 0.156250 s"


def test_a_rare_topic_may_have_lost_any_number_of_messages_at_a_break(tmp_path):
    cycles = [cycle_at(tick) if tick < 3 else replace(cycle_at(tick), commands=()) for tick in range(8)]
    data = record(tmp_path / "run.mcap", cycles, chunk_cycles=1).read_bytes()
    recovered = saved(tmp_path, broken(data, chunk_of(data, 5) + 200))
    assert LostMessages("/command", None, 4 * TICK_NS, 6 * TICK_NS) in recovered.lost


def test_losses_at_the_beginning_are_reported(tmp_path, data):
    recovered = saved(tmp_path, broken(data, chunk_of(data, 0) + 200))
    assert LostMessages("/joint", 1, None, TICK_NS) in recovered.lost


def test_an_undamaged_log_loses_nothing(tmp_path, data):
    assert saved(tmp_path, data).lost == ()
    assert is_part(read_log(tmp_path / "good.mcap"), read_log(tmp_path / "bad.mcap"))


@pytest.mark.parametrize("end", ["closed", "killed"])
def test_two_runs_in_one_file_do_not_become_one_log(tmp_path, data, other, end):
    first = data if end == "closed" else data[: chunk_of(data, 8)]
    recovered = saved(tmp_path, first + other)
    (tmp_path / "first.mcap").write_bytes(first)
    assert is_part(read_log(tmp_path / "good.mcap"), read_log(tmp_path / "first.mcap"))
    assert recovered.saved["/joint"] == (N_CYCLES if end == "closed" else 8)
    assert "after the end of the log are left out" in recovered.notes[0]


@pytest.mark.parametrize("behind", [b"garbage", b"\0" * 4096])
def test_bytes_after_a_log_are_reported_and_cost_no_message(tmp_path, data, other, behind):
    for rest in (behind, other):
        (tmp_path / "run.mcap").write_bytes(data + rest)
        log = read_log(tmp_path / "run.mcap")
        assert (log.truncated, log.trailing_bytes, len(log["/joint"])) == (False, len(rest), N_CYCLES)


def test_a_chunk_that_is_there_twice_is_saved_once(tmp_path, data):
    a, b = (chunk_of(data, tick) for tick in (4, 5))
    recovered = saved(tmp_path, data[:b] + data[a:b] + data[b:])
    assert "duplicate messages left out" in recovered.notes[0]
    assert read_log(tmp_path / "good.mcap").ticks("/joint").tolist() == list(range(N_CYCLES))


def test_a_lost_header_is_reported_and_the_values_are_saved(tmp_path, data):
    at = data.index(b"nominal")
    recovered = saved(tmp_path, broken(data, at))
    assert recovered.header_lost
    log = read_log(tmp_path / "good.mcap")
    assert (len(log["/joint"]), list(log.header)) == (N_CYCLES, ["channels"])


@pytest.mark.parametrize("kept", [1.0, 0.6], ids=["closed", "cut short"])
def test_bits_flipped_anywhere(tmp_path, data, kept):
    found = flip_bits(original(data[: int(kept * len(data))]), 30, 6, tmp_path)
    assert found.wrong == []
    assert found.read["detected"] > 10


def test_files_cut_anywhere(tmp_path, data):
    found = truncate_file(original(data), CUT_EVERY // 4, tmp_path)
    assert found.wrong == []
    assert found.read["cut"] > 5


def test_records_that_do_not_fit_are_read_or_refused(tmp_path, data):
    found = change_records(original(data[: int(0.6 * len(data))]), 60, 6, tmp_path)
    assert (found.wrong, found.read.keys()) == ([], {"read", "refused"})


ROCK = "[world.surface]\nposition_m = [2.05, 0.1, -0.25]\nnormal = [-0.5, 0.1, -0.85]\n\n[[command]]"
KINDS = ["run", "recovered"]


@pytest.fixture(scope="module")
def short_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, a copy with a broken chunk, and the log recovered from it."""
    made = tmp_path_factory.mktemp("viewers")
    (made / "short.toml").write_text(SHORT_RUN.replace("[[command]]", ROCK))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("marsarm.runs.execution.initialise_joints", initialise_exactly)
        marsarm_json(made, "run", "short.toml", "--log", "run.mcap")
    data = bytearray((made / "run.mcap").read_bytes())
    chunks = read_records(bytes(data)).chunks
    data[chunks[len(chunks) // 2][0] + 80] ^= 1
    (made / "broken.mcap").write_bytes(data)
    recover(made / "broken.mcap", made / "recovered.mcap", lambda *_: None)
    return made


@pytest.mark.parametrize("kind", KINDS)
def test_the_readers_of_mcap_take_it(short_logs, kind):
    path = short_logs / f"{kind}.mcap"
    counts = {topic: len(times) for topic, times in read_log(path).time_ns.items()}
    for reader in (make_reader, NonSeekingReader):
        with path.open("rb") as file:
            found: dict[str, int] = {}
            for _, channel, _ in reader(file, validate_crcs=True).iter_messages():
                found[channel.topic] = found.get(channel.topic, 0) + 1
        assert counts == {topic: found[topic] for topic in counts}


def test_messages_follow_their_definitions(short_logs):
    log = read_log(short_logs / "run.mcap")
    found: dict[str, list[Any]] = {}
    with (short_logs / "run.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            decode = make_decoder(channel.message_encoding, schema.encoding, schema.name, schema.data)
            assert decode is not None
            with pytest.raises(BadMessage):  # the definition reaches to the last byte
                decode(message.data[:-1])
            found.setdefault(channel.topic, []).append(decode(message.data))
    for topic, packets in log.packets.items():
        for name in packets.dtype.names or ():
            values = [np.ravel(getattr(one, name.lower())) for one in found[topic]]
            np.testing.assert_array_equal(values, packets[name].reshape(len(values), -1))
    assert [one.name for one in found["/evr"]] == [one.name for one in log.evrs]
