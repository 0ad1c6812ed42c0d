"""Other tools open the logs: readers of MCAP and of ROS 2 messages, pymcap-cli and Rerun.

`pip install '.[viewers]'` installs all but the first; without them their tests are skipped.
"""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mcap.reader import NonSeekingReader, make_reader

from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recover import recover
from tests.marsarm.command import SHORT_RUN, marsarm
from tests.marsarm.runs.conftest import initialise_exactly
from tests.tools import TOOLS

ROCK = "[world.surface]\nposition_m = [2.05, 0.1, -0.25]\nnormal = [-0.5, 0.1, -0.85]\n\n[[command]]"
KINDS = ["run", "recovered"]

needs_pymcap = pytest.mark.skipif(
    find_spec("pymcap_cli") is None, reason="pymcap-cli is not installed; pip install '.[viewers]'"
)
needs_rerun = pytest.mark.skipif(
    find_spec("rerun") is None, reason="rerun-sdk is not installed; pip install '.[viewers]'"
)
needs_ros2 = pytest.mark.skipif(
    find_spec("mcap_ros2") is None, reason="mcap-ros2-support is not installed; pip install '.[viewers]'"
)
RIGID_PARTS = {"rover", "rock", "ground", "arm1", "arm6", *(f"link{k}" for k in range(1, 6))}
PARTS = RIGID_PARTS | set(TOOLS)
BLUEPRINT = Path(__file__).parents[3] / "docs" / "marsarm.rbl"


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


@needs_ros2
@pytest.mark.parametrize("kind", KINDS)
def test_the_reader_of_foxglove_finds_rock_ground_and_arm_in_frames_of_the_transforms(
    folder: Path, kind: str
) -> None:
    from mcap_ros2.decoder import DecoderFactory

    topics = ["/robot_description", "/tf_static", "/tf"]
    with (folder / f"{kind}.mcap").open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics)
        found = {one.channel.topic: one.decoded_message for one in messages}
    robot = ElementTree.fromstring(found["/robot_description"].data)
    assert {link.attrib["name"] for link in robot.iter("link") if link.find("visual") is not None} == PARTS
    transforms = [one for topic in topics[1:] for one in found[topic].transforms]
    edges = {(one.header.frame_id, one.child_frame_id) for one in transforms}
    assert len(edges) == len(transforms)
    assert edges == {
        (joint.find("parent").attrib["link"], joint.find("child").attrib["link"])
        for joint in robot.findall("joint")
    }


@needs_rerun
@pytest.mark.parametrize("kind", KINDS)
def test_rerun_draws_rock_ground_and_arm_as_shapes_in_frames(folder: Path, kind: str) -> None:
    from rerun.chunk import RrdReader

    rrd = folder / f"{kind}-drawn.rrd"
    converted = tool("rerun", "mcap", "convert", folder / f"{kind}.mcap", "-o", rrd)
    assert converted.returncode == 0, converted.stderr
    drawn: dict[str, set[str]] = {}
    for chunk in RrdReader(rrd).stream().to_chunks():
        match str(chunk.entity_path).split("/"):
            case ["", "marsarm", "visual_geometries", part, _]:
                columns = chunk.to_record_batch().schema.names
                drawn.setdefault(part, set()).update(str(name).split(":")[0] for name in columns)
    assert drawn.keys() == PARTS
    for components in drawn.values():
        assert components & {"Boxes3D", "Cylinders3D"}
        assert {"CoordinateFrame", "InstancePoses3D"} <= components
        assert not any("mcap" in name.lower() for name in components)  # as it is drawn, not raw


@needs_rerun
def test_rerun_takes_the_shipped_blueprint() -> None:
    assert tool("rerun", "rrd", "verify", BLUEPRINT).returncode == 0
