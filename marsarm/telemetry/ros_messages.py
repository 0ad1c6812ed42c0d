"""ROS 2 messages for other tools: the encoder of joints, transforms and shapes.

They are computed from flight channels. With them, a viewer shows the arm of a log without configuration.
"""

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.collision.geometry import TURRET_FRAME as TURRET_CARRIER
from fsw.collision.geometry import RoundedBoxes
from fsw.config import Config
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import vector3
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import IDENTITY, Array, Pose, rotation_x, rotation_z
from marsarm.telemetry.robot_description import (
    ROOT_FRAME,
    ROVER_FRAME,
    TURRET_FRAME,
    DrawnScene,
    FixedFrame,
    TurningFrame,
    robot_description,
)
from marsarm.telemetry.schema import ROS_TIME, CdrWriter, ros_time
from marsarm.telemetry.topics import (
    JOINT_STATES_TOPIC,
    MARKERS_TOPIC,
    ROBOT_DESCRIPTION_TOPIC,
    TF_STATIC_TOPIC,
    TF_TOPIC,
)
from sim.record import CycleRecord

SAMPLE_CYCLES: Final = 8
"""Cycles between samples: 8 Hz; no joint turns by more than a degree between two samples."""

POSE_STRUCT: Final = struct.Struct("<7d")
CUBE, SPHERE, CYLINDER = 1, 2, 3
ARM_COLOUR: Final = (0.80, 0.55, 0.30, 0.9)
ROVER_COLOUR: Final = (0.75, 0.75, 0.78, 0.35)


class RosEncoder:
    """Encoder of the ROS 2 messages of one arm; the same sample gives the same bytes.

    A joint turns a frame `linkK` about z of `armK`; the link carries `arm(K+1)`. The frames of transforms
    and robot description are the same.
    """

    def __init__(self, config: Config, scene: DrawnScene | None = None) -> None:
        """Prepare the messages.

        Args:
            config: Configuration of the arm.
            scene: Visible shapes of the run; None for a log without a robot description.
        """
        self._config, self._is_first = config, True
        self._fixed = fixed_frames(config.arm, {} if scene is None else scene.frames)
        self._turning = turning_frames(config)
        self._description = (
            None if scene is None else robot_description(self._fixed, self._turning, scene.visuals)
        )
        self._constant_Nm_A = config.torque_constant_Nm_A.tolist()
        self._joints, self._joint_places = joint_state_template()
        self._frames, self._frame_places = transforms_template(
            [(one.parent, one.child) for one in self._turning]
        )

    def static_messages(self, time_ns: int) -> Iterator[tuple[str, bytes]]:
        """Yield topic and message of constant data.

        These are fixed frames, the robot description, and collision shapes of flight software.
        """
        message, places = transforms_template([(one.parent, one.child) for one in self._fixed])
        poses = [(*vector3(one.X.p), *quaternion(one.X.R)) for one in self._fixed]
        fill_transforms(message, places, time_ns, poses)
        yield TF_STATIC_TOPIC, bytes(message)
        if self._description is not None:
            yield ROBOT_DESCRIPTION_TOPIC, bytes(CdrWriter().text(self._description).data)
        yield MARKERS_TOPIC, self._markers(time_ns)

    def messages(self, time_ns: int, record: CycleRecord) -> Iterator[tuple[str, bytes]]:
        """Yield topic and message of constant data, in the first cycle, and of a cycle."""
        if self._is_first:
            yield from self.static_messages(time_ns)
            self._is_first = False
        yield from self._cycle_messages(time_ns, record)

    def _cycle_messages(self, time_ns: int, record: CycleRecord) -> Iterator[tuple[str, bytes]]:
        """Yield topic and message of a cycle; transforms only if all angles are finite."""
        joint, current_A = record.outputs.joint, record.sensors.current_A.tolist()
        output_rad, rate_rad_s = joint.output_rad.tolist(), joint.motor_rate_rad_s.tolist()
        torque_Nm = [k * i for k, i in zip(self._constant_Nm_A, current_A, strict=True)]
        ROS_TIME.pack_into(self._joints, 4, *ros_time(time_ns))
        for place, values in zip(self._joint_places, (output_rad, rate_rad_s, torque_Nm), strict=True):
            struct.pack_into("<5d", self._joints, place, *values)
        yield JOINT_STATES_TOPIC, bytes(self._joints)
        if all(map(math.isfinite, output_rad)):
            poses = [one.at(angle) for one, angle in zip(self._turning, output_rad, strict=True)]
            fill_transforms(self._frames, self._frame_places, time_ns, poses)
            yield TF_TOPIC, bytes(self._frames)

    def _markers(self, time_ns: int) -> bytes:
        shapes, placed = self._config.collision_geometry, []
        for k, carrier in enumerate(shapes.arm.carrier):
            frame = TURRET_FRAME if carrier == TURRET_CARRIER else f"link{carrier}"
            name, X_CS = shapes.parts[shapes.arm.part[k]], shapes.arm.X_CS[k]
            placed.append((name, frame, X_CS, shapes.arm, k, ARM_COLOUR))
        placed += [
            ("rover", ROVER_FRAME, shapes.rover.X_CS[k], shapes.rover, k, ROVER_COLOUR)
            for k in range(len(shapes.rover.part))
        ]
        out, count = CdrWriter(), 0
        out.add("I", 0)
        for name, frame, X, solids, k, colour in placed:
            for kind, X_SM, scale in marker_shapes(solids, k):
                add_marker(out, time_ns, (name, count, frame), kind, X @ X_SM, scale, colour)
                count += 1
        struct.pack_into("<I", out.data, 4, count)
        return bytes(out.data)


