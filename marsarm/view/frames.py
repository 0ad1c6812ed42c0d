"""Frames of a view: poses of the arm over time, true and as flight software believes it.

This is the one way from a run to what is drawn: the page and the tests use it.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Severity
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames as ChainFrames
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import ToolForce, settle_output
from fsw.kinematics.transforms import Array, Pose, stack_poses
from marsarm.telemetry.format import SAMPLE_CYCLES
from marsarm.telemetry.read import Log
from marsarm.view.scene import Scene
from simgap.common.errors import BadRequest

MOST_SAMPLES: Final = 2000
"""Largest number of samples of a log; in half an hour, a joint turns by 5 degrees at most between two."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """State of the arm at n times, true and as flight software believes it; joint arrays are (5, n)."""

    time_s: Array
    """Time since boot, shape (n,)."""
    mode: NDArray[np.intp]
    """Mode of the arm, shape (n,)."""
    tool: NDArray[np.intp]
    """Tool of the last tool command, the first one before it, shape (n,)."""
    motor_rad: Array
    """Motor angles that flight software measures."""
    believed_rad: Array
    """Output angles that flight software estimates."""
    gravity_R_m_s2: Array
    """Gravity in the rover frame that the rover measures, shape (3, n)."""
    current_A: Array
    true_rad: Array | None
    """True output angles; None if they are not known."""
    force_N: Array | None
    """True contact force, shape (n,); None if it is not known."""

    @classmethod
    def of_log(cls, log: Log) -> Self:
        """Select at most MOST_SAMPLES of a log at regular times; BadRequest without joints or gravity."""
        missing = [topic for topic in ("/joint", "/sensors") if topic not in log.packets]
        if missing:
            raise BadRequest(f"log {log.path}: has no {missing[0]}, which a view needs; record it with --log")
        ticks, joint = log.ticks("/joint"), log["/joint"]
        period = max(SAMPLE_CYCLES, -(-int(np.ptp(ticks) + 1) // (MOST_SAMPLES - 1)))
        rows = np.unique(
            np.searchsorted(ticks, np.arange(ticks[0], ticks[-1] + period, period)).clip(0, len(ticks) - 1)
        )
        at = ticks[rows]
        sensors, truth = log["/sensors"][_rows_at(log, "/sensors", at)], None
        if "/truth" in log.packets:
            truth = log["/truth"][_rows_at(log, "/truth", at)]
        tool = (
            log["/tool"]["tool"][_rows_at(log, "/tool", at)] if "/tool" in log.packets else np.zeros(len(at))
        )
        return cls(
            time_s=at / CYCLE_HZ,
            mode=joint["mode"][rows].astype(np.intp),
            tool=tool.astype(np.intp),
            motor_rad=joint["motor_rad"][rows].T,
            believed_rad=joint["output_rad"][rows].T,
            gravity_R_m_s2=sensors["gravity_R_m_s2"].T,
            current_A=sensors["current_A"].T,
            true_rad=None if truth is None else truth["output_rad"].T,
            force_N=None if truth is None else truth["contact_force_N"],
        )

    def select_known(self) -> Self:
        """Return the samples in which flight software has finite angles, and the rover finite gravity."""
        is_known = np.isfinite(np.vstack([self.believed_rad, self.motor_rad, self.gravity_R_m_s2])).all(
            axis=0
        )
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        known: dict[str, Any] = {n: v if v is None else v[..., is_known] for n, v in values.items()}
        return replace(self, **known)

    def without_truth(self) -> Self:
        """Return the samples without what only a simulator knows."""
        return replace(self, true_rad=None, force_N=None)

    @property
    def mode_names(self) -> list[str]:
        """Names of the modes in words."""
        return [Mode(number).name.lower().replace("_", " ") for number in self.mode]


def _rows_at(log: Log, topic: str, ticks: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the row of the last message of a topic at each tick, or of the first one, shape (n,)."""
    return (np.searchsorted(log.ticks(topic), ticks, side="right") - 1).clip(0)


@dataclass(frozen=True, slots=True)
class Event:
    """Event report for the time line."""

    time_s: float
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class ViewFrames:
    """Poses at n times of b carriers and, as the last one, of the tool, in world axes.

    Offsets are what compliance, backlash and errors of the arm add to the rigid arm at its motor angles. A
    view magnifies them.
    """

    samples: Samples
    p_m: NDArray[np.float32]
    """Positions of the rigid arm, shape (n, b + 1, 3)."""
    q: NDArray[np.float32]
    """Quaternions x, y, z, w of the rigid arm, continuous in time, shape (n, b + 1, 4)."""
    believed: NDArray[np.float32]
    """Offsets of the arm of flight software: translation [m], rotation [rad], shape (n, b + 1, 6)."""
    true: NDArray[np.float32] | None
    """Offsets of the true arm likewise; None if it is not known."""
    force_N: NDArray[np.float32]
    """True contact force on the tool, shape (n, 3)."""

    @property
    def trail_start(self) -> NDArray[np.uint32]:
        """Frame since which the tool is the same, shape (n,): another tool begins another trail."""
        is_first = np.append(True, np.diff(self.samples.tool) != 0)
        return np.maximum.accumulate(np.where(is_first, np.arange(len(is_first)), 0)).astype(np.uint32)

    @property
    def tool_error_m(self) -> Array | None:
        """Distance between the true tool and where flight software believes it, shape (n,)."""
        if self.true is None:
            return None
        return np.asarray(np.linalg.norm(self.true[:, -1, :3] - self.believed[:, -1, :3], axis=1), float)


