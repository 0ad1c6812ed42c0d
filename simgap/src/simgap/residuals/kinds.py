"""Kinds of residual that the logs of a robot allow: simulation, inverse dynamics, second encoder."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from simgap.arrays import Flags
from simgap.common.errors import RobotError
from simgap.effects.actuation import DampingGain, GainError, TorqueConstant, TorqueLimit
from simgap.effects.effect import SIMULATION_HOOKS, Effect
from simgap.effects.periodic import PeriodicError, SmoothPeriodicError
from simgap.logs import Motion
from simgap.residuals import encoder_residuals, inverse_residuals
from simgap.residuals.encoder_residuals import EncoderResiduals
from simgap.residuals.inverse_residuals import InverseResiduals
from simgap.residuals.residuals import ResidualModel
from simgap.residuals.simulation_residuals import SimulationResiduals
from simgap.robot import Robot

MOST_STEPS: Final = 50_000
"""Steps of a candidate that is fitted: at 10 microseconds each, a few thousand candidates take half an hour.
Longer logs are simulated in windows: an interval depends on the number of motions, less on their length."""


@dataclass(frozen=True, slots=True)
class ResidualKind:
    """One kind of residual."""

    name: str
    """`ResidualModel.kind` of what it makes."""
    make: Callable[[Sequence[Motion], bool], ResidualModel]
    """Takes motions, and whether they judge: then each is simulated whole, from its measured start."""
    shows: Callable[[Effect], bool]
    """True if the residual can show an effect."""
    has_base: bool
    """False if the base parameters of a joint do not move it."""


def list_kinds(
    robot: Robot, motions: Sequence[Motion], usable: Mapping[tuple[str, str], Flags] | None
) -> list[ResidualKind]:
    """List the kinds of residual that the logs allow.

    Logged torques are compared with inverse dynamics, which needs no controller. Where a joint has a command
    and no torque, the commands are simulated instead: else nothing would look at this joint. A second encoder
    is always compared with the first.

    Args:
        motions: Motions that are fitted.
        usable: Position samples that take part, (n,) flags; all where absent.

    Returns:
        The kinds.

    Raises:
        RobotError: There are neither torques nor commands nor a second encoder.
    """
    named = [(name, log) for motion in motions for name, log in motion.joints.items()]
    commanded = {name for name, log in named if log.command is not None}
    measured = {name for name, log in named if log.torque is not None}
    found = []
    if measured and (commanded <= measured or commanded < {joint.name for joint in robot.joints}):
        found.append(
            ResidualKind(
                InverseResiduals.kind,
                lambda part, _: InverseResiduals(robot, part, usable),
                shows_torque,
                True,
            )
        )
    elif commanded:

        def simulate(part: Sequence[Motion], is_judge: bool) -> ResidualModel:
            most_steps = math.inf if is_judge else MOST_STEPS
            return SimulationResiduals(
                robot, part, keep=usable, most_steps=most_steps, fit_starts=not is_judge
            )

        found.append(ResidualKind(SimulationResiduals.kind, simulate, shows_simulation, True))
    if any(log.secondary is not None for _, log in named):
        found.append(
            ResidualKind(
                EncoderResiduals.kind,
                lambda part, _: EncoderResiduals(robot, part, usable),
                encoder_residuals.shows,
                False,
            )
        )
    if not found:
        raise RobotError("the logs have no command, torque or second encoder; a diagnosis needs one of them")
    return found


def shows_simulation(effect: Effect) -> bool:
    """Return whether a simulation can show an effect; a smooth error could follow anything."""
    is_smooth = isinstance(effect, SmoothPeriodicError)
    return not is_smooth and effect.overrides(*SIMULATION_HOOKS)


def shows_torque(effect: Effect) -> bool:
    """Return whether logged torques can show an effect.

    An error of one encoder moves no torque. A change of the controller does not count where its torque is
    logged.
    """
    is_periodic = isinstance(effect, PeriodicError | SmoothPeriodicError)
    is_controller = isinstance(effect, GainError | DampingGain | TorqueConstant | TorqueLimit)
    return inverse_residuals.shows(effect) and not is_periodic and not is_controller
