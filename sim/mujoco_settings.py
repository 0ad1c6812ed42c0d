"""Settings of MuJoCo for a plant: its library, the damping of a time step, the gains of motor controllers.

The library writes no file of warnings, as `Plant.step` checks their count. Its profiler is off: it would read
a clock many times in each step, and nothing here reads the profile.
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array


def apply_settings() -> None:
    """Apply the settings; a build of MuJoCo that does not show its clock keeps the profiler."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        clock = ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._structs.__file__), "mjcb_time")
    except (AttributeError, OSError, ValueError):
        return
    # mujoco.set_mjcb_time(None) would set the clock of the Python package again
    clock.value = None


POSITION_GAIN, RATE_GAIN = 4, 6
"""Indices in MuJoCo's gain parameters of a dcmotor."""
REFERENCE_STEP_S: Final = 1 / 2048
"""Time step that the dampers of `arm.xml` are made for."""


def match_reference_damping(model: mujoco.MjModel) -> float:
    """Remove added damping from springs and servos, so that it equals that of the reference step.

    `discrete` evaluates a spring at the end of a step h, which adds its stiffness times h to its damping.
    PROVENANCE.md has the derivation. The time [s] that is returned, times the stiffness of a gear, is its
    added damping, to be removed on a flank.
    """
    excess_s = float(model.opt.timestep) - REFERENCE_STEP_S
    model.dof_damping[model.jnt_dofadr] -= excess_s * model.jnt_stiffness
    if model.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        excess_s = -REFERENCE_STEP_S  # the dual solver evaluates them at the start of a step
    model.actuator_gainprm[:, RATE_GAIN] -= excess_s * model.actuator_gainprm[:, POSITION_GAIN]
    return excess_s


def read_pad_springs(model: mujoco.MjModel) -> dict[int, Array]:
    """Return stiffness [N/m] and damping [N s/m] of the pads of tools, by the index of their geom.

    The pads are the geoms in MuJoCo's direct format, which is for a unit of the inverse mass of a body.
    """
    inverse_kg, yielding = model.body_invweight0[model.geom_bodyid, 0], 1.0 - model.geom_solimp[:, 0]
    pads = np.flatnonzero(model.geom_solref[:, 0] < 0.0)
    return {int(pad): -model.geom_solref[pad] / (yielding[pad] * inverse_kg[pad]) for pad in pads}


def keep_pad_springs(model: mujoco.MjModel, data: mujoco.MjData, springs: Mapping[int, Array]) -> None:
    """Set the direct format of the pads in contact so that they are as stiff as drawn in the next step.

    `discrete` reduces the inverse mass of a body by the springs and dampers of its joints, the more the
    longer the step, then by those of the contact itself; only the first makes it stiffer at rest.
    """
    step_s, contacts = model.opt.timestep, data.contact  # to iterate over it would take 0.3 ms
    for pair, row in zip(contacts.geom.tolist(), contacts.efc_address.tolist(), strict=True):
        for pad in springs.keys() & pair:
            stiffness, damping, impedance, _ = data.efc_KBIP[row].tolist()
            own = 1.0 + step_s * (damping + step_s * stiffness * impedance)
            model.geom_solref[pad] = -(1.0 - impedance) * own * data.efc_diagA[row] * springs[pad]


RESISTANCE, MOTOR_CONSTANT, GAINS = 0, 1, slice(4, 7)
"""Indices in MuJoCo's gain parameters of a dcmotor; GAINS are those of position, integral and rate."""
INTEGRAL_LIMIT: Final = 8
"""Index of `Imax` in its dynamic parameters."""
BUS_V: Final = 28.0
LEAST_GAIN_SHARE: Final = 1e-9
"""Gains of a servo without power, or the constant of a motor without field, as a share: MuJoCo fails at 0.

A dcmotor would have no integral, or a current of no torque over no constant.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Servos:
    """Motor controllers as they were built, in the order of Joint."""

    actuators: NDArray[np.intp]
    """Indices of their actuators, shape (5,)."""
    gains: Array
    """Gains of position, integral and rate, shape (5, 3)."""
    integral_limit_rads: Array
    """Limit of the integral of the error, shape (5,)."""
    full_voltage: Array
    """Current that the bus drives through the winding at rest, over the current limit, shape (5,)."""


def read_servos(model: mujoco.MjModel, actuators: NDArray[np.intp]) -> Servos:
    """Read the motor controllers of a model in which nothing is disturbed."""
    gain = model.actuator_gainprm[actuators]
    limit_A = model.actuator_forcerange[actuators, 1] / gain[:, MOTOR_CONSTANT]
    return Servos(
        actuators,
        gain[:, GAINS].copy(),
        model.actuator_dynprm[actuators, INTEGRAL_LIMIT],
        BUS_V / gain[:, RESISTANCE] / limit_A,
    )


def change_gains(model: mujoco.MjModel, servos: Servos, change: Array) -> None:
    """Change the gains of motor controllers relative to the built ones, (5,), with the bus voltage.

    A controller sets the duty cycle of its bridge. The limit of its integral is a current. So the limit of
    the integrated error rises as the gains fall, until the duty cycle is 1: then the bus sets the limit.
    """
    share = np.maximum(1.0 + change, LEAST_GAIN_SHARE)
    model.actuator_gainprm[servos.actuators, GAINS] = servos.gains * share[:, None]
    rise = np.minimum(1.0 / share, servos.full_voltage)
    model.actuator_dynprm[servos.actuators, INTEGRAL_LIMIT] = servos.integral_limit_rads * rise