def compute_frames(
    scene: Scene, samples: Samples, believed_arm: Arm, true_arm: Arm, surface_normal_R: Array | None
) -> ViewFrames:
    """Compute the frames of a run, by the parameters of flight software and as the arm was built.

    The springs of the true arm are in equilibrium with gravity and with the contact force: the arm is slow.
    The unit normal of the surface is in the rover frame, (3,). BadRequest says that no sample has all angles
    and gravity, or that one has a tool that the arm lacks.
    """
    samples = samples.select_known()
    if not len(samples.time_s):
        raise BadRequest("log: has no finite angles of the joints with gravity; there is no arm to show")
    if samples.tool.max() >= len(believed_arm.X_FT):
        raise BadRequest(
            f"log: has tool {samples.tool.max()}, and its parameters have the tools 0 to "
            f"{len(believed_arm.X_FT) - 1}; it cannot be drawn"
        )
    rigid = _poses(scene, believed_arm, forward(believed_arm, samples.motor_rad), samples)
    gravity = samples.gravity_R_m_s2
    settled = settle_output(believed_arm, samples.believed_rad, gravity).frames
    believed = _offset(rigid, _poses(scene, believed_arm, settled, samples))
    true, force_R_N = None, np.zeros((3, len(samples.time_s)))
    if samples.true_rad is not None and samples.force_N is not None:
        if surface_normal_R is not None:
            force_R_N = surface_normal_R[:, None] * samples.force_N
        settled = _settle_true(true_arm, samples, samples.true_rad, force_R_N)
        true = _offset(rigid, _poses(scene, true_arm, settled, samples))
    return ViewFrames(
        samples=samples,
        p_m=np.moveaxis(rigid.p, 0, -1).swapaxes(0, 1).astype(np.float32),
        q=_quaternions(rigid.R),
        believed=believed,
        true=true,
        force_N=(scene.X_WR.R @ force_R_N).T.astype(np.float32),
    )


def _settle_true(arm: Arm, samples: Samples, true_rad: Array, force_R_N: Array) -> ChainFrames:
    """Return the frames of the true arm, each under the force on its tool."""
    strain = np.zeros((6, 6, len(samples.time_s)))
    for tool in np.unique(samples.tool):
        at = samples.tool == tool
        push = ToolForce(list(arm.X_FT)[tool], force_R_N[:, at])
        strain[..., at] = settle_output(arm, true_rad[:, at], samples.gravity_R_m_s2[:, at], push).strain
    return forward(arm, true_rad, strain)


def _poses(scene: Scene, arm: Arm, frames: ChainFrames, samples: Samples) -> Pose:
    """Compute the poses of carriers and tool in world axes, batch (b + 1, n)."""
    carriers = scene.carrier_poses(frames)
    tools = stack_poses([tool_pose(arm, frames, tool) for tool in arm.X_FT])
    times = np.arange(len(samples.time_s))
    tool = Pose(scene.X_WR.R[..., None], scene.X_WR.p[..., None]) @ tools[times, samples.tool]
    return Pose(
        np.concatenate([carriers.R, tool.R[:, :, None]], axis=2),
        np.concatenate([carriers.p, tool.p[:, None]], axis=1),
    )


def _offset(rigid: Pose, other: Pose) -> NDArray[np.float32]:
    turn = np.einsum("ik...,jk...->...ij", other.R, rigid.R)
    rotation = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(*turn.shape[:2], 3)
    offset = np.concatenate([np.moveaxis(other.p - rigid.p, 0, -1), rotation], axis=-1)
    return np.asarray(offset.swapaxes(0, 1), np.float32)


def _quaternions(R: Array) -> NDArray[np.float32]:
    """Return quaternions of which two that follow each other have the same sign, shape (n, b + 1, 4)."""
    matrices = np.moveaxis(R, (0, 1), (-2, -1)).swapaxes(0, 1)
    q = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat().reshape(*matrices.shape[:2], 4)
    flips = np.sign(np.sum(q[1:] * q[:-1], axis=-1))
    q[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)[..., None]
    return np.asarray(q, np.float32)
