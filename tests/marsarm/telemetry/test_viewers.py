"""Other tools read the logs: every message is in MCAP, in the form that its definition says."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader

from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recover import recover
from simgap.files.mcap_log import BadMessage, make_decoder
from tests.marsarm.command import SHORT_RUN, marsarm
from tests.marsarm.runs.conftest import initialise_exactly

ROCK = "[world.surface]\nposition_m = [2.05, 0.1, -0.25]\nnormal = [-0.5, 0.1, -0.85]\n\n[[command]]"
KINDS = ["run", "recovered"]


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
