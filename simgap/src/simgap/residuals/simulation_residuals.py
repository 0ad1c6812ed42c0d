"""Residuals of forward simulation, and the kinds of residual that the logs of a robot allow."""

import math
from collections.abc import Callable, Collection, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np

from simgap.arrays import Array, Integers, orthonormal
from simgap.common.errors import RobotError
from simgap.effects.actuation import CurrentScale, DampingGain, GainError, TorqueConstant, TorqueLimit
from simgap.effects.effect import SIMULATION_HOOKS, Effect
from simgap.effects.transmission import PeriodicError, SmoothPeriodicError
from simgap.logs import Motion, Usable
from simgap.residuals import encoder_residuals, inverse_residuals
from simgap.residuals.conditioned import join_conditions
from simgap.residuals.encoder_residuals import EncoderResiduals
from simgap.residuals.inverse_residuals import InverseResiduals
from simgap.residuals.residuals import ResidualModel, measured_variable
from simgap.robot import ControlMode, Robot
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import Window, cut_windows, keep_beginning

PENALTY_rad: Final = 100.0
"""Residual of a simulation that blew up: finite, and larger than any that did not."""
SPACING_s: Final = 0.02
"""Least time between residuals: closer ones repeat each other, because a servo needs longer to move."""
SHIFT_rad: Final = 1e-3
"""Shift of a start that shows how its first samples follow: a milliradian is small beside any motion, as is
`RobotJoint.per_rad` times as much of a slide."""
SHIFT_s: Final = 0.1
"""Time in which a shifted speed moves a joint by as much: a servo needs about as long to follow."""
STEP_PARTS: Final = 8
"""Parts of a step in the simulation that shows its error: an eighth of an error of first order is left."""
PART_s: Final = 10.0
"""Length of the windows where motions are simulated in part: long beside what a servo remembers."""

Simulate = Callable[[Sequence[Window]], Array]
"""Function of windows that returns the positions of the reference model, (n_samples,) [rad]."""


