"""ROS 2 messages in a log, decoded by their own definitions, agree with the estimates of flight software."""

import json
from dataclasses import asdict, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from fsw.config import configure
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.transforms import Pose
from marsarm.telemetry.read import read_log
from marsarm.telemetry.robot_description import draw_scene
from sim.arms import arm_named
from sim.record import CycleRecord
from sim.setting import Surface, World
from simgap.files.decoding import BadMessage, make_decoder
from tests.tools import TOOLS

ROOT = Path(__file__).parents[3]
ARM = arm_named("as-built:3")
CONFIG = configure(ARM.params)
SCENE = draw_scene(World(surface=Surface((2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))), ARM.model)
ANGLES_RAD = np.random.default_rng(4).uniform(-3.0, 3.0, (24, 5))
LAYOUT = ROOT / "docs" / "marsarm.lichtblick.json"


def cycle(make: Any, tick: int, output_rad: Any) -> CycleRecord:
    record = make.cycle_at(tick)
    joint = replace(record.outputs.joint, output_rad=np.asarray(output_rad, float))
    return replace(record, outputs=replace(record.outputs, joint=joint))


def decoded(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Return log time and content of every message by topic, decoded by the definition in the log."""
    found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            decode = make_decoder(channel.message_encoding, schema.encoding, schema.name, schema.data)
            assert decode is not None
            content = asdict(decode(message.data))
            with pytest.raises(BadMessage):  # the definition reaches to the last byte
                decode(message.data[:-1])
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


@pytest.fixture(scope="module")
def path(make: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    cycles = [cycle(make, tick, angles) for tick, angles in enumerate(ANGLES_RAD)]
    return make.record(tmp_path_factory.mktemp("standard") / "run.mcap", cycles, config=CONFIG, scene=SCENE)


@pytest.fixture(scope="module")
def messages(path: Path) -> Any:
    return decoded(path)


def pose_of(transform: dict[str, Any]) -> Pose:
    q = [transform["rotation"][name] for name in "xyzw"]
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-12)
    return Pose(
        Rotation.from_quat(q).as_matrix(), np.array([transform["translation"][name] for name in "xyz"])
    )


def pose_in_rover(frames: dict[str, tuple[str, Pose]], child: str) -> Pose:
    """Return the pose of a frame in the rover frame."""
    poses = []
    while child != "rover":
        child, X = frames[child]
        poses.append(X)
    return reduce(lambda X, Y: Y @ X, poses)


def frames_in(*contents: dict[str, Any]) -> dict[str, tuple[str, Pose]]:
    return {
        one["child_frame_id"]: (one["header"]["frame_id"], pose_of(one["transform"]))
        for content in contents
        for one in content["transforms"]
    }


def test_the_frames_are_those_of_forward_kinematics(messages: Any) -> None:
    ((_, fixed),) = messages["/tf_static"]
    assert [time_ns for time_ns, _ in messages["/tf"]] == [0, 125_000_000, 250_000_000]
    for (_, moving), angles in zip(messages["/tf"], ANGLES_RAD[::8], strict=True):
        frames, poses = forward(CONFIG.arm, angles), frames_in(fixed, moving)
        for k in range(6):
            np.testing.assert_allclose(pose_in_rover(poses, f"arm{k + 1}").p, frames.X_RF.p[:, k], atol=1e-12)
            np.testing.assert_allclose(
                pose_in_rover(poses, f"arm{k + 1}").R, frames.X_RF.R[:, :, k], atol=1e-12
            )
        for tool in TOOLS:
            X_RT, X = tool_pose(CONFIG.arm, frames, tool), pose_in_rover(poses, tool)
            np.testing.assert_allclose(np.c_[X.R, X.p], np.c_[X_RT.R, X_RT.p], atol=1e-12)


def test_the_root_is_the_rover_with_z_up(messages: Any) -> None:
    ((_, fixed),) = messages["/tf_static"]
    parent, X = frames_in(fixed)["rover"]
    assert parent == "map"
    np.testing.assert_allclose(X.R, np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_joint_states_are_the_believed_outputs_at_8_hz(path: Path, messages: Any) -> None:
    log = read_log(path)
    states = messages["/joint_states"]
    assert [time_ns for time_ns, _ in states] == [0, 125_000_000, 250_000_000]
    for row, (time_ns, state) in enumerate(states):
        stamp = state["header"]["stamp"]
        assert stamp["sec"] * 10**9 + stamp["nanosec"] == time_ns
        assert list(state["name"]) == ["azimuth", "elevation", "elbow", "wrist", "turret"]
        assert list(state["position"]) == log["/joint"]["output_rad"][8 * row].tolist()
        np.testing.assert_array_equal(state["velocity"], log["/joint"]["motor_rate_rad_s"][8 * row])
        torque_Nm = CONFIG.torque_constant_Nm_A * log["/sensors"]["current_A"][8 * row]
        np.testing.assert_array_equal(state["effort"], torque_Nm)


def test_markers_lie_where_the_collision_check_has_its_shapes(messages: Any) -> None:
    ((_, shapes),) = messages["/arm_markers"]
    ((_, fixed),) = messages["/tf_static"]
    _, moving = messages["/tf"][0]
    poses, space = frames_in(fixed, moving), CONFIG.collision_geometry
    frames = forward(CONFIG.arm, ANGLES_RAD[0])
    markers = shapes["markers"]
    assert len({marker["id"] for marker in markers}) == len(markers)
    assert all(marker["frame_locked"] for marker in markers)
    assert {marker["header"]["frame_id"] for marker in markers} == {
        "rover",
        "arm6",
        *(f"link{k}" for k in range(1, 5)),
    }
    middles = [
        pose_in_rover(poses, frame)
        @ pose_of({"translation": marker["pose"]["position"], "rotation": marker["pose"]["orientation"]})
        for marker in markers
        if (frame := marker["header"]["frame_id"]) != "rover" and marker["type"] != 2
    ]
    for k, carrier in enumerate(space.arm.carrier):
        if space.arm.half_m[0, k] == 0:
            continue  # a sphere
        X_RC = (frames.X_RF if carrier == 5 else frames.X_RL)[int(carrier)]
        middle = (X_RC @ space.arm.X_CS[k]).p
        assert min(np.linalg.norm(X.p - middle) for X in middles) < 1e-12


def test_evrs_are_lines_for_the_log_panel(messages: Any) -> None:
    lines = [line for _, line in messages["/rosout"][:2]]
    assert [(line["name"], line["level"]) for line in lines] == [("Booted", 20), ("ContactMade", 20)]
    assert lines[0]["msg"] == "flight software up, parameters ééé"


def test_our_own_messages_follow_their_definitions(path: Path, messages: Any) -> None:
    log = read_log(path)
    for topic in ("/sensors", "/drive", "/joint", "/tool", "/truth"):
        for name in log[topic].dtype.names or ():
            values = [np.ravel(content[name.lower()]) for _, content in messages[topic]]
            np.testing.assert_array_equal(values, log[topic][name].reshape(len(values), -1))
    assert messages["/evr"][0][1]["name"] == "Booted"


def test_angles_that_are_not_finite_have_no_frames(make: Any, tmp_path: Path) -> None:
    cycles = [
        cycle(make, 0, [0, 0, np.inf, 0, 0]),
        cycle(make, 8, [0, np.nan, 0, 0, 0]),
        cycle(make, 16, 5 * [0.1]),
    ]
    found = decoded(make.record(tmp_path / "run.mcap", cycles, config=CONFIG))
    assert "/robot_description" not in found
    assert [time_ns for time_ns, _ in found["/tf"]] == [250_000_000]
    assert len(found["/joint_states"]) == 3


def test_derived_channels_are_marked_and_a_reader_of_ours_has_no_array_of_them(path: Path) -> None:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    derived = {c.topic for c in summary.channels.values() if "derived" in c.metadata}
    assert derived == {"/joint_states", "/tf", "/tf_static", "/arm_markers", "/rosout", "/robot_description"}
    assert {c.topic for c in summary.channels.values() if "truth" in c.metadata} == {"/truth"}
    log = read_log(path)
    assert not derived & log.packets.keys()
    channels = json.loads(log.header["channels"])
    assert {topic for topic, one in channels.items() if one["derived"]} == derived
    assert {topic for topic, one in channels.items() if one["truth"]} == {"/truth"}
    assert {one["id"]: (topic, one["schema"]) for topic, one in channels.items()} == {
        c.id: (c.topic, summary.schemas[c.schema_id].name) for c in summary.channels.values()
    }


def test_the_shipped_layout_shows_topics_and_fields_that_a_log_has(messages: Any) -> None:
    text = LAYOUT.read_text()
    layout = json.loads(text)
    kinds = {name.split("!")[0] for name in layout["configById"]}
    assert {"3D", "Plot", "RosOut"} <= kinds
    for panel in layout["configById"].values():
        for path_ in panel.get("paths", []):
            topic, field = path_["value"].split(".")
            assert field.split("[")[0] in messages[topic][0][1]
        for topic in [*panel.get("topics", {}), *filter(None, [panel.get("topicToRender")])]:
            assert topic in messages
