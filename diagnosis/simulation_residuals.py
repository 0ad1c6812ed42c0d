"""Residuals of forward simulation: measured positions minus simulated ones."""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Flags, Integers
from diagnosis.compiled import Models
from diagnosis.effects.effect import Effect
from diagnosis.engine import Engine
from diagnosis.explain import measured_variable
from diagnosis.logs import Motion
from diagnosis.robot import Robot
from diagnosis.windows import Window, cut_windows

PENALTY_rad: Final = 100.0
"""Residual of a simulation that blew up: finite, and larger than any that did not."""
SPACING_s: Final = 0.02
"""Least time between residuals: closer ones repeat each other, because a servo needs longer to move."""

PART_s: Final = 10.0
"""Length of the windows where motions are simulated in part: long beside what a servo remembers."""


class SimulationResiduals:
    """Predict measured minus simulated positions; see `diagnosis.residuals.ResidualModel`."""

    kind = "simulation"
    unit = "rad"
    by_motion = True

    def __init__(
        self,
        robot: Robot,
        motions: Sequence[Motion],
        window_s: float | None = None,
        spacing_s: float = SPACING_s,
        keep: Mapping[tuple[str, str], Flags] | None = None,
        n_threads: int = 0,
        most_steps: float = math.inf,
    ) -> None:
        """Cut the motions into windows.

        Args:
            robot: Robot.
            motions: Motions, with the commands of all joints.
            window_s: Length of the windows, each of which begins at a measured state [s]; None: a motion is
                one window, which suits position-controlled joints.
            spacing_s: Least time between residuals of a joint [s].
            keep: By names of motion and joint, which position samples are used, (n,); all where absent.
            n_threads: Threads of the simulation; 0: as many as there are processors.
            most_steps: Steps of a candidate. Where all motions take more, evenly spaced windows of each are
                simulated instead.
        """
        self._robot = robot
        self._models = Models(robot)
        self._options = (spacing_s, keep)
        self._n_threads = n_threads
        self._window_s, self._part = window_s, 1.0
        self._fill(motions)
        steps = sum(window.n_ticks for window in self._windows) * round(
            robot.control_period_s / robot.model.opt.timestep
        )
        if steps > most_steps:
            self._window_s, self._part = window_s or PART_s, most_steps / steps
            self._fill(motions)

    def _fill(self, motions: Sequence[Motion]) -> None:
        self._logs = tuple(motions)
        self._windows: list[Window] = []
        for motion in motions:
            windows = cut_windows(self._robot, motion, self._window_s, *self._options)
            n = max(1, round(self._part * len(windows)))
            self._windows += [windows[int((k + 0.5) * len(windows) / n)] for k in range(n)]
        self.joints = tuple(joint.name for joint in self._robot.joints)
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

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates.

        Args:
            effects: Union of the effects of all candidates.
            sizes: Sizes of all effects one after the other, (n_candidates, total sizes) or (n_candidates,
                n_motions, total sizes); zeros where absent.

        Returns:
            Measured minus simulated positions, (n_candidates, n) [rad]; `PENALTY_rad` in a window whose
            simulation blew up.
        """
        engine = Engine(self._models, effects, self._windows, self._n_threads)
        sizes = np.asarray(sizes, dtype=float)
        if sizes.ndim == 3:
            sizes = sizes[:, [self.motions.index(window.motion) for window in self._windows]]
        residual = self.measured_rad - engine.positions(sizes)
        return np.where(np.isfinite(residual), residual, PENALTY_rad)

    def select(self, motions: Sequence[str]) -> "SimulationResiduals":
        """Return the residuals of these motions alone.

        Args:
            motions: Names; the order of the motions stays.

        Returns:
            A model with fewer motions.
        """
        chosen = copy(self)
        chosen._fill([motion for motion in self._logs if motion.name in set(motions)])
        return chosen

    def explain(self, name: str) -> Array:
        """Return a variable on which a residual may depend, at the measured motion.

        Args:
            name: "position" [rad], "velocity" [rad/s], "load" [N m], "time" [s], "temperature" [degC] or
                "command" [rad].

        Returns:
            Its value at each residual, (n,); NaN where it is not logged.
        """
        return measured_variable(self._robot, self._logs, name, self.motion_of, self.joint_of, self.time_s)
