"""Logs of joint states in MCAP and in bags, and a robot file that reads them by topic."""

import json

import numpy as np
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START_NS = 1_700_000_000_000_000_000
BY_TOPIC = """name = "two links"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 250.0

[joints.shoulder]
mode = "position"
kp_Nm_rad = 15.0
topic = "/joint_states"
command_topic = "/joint_command"

[joints.elbow]
mode = "torque"
topic = "/joint_states"
"""
BY_PLACE = BY_TOPIC.replace(
    '[joints.elbow]\nmode = "torque"\ntopic = "/joint_states"\n',
    '[joints.elbow]\nmode = "torque"\nposition = { column = "/joint_states.position[1]", unit = "rad" }\n',
).replace(
    'topic = "/joint_states"\ncommand_topic',
    'position = { column = "/joint_states.position[0]", unit = "rad" }\ncommand_topic',
)
JOINT_STATE = "sensor_msgs/msg/JointState"


def joint_state(k, order=("shoulder", "elbow"), **fields):
    """Make the message of row k: position k of the shoulder and -k of the elbow."""
    values = {"shoulder": float(k), "elbow": -float(k), "finger": 99.0}
    names = {"name": list(order), "position": [values[one] for one in order]}
    return names | {"velocity": [], "effort": []} | fields


def rows(n=5, **fields):
    """Make states and commands at 100 Hz: topic, time [ns] and content."""
    found = []
    for k in range(n):
        time_ns = START_NS + k * 10_000_000
        order = ("shoulder", "elbow") if k % 2 == 0 else ("elbow", "shoulder")
        found.append(("/joint_states", time_ns, joint_state(k, order, **fields)))
        found.append(("/joint_command", time_ns, joint_state(10 * k)))
    return found


def ros_types(is_ros1=False):
    """Return the types of ROS, and a function that encodes a joint state."""
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    seq = {"seq": 0} if is_ros1 else {}
    header = store.types["std_msgs/msg/Header"](
        stamp=store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="", **seq
    )

    def encode(content):
        numbers = {name: np.array(content[name]) for name in ("position", "velocity", "effort")}
        message = store.types[JOINT_STATE](header=header, name=content["name"], **numbers)
        return (store.serialize_ros1 if is_ros1 else store.serialize_cdr)(message, JOINT_STATE)

    return store, encode


def write_mcap(path, messages, definition="", **options):
    """Write messages as JSON, or as ROS 2 does with this encoding of their definition; bytes are JSON."""
    store, encode = ros_types()
    schema = (JOINT_STATE, definition, store.generate_msgdef(JOINT_STATE, ros_version=2)[0].encode())
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=300, **options)
        writer.start()
        number = writer.register_schema(*(schema if definition else ("any", "jsonschema", b"{}")))
        topics = dict.fromkeys(topic for topic, _, _ in messages)
        encoding = "cdr" if definition else "json"
        channels = {topic: writer.register_channel(topic, encoding, number) for topic in topics}
        for topic, time_ns, content in messages:
            text = content if isinstance(content, bytes) else json.dumps(content).encode()
            writer.add_message(channels[topic], time_ns, encode(content) if definition else text, time_ns)
        writer.finish()
    return path


def write_bag(path, messages, is_packed=False):
    """Write a bag of ROS 1 for a file, packed by bzip2 on request, of ROS 2 in SQLite for a folder."""
    is_ros1 = path.suffix == ".bag"
    store, encode = ros_types(is_ros1)
    writer = Writer1(path) if is_ros1 else Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    if is_packed:
        writer.set_compression(Writer1.CompressionFormat.BZ2)
    with writer:
        topics = dict.fromkeys(topic for topic, _, _ in messages)
        connections = {one: writer.add_connection(one, JOINT_STATE, typestore=store) for one in topics}
        for topic, time_ns, content in messages:
            writer.write(connections[topic], time_ns, encode(content))
    return path
