"""Other tools open the logs: readers of MCAP, pymcap-cli and Rerun.

`pip install '.[viewers]'` installs all but the first; without them their tests are skipped.
"""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader

from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recover import recover
from simgap.files.decoding import BadMessage, make_decoder
from tests.marsarm.command import SHORT_RUN, marsarm
from tests.marsarm.runs.conftest import initialise_exactly

ROCK = "[world.surface]\nposition_m = [2.05, 0.1, -0.25]\nnormal = [-0.5, 0.1, -0.85]\n\n[[command]]"
KINDS = ["run", "recovered"]

needs_pymcap = pytest.mark.skipif(
    find_spec("pymcap_cli") is None, reason="pymcap-cli is not installed; pip install '.[viewers]'"
)
needs_rerun = pytest.mark.skipif(
    find_spec("rerun") is None, reason="rerun-sdk is not installed; pip install '.[viewers]'"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, a copy with a broken chunk, and the log recovered from it."""
    made = tmp_path_factory.mktemp("viewers")
    (made / "short.toml").write_text(SHORT_RUN.replace("[[command]]", ROCK))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("marsarm.runs.execution.initialise_joints", initialise_exactly)
        ran = marsarm(made, "run", "short.toml", "--log", "run.mcap", "--json")
    assert ran.returncode == 0, ran.stderr
    data = bytearray((made / "run.mcap").read_bytes())
    chunks = read_records(bytes(data)).chunks
    data[chunks[len(chunks) // 2][0] + 80] ^= 1
    (made / "broken.mcap").write_bytes(data)
    recover(made / "broken.mcap", made / "recovered.mcap", lambda *_: None)
    return made


def tool(name: str, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a program of a package in this Python."""
    command = [str(Path(sys.executable).with_name(name)), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize("kind", KINDS)
def test_the_readers_of_mcap_take_it(folder: Path, kind: str) -> None:
    path = folder / f"{kind}.mcap"
    counts = {topic: len(times) for topic, times in read_log(path).time_ns.items()}
    for reader in (make_reader, NonSeekingReader):
        with path.open("rb") as file:
            found: dict[str, int] = {}
            for _, channel, _ in reader(file, validate_crcs=True).iter_messages():
                found[channel.topic] = found.get(channel.topic, 0) + 1
        assert counts == {topic: found[topic] for topic in counts}


@needs_pymcap
@pytest.mark.parametrize("kind", KINDS)
def test_pymcap_finds_nothing_wrong(folder: Path, kind: str) -> None:
    ran = tool("pymcap-cli", "--quiet", "doctor", folder / f"{kind}.mcap", "--format", "jsonl")
    assert ran.returncode == 0, ran.stdout
    assert '"errors":0,"warnings":0' in ran.stdout


@needs_pymcap
def test_pymcap_sees_what_is_broken(folder: Path) -> None:
    assert tool("pymcap-cli", "--quiet", "doctor", folder / "broken.mcap").returncode != 0


@needs_rerun
@pytest.mark.parametrize("kind", KINDS)
def test_rerun_opens_it_without_an_error(folder: Path, kind: str) -> None:
    path = folder / f"{kind}.mcap"
    checked = tool("rerun", "mcap", "check", "--full", path)
    assert checked.returncode == 0, checked.stderr
    converted = tool("rerun", "mcap", "convert", path, "-o", path.with_suffix(".rrd"))
    assert converted.returncode == 0, converted.stderr
    assert "ERROR" not in converted.stdout + converted.stderr
    assert tool("rerun", "rrd", "verify", path.with_suffix(".rrd")).returncode == 0


def test_messages_follow_their_definitions(folder: Path) -> None:
    log = read_log(folder / "run.mcap")
    found: dict[str, list[Any]] = {}
    with (folder / "run.mcap").open("rb") as file:
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
