"""The messages that other people's tools know: joint states, frame transforms, shapes of the arm.

They follow from the flight channels, and are there so that a log shows an arm with no configuration.
"""

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np

from fsw.collision.geometry import PARTS, TURRET_FRAME, RoundedBoxes
from fsw.config import Config
from fsw.dictionary.enums import Joint, Tool
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import IDENTITY, Array, Pose, inverse, rotation_x, rotation_z
from ground.telemetry.cdr import STAMP, CdrWriter, stamp
from sim.record import CycleRecord

EVERY: Final = 8
"""Cycles from one sample to the next: 8 Hz, in which no joint turns by more than a degree."""

JOINT_STATES: Final = "/joint_states"
FRAMES: Final = "/tf"
FIXED_FRAMES: Final = "/tf_static"
SHAPES: Final = "/arm_markers"
ROOT: Final = "map"
"""As RMECH, but z up, as 3D panels expect it."""
ROVER: Final = "rover"
"""RMECH."""

SEVEN: Final = struct.Struct("<7d")
SAMPLE: Final = struct.Struct(f"<{3 * len(Joint)}d")
CUBE, SPHERE, CYLINDER = 1, 2, 3
ARM_COLOUR: Final = (0.80, 0.55, 0.30, 0.9)
ROVER_COLOUR: Final = (0.75, 0.75, 0.78, 0.35)


class Sample(NamedTuple):
    """What the messages of a cycle are made of; in the order of Joint."""

    output_rad: list[float]
    rate_rad_s: list[float]
    current_A: list[float]

    def to_bytes(self) -> bytes:
        """As it is handed to another process."""
        return SAMPLE.pack(*self.output_rad, *self.rate_rad_s, *self.current_A)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """What `to_bytes` gave."""
        numbers, n = list(SAMPLE.unpack(data)), len(Joint)
        return cls(numbers[:n], numbers[n : 2 * n], numbers[2 * n :])


def sample_of(record: CycleRecord) -> Sample:
    """What the standard messages of this cycle are made of."""
    joint, sensors = record.outputs.joint, record.sensors
    return Sample(joint.output_rad.tolist(), joint.motor_rate_rad_s.tolist(), sensors.current_A.tolist())


@dataclass(frozen=True, slots=True)
class Turning:
    """A frame that one joint turns: rotation (x, y, z, w) and position where the joint is at zero."""

    zero_rad: float
    q: tuple[float, float, float, float]
    p_m: tuple[float, float, float]

    def at(self, angle_rad: float) -> tuple[float, ...]:
        """Position and rotation in the frame before it."""
        angle = self.zero_rad + angle_rad
        c, s = math.cos(angle), math.sin(angle)
        half_c, half_s = math.cos(0.5 * angle), math.sin(0.5 * angle)
        (x, y, z, w), (px, py, pz) = self.q, self.p_m
        return (
            *(c * px - s * py, s * px + c * py, pz),
            *(half_c * x - half_s * y, half_c * y + half_s * x, half_c * z + half_s * w),
            half_c * w - half_s * z,
        )


class Standard:
    """Makes the standard messages of one arm; the same sample gives the same bytes."""

    def __init__(self, config: Config) -> None:
        self._arm, self._config = config.arm, config
        X_LF = links(config.arm)
        self._turning = [
            Turning(float(config.arm.theta_rad[k]), quaternion(X_LF[k].R), triple(X_LF[k].p))
            for k in range(1, 6)
        ]
        self._constant_Nm_A = config.torque_constant_Nm_A.tolist()
        self._joints, self._joint_places = joint_state_form()
        self._frames, self._frame_places = frames_form([(f"arm{k}", f"arm{k + 1}") for k in range(1, 6)])

    def fixed(self, time_ns: int) -> Iterator[tuple[str, bytes]]:
        """Topic and message of what never changes: frames, and shapes as flight software knows them."""
        arm = self._arm
        X_RL = rotation_z(arm.theta_rad[0])
        X_LF = links(arm)[0]
        fixed = [
            (ROOT, ROVER, Pose(rotation_x(np.array(np.pi)), np.zeros(3))),
            (ROVER, "arm1", Pose(X_RL, np.zeros(3)) @ X_LF),
            *(("arm6", tool.name.lower(), arm.X_FT[tool]) for tool in Tool),
        ]
        message, places = frames_form([(parent, child) for parent, child, _ in fixed])
        fill_frames(message, places, time_ns, [(*triple(X.p), *quaternion(X.R)) for _, _, X in fixed])
        yield FIXED_FRAMES, bytes(message)
        yield SHAPES, self._markers(time_ns)

    def sample(self, time_ns: int, sample: Sample) -> Iterator[tuple[str, bytes]]:
        """Topic and message of a cycle; frames only of angles that are finite."""
        torque_Nm = [k * i for k, i in zip(self._constant_Nm_A, sample.current_A, strict=True)]
        STAMP.pack_into(self._joints, 4, *stamp(time_ns))
        for place, values in zip(
            self._joint_places, (sample.output_rad, sample.rate_rad_s, torque_Nm), strict=True
        ):
            struct.pack_into("<5d", self._joints, place, *values)
        yield JOINT_STATES, bytes(self._joints)
        if all(map(math.isfinite, sample.output_rad)):
            poses = [
                turning.at(angle) for turning, angle in zip(self._turning, sample.output_rad, strict=True)
            ]
            fill_frames(self._frames, self._frame_places, time_ns, poses)
            yield FRAMES, bytes(self._frames)

    def _markers(self, time_ns: int) -> bytes:
        arm, shapes = self._arm, self._config.collision_geometry
        X_FL = inverse(links(arm))
        placed = []
        for k, carrier in enumerate(shapes.arm.carrier):
            name, X_CS = PARTS[shapes.arm.part[k]], shapes.arm.X_CS[k]
            on_turret = carrier == TURRET_FRAME
            X = X_CS if on_turret else X_FL[carrier] @ X_CS
            placed.append((name, "arm6" if on_turret else f"arm{carrier + 1}", X, shapes.arm, k, ARM_COLOUR))
        placed += [
            ("rover", ROVER, shapes.rover.X_CS[k], shapes.rover, k, ROVER_COLOUR)
            for k in range(len(shapes.rover.part))
        ]
        out, count = CdrWriter(), 0
        out.add("I", 0)
        for name, frame, X, solids, k, colour in placed:
            for kind, X_SM, scale in pieces(solids, k):
                add_marker(out, time_ns, (name, count, frame), kind, X @ X_SM, scale, colour)
                count += 1
        struct.pack_into("<I", out.data, 4, count)
        return bytes(out.data)


