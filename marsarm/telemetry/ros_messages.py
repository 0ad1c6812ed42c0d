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
from marsarm.telemetry.schema import CdrWriter
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

JOINT_NAMES: Final = tuple(joint.name.lower() for joint in Joint)
CUBE, SPHERE, CYLINDER = 1, 2, 3
ARM_COLOUR: Final = (0.80, 0.55, 0.30, 0.9)
ROVER_COLOUR: Final = (0.75, 0.75, 0.78, 0.35)


class RosEncoder:
    """Encoder of the ROS 2 messages of one arm; the same sample gives the same bytes.

    A joint turns a frame `linkK` about z of `armK`; the link carries `arm(K+1)`. The frames of transforms
    and robot description are the same.
    """

    def __init__(self, config: Config, scene: DrawnScene | None = None) -> None:
        """Prepare the messages of an arm, and of the scene of the run, without robot description for None."""
        self._config, self._is_first = config, True
        self._fixed = fixed_frames(config.arm, {} if scene is None else scene.frames)
        self._turning = turning_frames(config)
        self._description = (
            None if scene is None else robot_description(self._fixed, self._turning, scene.visuals)
        )
        self._constant_Nm_A = config.torque_constant_Nm_A.tolist()

    def static_messages(self, time_ns: int) -> Iterator[tuple[str, bytes]]:
        """Yield topic and message of constant data.

        These are fixed frames, the robot description, and collision shapes of flight software.
        """
        poses = [(*vector3(one.X.p), *quaternion(one.X.R)) for one in self._fixed]
        yield TF_STATIC_TOPIC, transforms(time_ns, self._fixed, poses)
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
        out = CdrWriter().header(time_ns, "").add("I", len(Joint))
        for name in JOINT_NAMES:
            out.text(name)
        for values in (output_rad, rate_rad_s, torque_Nm):
            out.add("I", len(Joint)).add("d", *values)
        yield JOINT_STATES_TOPIC, bytes(out.data)
        if all(map(math.isfinite, output_rad)):
            poses = [one.at(angle) for one, angle in zip(self._turning, output_rad, strict=True)]
            yield TF_TOPIC, transforms(time_ns, self._turning, poses)

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


def transforms(
    time_ns: int, frames: Sequence[FixedFrame | TurningFrame], poses: Sequence[tuple[float, ...]]
) -> bytes:
    """Encode the transforms of frames in their parents: position and quaternion x, y, z, w of each."""
    out = CdrWriter().add("I", len(frames))
    for frame, pose in zip(frames, poses, strict=True):
        out.header(time_ns, frame.parent).text(frame.child).add("d", *pose)
    return bytes(out.data)


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
    out.header(time_ns, frame).text(name).add("i", number, kind, 0)
    out.add("d", *vector3(X.p), *quaternion(X.R), *scale).add("f", *colour)
    out.add("I", 0, 0).add("?", True).add("I", 0, 0)  # for ever, with its frame, no points, no colours
    out.text("").header(0, "").text("").add("I", 0).add("I", 0)  # no texture
    out.text("").text("").text("").add("I", 0).add("?", False)  # no text, no mesh


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Convert a rotation, shape (3, 3), to a unit quaternion x, y, z, w."""
    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return x, y, z, w
