"""Numerical settings of the plant, so that the true arm can be computed differently from a simulated one."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import mujoco

from sim.effects.effect import Effect, ParameterSpec

SOLVER_ITERATIONS: Final = 30
"""Iterations of the dual solver, which always uses all; three times as many change single counts."""

LEAST_EXPLICIT_SUBSTEPS: Final = 6
"""The explicit scheme diverges with fewer."""


@dataclass(frozen=True, slots=True)
class Numerics(Effect):
    """Shorter time step of the plant, and another integration scheme for gears and motors.

    MuJoCo's discrete integrator evaluates springs and dampers at the end of a step.
    With the dual solver it does so for single hinges only.
    Gears, outputs and motors are then evaluated at the start of the step.
    """

    scheme: Literal["implicit", "explicit"]
    substeps: Annotated[int, ParameterSpec(2, 20, unit="1", typical=6)] = LEAST_EXPLICIT_SUBSTEPS
    """Steps per step of the model."""

    def __post_init__(self) -> None:
        if self.scheme == "explicit" and self.substeps < LEAST_EXPLICIT_SUBSTEPS:
            least = LEAST_EXPLICIT_SUBSTEPS
            raise ValueError(
                f"substeps: {self.substeps} diverges; the explicit scheme takes at least {least}"
            )

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Set time step and solver."""
        spec.option.timestep /= self.substeps
        if self.scheme == "explicit":
            spec.option.solver = mujoco.mjtSolver.mjSOL_PGS
            spec.option.iterations = SOLVER_ITERATIONS