def fixed_frames(arm: Arm, scene: Mapping[str, Pose]) -> tuple[FixedFrame, ...]:
    """Return the fixed frames: rover, ends of the unloaded links, tools, and the scene in the root frame."""
    X_LF = Pose(arm.X_CF.R, arm.X_CF.p + arm.p_LC_m)
    return (
        FixedFrame(ROOT_FRAME, ROVER_FRAME, Pose(rotation_x(np.array(np.pi)), np.zeros(3))),
        *(FixedFrame(ROOT_FRAME, name, X) for name, X in scene.items()),
        FixedFrame(ROVER_FRAME, "arm1", Pose(rotation_z(arm.theta_rad[0]), np.zeros(3)) @ X_LF[0]),
        *(FixedFrame(f"link{k}", f"arm{k + 1}", X_LF[k]) for k in range(1, 6)),
        *(FixedFrame(TURRET_FRAME, tool, X_FT) for tool, X_FT in arm.X_FT.items()),
    )


def turning_frames(config: Config) -> tuple[TurningFrame, ...]:
    """Return the frames that the joints turn."""
    torque_Nm = (config.torque_constant_Nm_A * config.current_limit_A).tolist()
    return tuple(
        TurningFrame(
            joint.name.lower(),
            *(f"arm{k + 1}", f"link{k + 1}", float(config.arm.theta_rad[k + 1])),
            *(params.soft_min_rad, params.soft_max_rad, params.speed_rad_s, torque_Nm[k]),
        )
        for k, (joint, params) in enumerate(zip(Joint, config.params.joints.in_order(), strict=True))
    )


def joint_state_template() -> tuple[bytearray, tuple[int, ...]]:
    """Return a joint state of zeros, and the bytes where position, velocity and effort begin."""
    out = CdrWriter().header(0, "")
    out.add("I", len(Joint))
    for joint in Joint:
        out.text(joint.name.lower())
    places = []
    for _ in range(3):
        out.add("I", len(Joint))
        places.append(out.reserve(len(Joint)))
    return out.data, tuple(places)


def transforms_template(names: Sequence[tuple[str, str]]) -> tuple[bytearray, list[tuple[int, int]]]:
    """Return transforms of zeros between named frames, and the bytes where stamp and pose of each begin."""
    out, places = CdrWriter().add("I", len(names)), []
    for parent, child in names:
        at = len(out.data) + -len(out.data) % 4
        out.header(0, parent).text(child)
        places.append((at, out.reserve(7)))
    return out.data, places


def fill_transforms(
    message: bytearray, places: Sequence[tuple[int, int]], time_ns: int, poses: Sequence[tuple[float, ...]]
) -> None:
    """Write stamps and poses, position and quaternion x, y, z, w, into a message of `transforms_template`."""
    seconds = ros_time(time_ns)
    for (at, place), pose in zip(places, poses, strict=True):
        ROS_TIME.pack_into(message, at, *seconds)
        POSE_STRUCT.pack_into(message, place, *pose)


def marker_shapes(solids: RoundedBoxes, k: int) -> Iterator[tuple[int, Pose, tuple[float, float, float]]]:
    """Yield type, pose and size of the markers that draw a rounded box; capsules lie along x."""
    half, radius = solids.half_m[:, k], float(solids.radius_m[k])
    width = 2 * radius
    if not solids.is_capsule[k]:
        yield CUBE, IDENTITY, vector3(2 * (half + radius))
        return
    if half[0] > 0:
        along_x = Pose(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))
        yield CYLINDER, along_x, (width, width, 2 * float(half[0]))
    for end in (-half[0], half[0]):
        yield SPHERE, Pose(np.eye(3), np.array([end, 0.0, 0.0])), (width, width, width)


def add_marker(
    out: CdrWriter,
    time_ns: int,
    label: tuple[str, int, str],
    kind: int,
    X: Pose,
    scale: tuple[float, float, float],
    colour: tuple[float, float, float, float],
) -> None:
    """Add a visualization_msgs/Marker that moves with its frame; `label` is namespace, number and frame."""
    name, number, frame = label
    out.header(time_ns, frame).text(name).add("iii", number, kind, 0)
    out.add("d" * 7, *vector3(X.p), *quaternion(X.R)).add("ddd", *scale).add("ffff", *colour)
    out.add("iI?", 0, 0, True).add("II", 0, 0)  # for ever, with its frame, no points, no colours
    out.text("").header(0, "").text("").add("I", 0).add("I", 0)  # no texture
    out.text("").text("").text("").add("I", 0).add("?", False)  # no text, no mesh


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Convert a rotation, shape (3, 3), to a unit quaternion x, y, z, w."""
    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return x, y, z, w
