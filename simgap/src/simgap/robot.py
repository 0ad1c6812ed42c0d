"""A robot: its compiled model, and how its joints are driven and logged."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco

if TYPE_CHECKING:
    from simgap.files.robot_file import RobotFile

# MuJoCo would write its warnings to a file in the current directory; simulations look for bad states
mujoco.set_mju_user_warning(lambda _: None)


class ControlMode(StrEnum):
    """Law by which a command becomes a torque."""

    POSITION = "position"
    """Torque = kp (command - position) - kd velocity."""
    VELOCITY = "velocity"
    """Torque = kd (command - velocity)."""
    TORQUE = "torque"
    """Torque = command."""
    CURRENT = "current"
    """Torque = torque constant times command."""


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """A joint with one degree of freedom, and its motor."""

    name: str
    qpos_index: int
    dof_index: int
    actuator_index: int
    """-1 if the model has no actuator for it."""
    mode: ControlMode
    kp_Nm_rad: float
    """Nominal stiffness of the position loop; per unit of the gain column, where the log has one."""
    kd_Nms_rad: float
    """Nominal damping of the position or velocity loop."""
    torque_limit_Nm: float
    """Largest torque at the joint; infinite if unlimited."""
    gear_ratio: float
    """Motor turns per turn of the joint; logged motor torques are multiplied by it."""
    torque_constant_Nm_A: float
    """Torque at the joint per ampere; NaN if unknown."""
    is_known: bool
    """True if friction, damping, armature and gain are measured numbers, so that none is a nuisance."""
    is_loaded_by_gravity: bool
    """False if gravity moves the joint by less than its friction: only ratios to the gain can be known."""


@dataclass(frozen=True, slots=True)
class Robot:
    """A robot file with its model compiled."""

    name: str
    model: mujoco.MjModel
    """Its time step is the step of the simulation."""
    model_xml: str
    """MJCF text of the model, from which variants with added joints are compiled."""
    joints: tuple[RobotJoint, ...]
    control_period_s: float
    """Period of the inner control loop, a whole number of time steps: effects act once in it."""
    tool_site: str
    """Site that may touch a plane; empty if none."""
    file: "RobotFile | None" = None
    """Content of the robot file, by which logs are read; None for a robot that was made in memory."""
    folder: Path = Path()
    """Folder of the robot file."""

    @classmethod
    def from_toml(cls, path: str | Path) -> "Robot":
        """Read a robot file and compile its model.

        Raises:
            RobotError: the file, the model, or what the one says of the other is wrong.
        """
        from simgap.files.robot_model import build_robot

        return build_robot(Path(path))

    def joint(self, name: str) -> RobotJoint:
        """Return the joint with this name."""
        return next(joint for joint in self.joints if joint.name == name)