class SimulationResiduals:
    """Predict measured minus simulated positions; see `ResidualModel`.

    To each simulation is added what smaller steps change in that of a reference model (defect correction). A
    real robot has no time step, and the error of one is soon larger than the smallest effect that noise lets
    see. The reference is the nominal model until `around` sets another.
    """

    kind = "simulation"
    by_motion = True
    noise_std = 0.0

    def __init__(
        self,
        robot: Robot,
        motions: Sequence[Motion],
        spacing_s: float = SPACING_s,
        keep: Usable | None = None,
        n_threads: int = 0,
        most_steps: float = math.inf,
        fit_starts: bool = False,
        is_measured: bool = True,
    ) -> None:
        """Cut the motions into windows: a motion is one, until a stretch of samples that are not used.

        Args:
            motions: Motions, with the commands of all joints.
            spacing_s: Least time between residuals of a joint [s].
            n_threads: Threads of the simulation; 0: as many as there are processors.
            most_steps: Steps of a candidate. Where all motions take more, evenly spaced windows of each are
                simulated instead.
            fit_starts: Take out of the residuals what another start of a joint would explain.
            is_measured: False for motions that are only planned: nothing is corrected by smaller steps.
        """
        self._robot = robot
        fine = copy(robot.model)
        fine.opt.timestep /= STEP_PARTS
        self._models, self._fine_models = Models(robot), Models(replace(robot, model=fine))
        self._n_threads, self._fit_starts = n_threads, fit_starts
        self.step_s = float(robot.model.opt.timestep)
        self.method = (
            f"Positions are simulated from measured starts in steps of {1e3 * self.step_s:g} ms; there is a "
            f"residual where they are logged, at most every {1e3 * spacing_s:g} ms."
        )
        most_periods = most_steps / round(robot.control_period_s / robot.model.opt.timestep)
        self._logs = tuple(motions)
        self._coarse, self._fine = (
            _cut(one, motions, spacing_s, keep, most_periods) for one in (robot, self._fine_models.robot)
        )
        if is_measured:
            self._refer([], np.zeros((1, 0)))
            return
        n = sum(one.size for window in self._coarse for one in window.sample_time_s)
        self._fill(self._logs, self._coarse, np.zeros(n), np.empty((n, 0)))

    def around(self, effects: Sequence[Effect], sizes: Array) -> "SimulationResiduals":
        """Return the residuals with another reference, such as fitted base parameters.

        Starts and the change by smaller steps follow from the reference. A nominal model without damping
        rings where the robot does not, and what smaller steps change in that is no error of a damped one.

        Args:
            sizes: Sizes of all effects one after the other, (1, n_sizes), in their units.
        """
        moved = copy(self)
        moved._refer(effects, sizes)
        return moved

    def _refer(self, effects: Sequence[Effect], sizes: Array) -> None:
        """Simulate the reference, from which starts and corrections follow."""

        def simulate(models: Models, windows: Sequence[Window]) -> Array:
            (found,) = Engine(models, effects, windows, self._n_threads).positions(sizes)
            return np.asarray(found)

        fine = start_windows(self._fine_models, self._fine, partial(simulate, self._fine_models))
        coarse = [
            replace(window, q_rad=one.q_rad, v_rad_s=one.v_rad_s)
            for window, one in zip(self._coarse, fine, strict=True)
        ]
        simulate_coarse = partial(simulate, self._models)
        fine_rad, coarse_rad = simulate(self._fine_models, fine), simulate_coarse(coarse)
        starts = np.empty((coarse_rad.size, 0))
        if self._fit_starts:
            starts = self._start_responses(simulate_coarse, coarse, coarse_rad)
        self._fill(self._logs, coarse, np.nan_to_num(fine_rad - coarse_rad), starts)

    def _start_responses(self, simulate: Simulate, windows: Sequence[Window], reference_rad: Array) -> Array:
        """Return what other positions and speeds of the starts change in each joint itself, (n, 2) [rad]."""
        shift_rad = _shifts_rad(self._models)
        shifts = [
            replace(one, q_rad=one.q_rad + q_rad, v_rad_s=one.v_rad_s + v_rad_s)
            for q_rad, v_rad_s in ((shift_rad, 0.0), (0.0, shift_rad / SHIFT_s))
            for one in windows
        ]
        return np.nan_to_num(simulate(shifts).reshape(2, -1) - reference_rad).T

    def _fill(
        self, motions: Sequence[Motion], windows: Sequence[Window], refined_rad: Array, starts: Array
    ) -> None:
        self._logs, self._windows, self._refined_rad = tuple(motions), tuple(windows), refined_rad
        self.joints = tuple(joint.name for joint in self._robot.joints)
        self.units = tuple(joint.unit for joint in self._robot.joints)
        self.motions = tuple(motion.name for motion in motions)
        self.repeat_of = tuple(motion.repeat_of for motion in motions)
        counts = np.array([[one.size for one in window.sample_time_s] for window in self._windows])
        n_joints = len(self.joints)
        which = np.array([self.motions.index(window.motion) for window in self._windows])
        self.joint_of: Integers = np.repeat(np.tile(np.arange(n_joints), len(which)), counts.ravel())
        self.motion_of: Integers = np.repeat(np.repeat(which, n_joints), counts.ravel())
        self.time_s: Array = np.concatenate(
            [time_s + window.start_s for window in self._windows for time_s in window.sample_time_s]
        )
        self.measured_rad: Array = np.concatenate(
            [q for window in self._windows for q in window.measured_rad]
        )
        """Measured positions, (n,)."""
        self._starts = starts
        ends = np.cumsum(counts.ravel()).tolist() if starts.size else []
        parts = [slice(low, high) for low, high in pairwise([0, *ends]) if high > low]
        self._bases = [(part, orthonormal(starts[part])) for part in parts]

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return measured minus simulated positions, (n_candidates, n) [rad]; `PENALTY_rad` where it blew up.

        Args:
            sizes: Sizes of all effects one after the other, (n_candidates, n_sizes) or
                (n_candidates, n_motions, n_sizes), in their units; zeros where absent.
        """
        engine = Engine(self._models, effects, self._windows, self._n_threads)
        sizes = np.asarray(sizes, dtype=float)
        if sizes.ndim == 3:
            sizes = sizes[:, [self.motions.index(window.motion) for window in self._windows]]
        residual = engine.positions(sizes)  # changed in place: those of long logs are large
        np.subtract(self.measured_rad - self._refined_rad, residual, out=residual)
        for part, basis in self._bases:
            residual[:, part] -= (residual[:, part] @ basis) @ basis.T
        residual[~np.isfinite(residual)] = PENALTY_rad
        return residual

    def select(self, motions: Sequence[str]) -> "SimulationResiduals":
        """Return the residuals of these motions alone, in their old order."""
        chosen, names = copy(self), set(motions)
        kept = np.isin(self.motion_of, [self.motions.index(name) for name in names])
        chosen._coarse, chosen._fine = (
            [one for one in windows if one.motion in names] for windows in (self._coarse, self._fine)
        )
        chosen._fill(
            [motion for motion in self._logs if motion.name in names],
            [window for window in self._windows if window.motion in names],
            self._refined_rad[kept],
            self._starts[kept],
        )
        return chosen

    def explain(self, name: str) -> Array:
        """Return a variable at the measured motion, (n,); NaN where it is not logged."""
        return measured_variable(self._robot, self._logs, name, self.motion_of, self.joint_of, self.time_s)


def _cut(
    robot: Robot, motions: Sequence[Motion], spacing_s: float, keep: Usable | None, most_periods: float
) -> list[Window]:
    """Cut motions into windows; of too many control periods, keep evenly spaced windows of each motion."""
    windows = [one for motion in motions for one in cut_windows(robot, motion, None, spacing_s, keep)]
    periods = sum(window.n_ticks for window in windows)
    if periods <= most_periods:
        return windows
    kept = []
    for motion in motions:
        windows = cut_windows(robot, motion, PART_s, spacing_s, keep)
        n = max(1, round(most_periods / periods * len(windows)))
        kept += [windows[int((k + 0.5) * len(windows) / n)] for k in range(n)]
    return kept


def start_windows(models: Models, windows: Sequence[Window], simulate: Simulate) -> list[Window]:
    """Let joints start at rest where the reference model then predicts their first samples better.

    A joint that falls or is pulled from rest has the speed of its first samples only after them.

    Args:
        windows: Windows whose joints start at the position and speed of their first samples.
    """
    moving = [keep_beginning(window, models.robot.control_period_s) for window in windows]
    resting = [_rest(window, 0.0) for window in moving]
    small_rad = _shifts_rad(models)
    shifted = [_rest(window, small_rad) for window in moving]
    moving_rad, resting_rad, shifted_rad = (simulate(some) for some in (moving, resting, shifted))
    started, end = [], 0
    for window, rest in zip(windows, resting, strict=True):
        q_rad, v_rad_s = window.q_rad.copy(), window.v_rad_s.copy()
        for j, measured_rad in enumerate(rest.measured_rad):
            first = slice(end, end + measured_rad.size)
            end += measured_rad.size
            miss_rad = measured_rad - moving_rad[first]
            rest_rad = measured_rad - resting_rad[first]
            slope = (shifted_rad - resting_rad)[first] / small_rad[j]
            # at the start itself the slope is 1: less of it says little about where the joint started
            shift_rad = float(slope @ rest_rad) / max(float(slope @ slope), 1.0)
            if np.sum((rest_rad - slope * shift_rad) ** 2) < np.sum(miss_rad**2):
                q_rad[j], v_rad_s[j] = rest.q_rad[j] + shift_rad, 0.0
        started.append(replace(window, q_rad=q_rad, v_rad_s=v_rad_s))
    return started


def _shifts_rad(models: Models) -> Array:
    """Return a small shift of each joint, (n_joints,)."""
    return np.array([SHIFT_rad * joint.per_rad for joint in models.robot.joints])


def _rest(window: Window, shift_rad: Array | float) -> Window:
    """Return a window in which all joints start at rest, so far from their first samples."""
    first = zip(window.measured_rad, window.q_rad, strict=True)
    q_rad = np.array([samples[0] if samples.size else q for samples, q in first])
    return replace(window, q_rad=q_rad + shift_rad, v_rad_s=np.zeros_like(q_rad))


MOST_STEPS: Final = 50_000
"""Steps of a candidate that is fitted: at 10 microseconds each, a few thousand candidates take half an hour.
Longer logs are simulated in windows: an interval depends on the number of motions, less on their length."""


MakeResiduals = Callable[[Sequence[Motion], bool], ResidualModel]
"""Takes motions, and whether they judge: then each is simulated whole, from its measured start."""


@dataclass(frozen=True, slots=True)
class ResidualKind:
    """One kind of residual."""

    name: str
    """`ResidualModel.kind` of what it makes."""
    make: MakeResiduals
    shows: Callable[[Effect], bool]
    """True if the residual can show an effect."""
    has_base: bool
    """False if the base parameters of a joint do not move it."""


def list_kinds(robot: Robot, motions: Sequence[Motion], usable: Usable | None) -> list[ResidualKind]:
    """List the kinds of residual that the logs allow; RobotError if they allow none.

    Logged torques are compared with inverse dynamics, which needs no controller. Where a joint has a command
    and no torque, the commands are simulated instead: else nothing would look at this joint. A second encoder
    is always compared with the first.
    """
    named = [(name, log) for motion in motions for name, log in motion.joints.items()]
    commanded = {name for name, log in named if log.command is not None}
    measured = {name for name, log in named if log.torque is not None}

    def measure(kind: type[InverseResiduals | EncoderResiduals]) -> MakeResiduals:
        return lambda part, _: join_conditions(robot, part, lambda one, own, _: kind(one, own, usable))

    def simulate(part: Sequence[Motion], is_judge: bool) -> ResidualModel:
        def make(one: Robot, own: Sequence[Motion], share: float) -> ResidualModel:
            most_steps = math.inf if is_judge else share * MOST_STEPS
            return SimulationResiduals(one, own, keep=usable, most_steps=most_steps, fit_starts=not is_judge)

        return join_conditions(robot, part, make)

    found = []
    if measured and (commanded <= measured or commanded < {joint.name for joint in robot.joints}):
        found.append(ResidualKind(InverseResiduals.kind, measure(InverseResiduals), shows_torque, True))
    elif commanded:
        _check_gains(robot, commanded - measured)
        found.append(ResidualKind(SimulationResiduals.kind, simulate, shows_simulation, True))
    if any(log.secondary is not None for _, log in named):
        shows = encoder_residuals.shows
        found.append(ResidualKind(EncoderResiduals.kind, measure(EncoderResiduals), shows, False))
    if not found:
        raise RobotError("the logs have no command, torque or second encoder; a diagnosis needs one of them")
    return found


def _check_gains(robot: Robot, unmeasured: Collection[str]) -> None:
    """Refuse to simulate a loop without a gain."""
    for joint in robot.joints:
        if not joint.knows_gains:
            key = "kp_Nm_rad" if joint.mode is ControlMode.POSITION else "kd_Nms_rad"
            raise RobotError(
                f"joint {joint.name}: {key} is missing; positions are compared, as the logs have no "
                f"torque of {', '.join(sorted(unmeasured))}"
            )


def shows_simulation(effect: Effect) -> bool:
    """Return whether a simulation can show an effect; a smooth error could follow anything."""
    is_other = isinstance(effect, SmoothPeriodicError | CurrentScale)
    return not is_other and effect.overrides(*SIMULATION_HOOKS)


def shows_torque(effect: Effect) -> bool:
    """Return whether logged torques can show an effect.

    An error of one encoder moves no torque. A change of the controller does not count where its torque is
    logged.
    """
    is_periodic = isinstance(effect, PeriodicError | SmoothPeriodicError)
    is_controller = isinstance(effect, GainError | DampingGain | TorqueConstant | TorqueLimit)
    return inverse_residuals.shows(effect) and not is_periodic and not is_controller
