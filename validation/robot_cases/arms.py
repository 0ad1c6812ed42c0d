"""The three robots of the cases, with our own numbers."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import mujoco

from simgap.robot import ControlMode, Robot, RobotJoint

FOLDER: Final = Path(__file__).parent / "models"
CONTROL_PERIOD_S: Final = 0.002
"""Period of the control loop, that of the model's step."""


@dataclass(frozen=True, slots=True)
class Arm:
    """Poses and joints of a model."""

    centre_rad: tuple[float, ...]
    """Middle of the motions."""
    known: frozenset[str]
    """Joints with measured friction, damping, armature and gain: they have no nuisances."""
    unloaded: frozenset[str] = frozenset()
    """Joints that gravity does not load."""


ARMS: Final = {
    "pendulum": Arm((0.5,), frozenset()),
    "two_joint": Arm((0.2, -0.6), frozenset({"elbow"})),
    "four_joint": Arm((0.0, 0.7, -1.0, -0.3), frozenset({"wrist"}), frozenset({"pan"})),
}


@cache
def load_robot(name: str) -> Robot:
    """Load one of the robots."""
    arm = ARMS[name]
    xml = (FOLDER / f"{name}.xml").read_text(encoding="utf-8")
    model = mujoco.MjModel.from_xml_string(xml)
    joints = []
    for k in range(model.nu):
        actuator = model.actuator(k)
        joint = model.joint(actuator.trnid[0])
        joints.append(
            RobotJoint(
                name=joint.name,
                qpos_index=int(joint.qposadr[0]),
                dof_index=int(joint.dofadr[0]),
                actuator_index=k,
                mode=ControlMode.POSITION,
                kp_Nm_rad=float(actuator.gainprm[0]),
                kd_Nms_rad=float(-actuator.biasprm[2]),
                torque_limit_Nm=float(actuator.forcerange[1]),
                gear_ratio=1.0,
                torque_constant_Nm_A=float("nan"),
                is_known=joint.name in arm.known,
                is_loaded_by_gravity=joint.name not in arm.unloaded,
            )
        )
    return Robot(name, model, xml, tuple(joints), CONTROL_PERIOD_S, "tool")
