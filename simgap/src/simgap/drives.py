"""Drives of a model: the gains, limits and motor constants of an actuator, at its joint."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches

import mujoco

from simgap.common.errors import RobotError
from simgap.files.robot_file import JointTable


@dataclass(frozen=True, slots=True)
class Drive:
    """Drive of a joint as a model has it, in the units of the joint."""

    actuator: int = -1
    """-1 if the model has none."""
    kp_Nm_rad: float = 0.0
    """Stiffness of the position loop; 0 if the model has none."""
    kd_Nms_rad: float = 0.0
    torque_constant_Nm_A: float | None = None
    """Torque for 1 A; None if the model has no DC motor."""
    torque_Nm_V: float | None = None
    """Torque for 1 V at rest; None if the model has no DC motor."""
    back_emf_Nms_rad: float = 0.0
    """Damping by the back-EMF, while the voltage is given."""


def read_drive(table: JointTable, model: mujoco.MjModel, joint: int, where: str) -> Drive:
    """Read the drive of a joint, by its index in the model; RobotError if it cannot be diagnosed."""
    k = _find_actuator(table, model, joint, where)
    if k < 0:
        return Drive()
    if words := next(_own_dynamics(model, k), ""):
        raise RobotError(f"{where}.actuator: {model.actuator(k).name!r} {words}")
    gear = float(model.actuator_gear[k, 0])
    # Length and force of an actuator are both scaled by its gear.
    if model.actuator_dyntype[k] != mujoco.mjtDyn.mjDYN_DCMOTOR:
        is_affine = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
        bias = model.actuator_biasprm[k]
        kp, kd = (-float(bias[1]) * gear**2, -float(bias[2]) * gear**2) if is_affine else (0.0, 0.0)
        return Drive(k, kp, kd)
    resistance_Ohm, constant_Nm_A = (float(one) for one in model.actuator_gainprm[k, :2])
    kp, kd = float(model.actuator_gainprm[k, 4]) * gear**2, float(model.actuator_gainprm[k, 6]) * gear**2
    back_emf = gear**2 * constant_Nm_A**2 / resistance_Ohm
    if model.actuator_ctrlspec[k] == mujoco.mjtCtrlInput.mjINPUT_VOLTAGE and table.mode != "velocity":
        kp, kd = 0.0, back_emf
    return Drive(k, kp, kd, abs(gear) * constant_Nm_A, gear * constant_Nm_A / resistance_Ohm, back_emf)


def _find_actuator(table: JointTable, model: mujoco.MjModel, joint: int, where: str) -> int:
    """Return the index of the actuator of a joint, -1 if the model has none."""
    driving = [
        k
        for k in range(model.nactuator)
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_trnid[k, 0] == joint
    ]
    names = {model.actuator(k).name: k for k in driving}
    if table.actuator:
        if table.actuator not in names:
            raise RobotError(f"{where}.actuator: {describe_unknown('actuator', table.actuator, list(names))}")
        return names[table.actuator]
    if len(driving) > 1:
        shown = ", ".join(filter(None, names)) or "without a name in the model,"
        raise RobotError(
            f"{where}.actuator: {len(driving)} actuators, {shown} drive this joint; name one of them"
        )
    return driving[0] if driving else -1


def _own_dynamics(model: mujoco.MjModel, k: int) -> Iterator[str]:
    """Say what an actuator has beside gains, damping and a limit, and what would be right."""
    own, gain = model.actuator_dynprm[k], model.actuator_gainprm[k]
    if model.actuator_ctrlnum[k] > 1:
        yield f"takes {model.actuator_ctrlnum[k]} commands; a diagnosis has one, so give it one input"
    if model.actuator_delay[k] > 0.0:
        yield "has a delay of its own; a diagnosis looks for delays, so take it out of the model"
    if model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE:
        return
    if model.actuator_dyntype[k] != mujoco.mjtDyn.mjDYN_DCMOTOR:
        yield "has dynamics of its own (timeconst ..); a diagnosis lacks them, so take them out of the model"
    parts = {
        "inductance": own[0] != 0.0,
        "thermal": own[2:4].any(),
        "lugre": own[5:7].any(),
        "cogging": model.actuator_biasprm[k, 0] != 0.0,
        "an integral gain or slewmax of its controller": gain[5] != 0.0 or own[7] != 0.0,
    }
    for name, is_there in parts.items():
        if is_there:
            yield f"has dynamics of its own ({name}); a diagnosis lacks them, so take them out of the model"
    if gain[7] != 0.0:
        yield (
            "has a largest voltage of its controller, so that its torque falls with the speed; a diagnosis "
            "looks for that as back-EMF: take it out of the model, and give the stall torque as saturation"
        )
    if model.actuator_ctrlspec[k] == mujoco.mjtCtrlInput.mjINPUT_VEL and gain[4] != 0.0:
        yield "has the input vel and a gain on the position; a diagnosis lacks this law, so set kp to 0"


def read_torque_limit(model: mujoco.MjModel, joint: int, actuator: int, where: str) -> float:
    """Return the smaller limit of an actuator and of its joint [N m], infinite if there is none."""
    ranges = {}
    if actuator >= 0 and model.actuator_forcelimited[actuator]:
        ranges["forcerange"] = model.actuator_forcerange[actuator] * abs(model.actuator_gear[actuator, 0])
    if model.jnt_actfrclimited[joint]:
        ranges["actuatorfrcrange"] = model.jnt_actfrcrange[joint]
    unit = "N" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else "N m"
    for name, (low, high) in ranges.items():
        if low != -high:
            raise RobotError(
                f"{where}.torque_limit_Nm: {name} of the model is {low:g} to {high:g} {unit} at the joint; "
                "give one limit for both directions"
            )
    return min((float(high) for _, high in ranges.values()), default=math.inf)


def describe_unknown(kind: str, name: str, names: list[str]) -> str:
    """Say that a model has no element of a name, and which it has."""
    near = get_close_matches(name, names, 1) or [", ".join(filter(None, names)) or "none"]
    hint = f"did you mean {near[0]}?" if near[0] in names else f"it has {near[0]}"
    return f"the model has no {kind} {name!r}; {hint}"