def links(arm: Arm) -> Pose:
    """The frame at each unloaded link's end in the link's own, which its joint turns; batch (6,)."""
    return Pose(arm.X_CF.R, arm.X_CF.p + arm.p_LC_m)


def joint_state_form() -> tuple[bytearray, tuple[int, ...]]:
    """A joint state without numbers, and where position, velocity and effort go."""
    out = CdrWriter().header(0, "")
    out.add("I", len(Joint))
    for joint in Joint:
        out.text(joint.name.lower())
    places = []
    for _ in range(3):
        out.add("I", len(Joint))
        places.append(out.place(len(Joint)))
    return out.data, tuple(places)


def frames_form(names: Sequence[tuple[str, str]]) -> tuple[bytearray, list[tuple[int, int]]]:
    """Frame transforms without numbers, and where stamp and pose of each go."""
    out, places = CdrWriter().add("I", len(names)), []
    for parent, child in names:
        at = len(out.data) + -len(out.data) % 4
        out.header(0, parent).text(child)
        places.append((at, out.place(7)))
    return out.data, places


def fill_frames(
    message: bytearray, places: Sequence[tuple[int, int]], time_ns: int, poses: Sequence[tuple[float, ...]]
) -> None:
    """Fill in the stamp and the poses: position, then rotation as x, y, z, w."""
    seconds = stamp(time_ns)
    for (at, place), pose in zip(places, poses, strict=True):
        STAMP.pack_into(message, at, *seconds)
        SEVEN.pack_into(message, place, *pose)


def pieces(solids: RoundedBoxes, k: int) -> Iterator[tuple[int, Pose, tuple[float, float, float]]]:
    """What a rounded box is drawn of, in its own axes: kind, place and size; capsules lie along x."""
    half, radius = solids.half_m[:, k], float(solids.radius_m[k])
    width = 2 * radius
    if not solids.is_capsule[k]:
        yield CUBE, IDENTITY, triple(2 * (half + radius))
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
    """Add a visualization_msgs/Marker that stays with its frame; the label is namespace, number and frame."""
    name, number, frame = label
    out.header(time_ns, frame).text(name).add("iii", number, kind, 0)
    out.add("d" * 7, *triple(X.p), *quaternion(X.R)).add("ddd", *scale).add("ffff", *colour)
    out.add("iI?", 0, 0, True).add("II", 0, 0)  # for ever, with its frame, no points, no colours
    out.text("").header(0, "").text("").add("I", 0).add("I", 0)  # no texture
    out.text("").text("").text("").add("I", 0).add("?", False)  # no text, no mesh


def triple(v: Array) -> tuple[float, float, float]:
    """Three numbers."""
    x, y, z = v.tolist()
    return x, y, z


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """A rotation as x, y, z, w; by its largest component, so that none is lost to rounding."""
    squares = np.array(
        [
            1 + R[0, 0] - R[1, 1] - R[2, 2],
            1 - R[0, 0] + R[1, 1] - R[2, 2],
            1 - R[0, 0] - R[1, 1] + R[2, 2],
            1 + R[0, 0] + R[1, 1] + R[2, 2],
        ]
    )
    turns = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sums = np.array([R[1, 2] + R[2, 1], R[0, 2] + R[2, 0], R[0, 1] + R[1, 0]])
    k = int(squares.argmax())
    q = np.empty(4)
    q[3] = squares[3] if k == 3 else turns[k]
    for i in range(3):
        q[i] = turns[i] if k == 3 else squares[i] if i == k else sums[3 - i - k]
    q /= np.linalg.norm(q)
    x, y, z, w = q.tolist()
    return x, y, z, w
