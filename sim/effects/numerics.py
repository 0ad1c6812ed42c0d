"""How the plant is computed, in which no arm has a part: so that a truth is not the simulator's own."""

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import mujoco

from sim.effects.effect import Effect, ParameterSpec

SOLVER_ITERATIONS: Final = 30
"""Of the dual solver, which goes on to its last: three times as many flip a count here and there."""


@dataclass(frozen=True, slots=True)
class Numerics(Effect):
    """The plant is computed in finer steps than the model's own, and gears and motors by another scheme.

    MuJoCo's discrete integrator takes springs and dampers as they are at the end of a step. With its dual
    solver it has only those of single hinges there; gears, outputs and motors count as at the beginning.
    """

    gears: Literal["implicit", "explicit"]
    finer: Annotated[int, ParameterSpec(2, 20, unit="1", typical=2)] = 2
    """In how many steps one of the model's is computed; the explicit scheme diverges in fewer than six."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Before anything is compiled."""
        spec.option.timestep /= self.finer
        if self.gears == "explicit":
            spec.option.solver = mujoco.mjtSolver.mjSOL_PGS
            spec.option.iterations = SOLVER_ITERATIONS
