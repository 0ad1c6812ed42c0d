"""Damping of the plant at its time step: equal to that of the step that the dampers are made for."""

from typing import Final

import mujoco

POSITION_GAIN, RATE_GAIN = 4, 6
"""Indices in MuJoCo's gain parameters of a dcmotor."""
REFERENCE_STEP_S: Final = 1 / 2048
"""Time step that the dampers of `arm.xml` are made for."""


def match_reference_damping(model: mujoco.MjModel) -> float:
    """Remove added damping from springs and servos, so that it equals that of the reference step.

    `discrete` evaluates a spring at the end of a step h, which adds its stiffness times h to its damping.
    PROVENANCE.md has the derivation.

    Returns:
        Time [s] that, times the stiffness of a gear, is its added damping; to be removed on a flank.
    """
    excess_s = float(model.opt.timestep) - REFERENCE_STEP_S
    model.dof_damping[model.jnt_dofadr] -= excess_s * model.jnt_stiffness
    if model.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        excess_s = -REFERENCE_STEP_S  # the dual solver evaluates them at the start of a step
    model.actuator_gainprm[:, RATE_GAIN] -= excess_s * model.actuator_gainprm[:, POSITION_GAIN]
    return excess_s
