"""Logs in MCAP: fields of messages are signals with the times of their messages."""

import json
import struct

import numpy as np
import pytest
from mcap.writer import Writer

from helpers.robot_folder import write_robot
from simgap.common.errors import RobotError
from simgap.files.mcap_log import BadMessage, make_decoder
from simgap.loading import load

JOINT_STATE = """# joints
std_msgs/Header header
string[] name
float64[] position
float32[2] current
uint8 KIND=3
bool ok
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
NO_MOTION = ('columns = ["motion"]\n\n[conditions.gain]\ncolumn = "gain"', "")
FIELDS = (
    NO_MOTION,
    ('[time]\ncolumn = "t"\nunit = "ms"', ""),
    ('gain_column = "gain"\n', ""),
    *(('"q1"', '"/joints.position[0]"'), ('"q2"', '"/joints.position[1]"')),
    *(('"c1"', '"/command.deg"'), ('"m2"', '"/joints.current[1]"')),
)


def joint_state(position, current, stamp_s=1.5):
    """Encode a message in CDR, little endian."""
    stamp = struct.pack("<iI", int(stamp_s), int(stamp_s % 1 * 1e9))
    body = stamp + struct.pack("<I", 5) + b"base\0" + b"\0" * 3
    body += struct.pack("<I", 2) + struct.pack("<I", 2) + b"a\0" + b"\0" * 2 + struct.pack("<I", 2) + b"b\0"
    body += b"\0" * (-len(body) % 4) + struct.pack("<I", len(position))
    body += b"\0" * (-len(body) % 8) + struct.pack(f"<{len(position)}d", *position)
    return b"\x00\x01\x00\x00" + body + struct.pack("<2f", *current) + b"\x01"


def write_mcap(path, encoding="ros2msg", n=5, command=None):
    """Write joint states at 100 Hz and commands at 50 Hz."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/JointState", encoding, JOINT_STATE.encode())
        joints = writer.register_channel("/joints", "cdr", schema)
        schema = writer.register_schema("c", "jsonschema", b"{}")
        channel = writer.register_channel("/command", "json", schema)
        for k in range(n):
            now = 1_700_000_000_000_000_000 + k * 10_000_000
            writer.add_message(joints, now, joint_state([k, 4096.0 * k], [0.0, k]), now)
            if k % 2 == 0:
                text = command or json.dumps({"deg": 9.0 * k, "name": "x"})
                writer.add_message(channel, now, text.encode(), now)
        writer.finish()
    return path


def test_each_signal_has_the_times_of_its_messages(tmp_path):
    (motion,) = load(write_robot(tmp_path, *FIELDS), write_mcap(tmp_path / "run.mcap")).motions
    assert motion.name == "run"
    shoulder, elbow = motion.joints["shoulder"], motion.joints["elbow"]
    np.testing.assert_allclose(shoulder.position.time_s, np.arange(5) * 0.01)
    np.testing.assert_allclose(shoulder.command.time_s, [0.0, 0.02, 0.04])
    np.testing.assert_allclose(shoulder.command.value, np.radians([0.0, 18.0, 36.0]))
    np.testing.assert_allclose(elbow.position.value, 2 * np.pi / 50 * np.arange(5))
    np.testing.assert_allclose(elbow.torque.value, np.arange(5) * 0.05)


def test_a_message_is_read_by_its_definition():
    decode = make_decoder("cdr", "ros2msg", "sensor_msgs/msg/JointState", JOINT_STATE.encode())
    found = decode(joint_state([1.0, 2.0], [3.0, 4.0]))
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (1, 500_000_000)
    assert (found.name, found.ok) == (["a", "b"], True)
    np.testing.assert_array_equal(found.position, [1.0, 2.0])
    np.testing.assert_array_equal(found.current, [3.0, 4.0])


def test_a_message_that_is_cut_short_or_of_an_unknown_type_is_refused():
    decode = make_decoder("cdr", "ros2msg", "sensor_msgs/JointState", JOINT_STATE.encode())
    with pytest.raises(BadMessage, match="does not fit its definition"):
        decode(joint_state([1.0], [3.0, 4.0])[:-8])
    with pytest.raises(BadMessage, match="a message of a/B does not fit its definition"):
        make_decoder("cdr", "ros2msg", "a/B", b"odd/Kind x")(b"\0\1\0\0")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "/joints.position[0]",
            "/joint.position[0]",
            "has no column '/joint', which robot file or mapping names",
        ),
        ("/joints.position[0]", "/joints.place[0]", "'/joints.place[0]': there is no 'place' in a message"),
        (
            "/joints.position[0]",
            "/joints.position[7]",
            "has no column '/joints.position[7]', which robot file or mapping names; did you mean",
        ),
        ("/joints.position[0]", "/joints.name[0]", "'/joints.name[a]' has str; name a number in it"),
        ("/joints.position[0]", "/joints.position 0", "there is no 'position 0' in a message, which has"),
        ("/joints.position[0]", "/joints.position[0", "is no field; write a topic and a field"),
    ],
)
def test_a_field_that_is_not_there_is_named(tmp_path, old, new, said):
    robot = write_robot(tmp_path, *FIELDS)
    robot.write_text(robot.read_text().replace(old, new))
    with pytest.raises(RobotError) as error:
        load(robot, write_mcap(tmp_path / "run.mcap"))
    assert said in str(error.value)


def test_an_unknown_encoding_and_a_damaged_file_are_refused(tmp_path):
    robot = write_robot(tmp_path, *FIELDS)
    said = "topic '/joints' is encoded as cdr with omgidl; write json, or a message of ROS"
    with pytest.raises(RobotError, match=said):
        load(robot, write_mcap(tmp_path / "run.mcap", encoding="omgidl"))
    path = write_mcap(tmp_path / "run.mcap")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(RobotError, match="cannot be read"):
        load(robot, path)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ('{"deg": {"sec": null}}', "column '/command.deg' is empty; a signal needs numbers"),
        ('{"deg": {"sec": [1]}}', "'/command.deg' has list; name a number in it"),
        ('{"deg": 1' + 400 * "0" + "}", "column '/command.deg', motion 'run': is no finite number at 0 s"),
        (100_000 * "[", "a message is nested too deeply; write fields of a few levels"),
    ],
)
def test_a_message_without_a_usable_number_is_refused(tmp_path, command, said):
    with pytest.raises(RobotError) as error:
        load(write_robot(tmp_path, *FIELDS), write_mcap(tmp_path / "run.mcap", command=command))
    assert said in str(error.value)


def test_a_log_in_mcap_is_one_motion(tmp_path):
    robot = write_robot(tmp_path, *FIELDS[1:], (NO_MOTION[0], 'columns = ["/command.name"]'))
    with pytest.raises(RobotError, match="a log of messages has no rows; in "):
        load(robot, write_mcap(tmp_path / "run.mcap"))
