"""Other tools open the logs: the reader of MCAP, pymcap-cli and Rerun.

`make viewers` installs the last two where possible; without them their tests are skipped.
"""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader, make_reader

from ground.telemetry.mcap_reader import read_records
from ground.telemetry.read import read_log
from ground.telemetry.recover import recover
from tests.ground.command import marsarm

SCENARIO = """\
title = "A short move"
summary = "Turn the turret a little."
start = "ready"

[[command]]
type = "MOVE_JOINT"
joint = "turret"
angle_deg = 95

[[check]]
type = "done"
"""
KINDS = ["run", "recovered"]

needs_pymcap = pytest.mark.skipif(
    find_spec("pymcap_cli") is None, reason="pymcap-cli is not installed; `make viewers` installs it"
)
needs_rerun = pytest.mark.skipif(
    find_spec("rerun") is None, reason="rerun-sdk is not installed; `make viewers` installs it"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, a copy with a broken chunk, and the log recovered from it."""
    made = tmp_path_factory.mktemp("viewers")
    (made / "short.toml").write_text(SCENARIO)
    ran = marsarm(made, "run", "short.toml", "--log", "run.mcap", "--json")
    assert ran.returncode == 0, ran.stderr
    data = bytearray((made / "run.mcap").read_bytes())
    chunks = read_records(made / "run.mcap", bytes(data)).chunks
    data[chunks[len(chunks) // 2].begin + 30] ^= 1
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
