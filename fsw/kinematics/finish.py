"""Newton steps that take the roots of the square rigid arm to those of the real, hanging arm."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.compensation import STEPS_PER_ROUND, TASK_TOLERANCE, refine
from fsw.kinematics.transforms import Array, wrap_angle

Flags = NDArray[np.bool_]
Numbers = NDArray[np.int64]

DEFLECTED_TOLERANCE: Final = 1e-9
SAME_ROOT_RAD: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """Roots (n) after Newton steps; NaN and not found where none were wanted."""

    output_rad: Array
    torque_Nm: Array
    error: Array
    found: Flags


def _merged(first: Finished, second: Finished, where: Flags) -> Finished:
    """The second where it says so, else the first."""
    return Finished(
        np.where(where, second.output_rad, first.output_rad),
        np.where(where, second.torque_Nm, first.torque_Nm),
        np.where(where, second.error, first.error),
        np.where(where, second.found, first.found),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Finish:
    """Newton on the roots that are wanted, and once more from the mirror image where a pair fell on one."""

    arm: Arm
    tool: int
    p: Array
    a: Array
    gravity_R_m_s2: Array

    def __call__(self, start: Array, wanted: Flags, close: Flags, shape_of: tuple[int, ...]) -> Finished:
        """The wanted roots from their starts (5, n); close to a fold with a Jacobian in every step."""
        done = self._from(start, wanted & ~close)
        near_fold = wanted & close
        if near_fold.any():
            done = _merged(done, self._from(start, near_fold, 1), near_fold)
        other = _other_elbow(np.arange(wanted.size).reshape(shape_of[1:])).reshape(-1)
        apart = np.max(np.abs(wrap_angle(done.output_rad - done.output_rad[:, other])), axis=0)
        # the second of a pair on one root, and a lost one whose partner was found, try from the mirror image
        second = np.arange(wanted.size) > other
        lost = wanted & done.found[other] & (~done.found | (second & (apart < SAME_ROOT_RAD)))
        if not lost.any():
            return done
        again = self._from(self._mirrored(done.output_rad[:, other]), lost, 1)
        return _merged(done, again, lost & again.found)

    def _from(self, start: Array, wanted: Flags, steps_per_jacobian: int = STEPS_PER_ROUND) -> Finished:
        where = np.flatnonzero(wanted)
        found = refine(
            self.arm,
            self.tool,
            self.p[:, where],
            self.a[:, where],
            self.gravity_R_m_s2,
            start[:, where],
            DEFLECTED_TOLERANCE if self.gravity_R_m_s2.any() else TASK_TOLERANCE,
            steps_per_jacobian,
        )
        q, torque = np.full_like(start, np.nan), np.zeros_like(start)
        error, ok = np.full(wanted.size, np.nan), np.zeros(wanted.size, bool)
        q[:, where], torque[:, where], error[where] = found.output_rad, found.torque_Nm, found.error
        ok[where] = found.converged
        return Finished(q, torque, error, ok)

    def _mirrored(self, q: Array) -> Array:
        """The pose with the elbow on the other side of the shoulder-wrist line."""
        s = self.arm.shapes[self.tool]
        bend = q[2] + s.theta_rad[2]
        lean = np.arctan2(s.fore_m * np.sin(bend), s.upper_m + s.fore_m * np.cos(bend))
        mirrored = q.copy()
        mirrored[1] += 2 * lean
        mirrored[2] -= 2 * bend
        mirrored[3] += 2 * bend - 2 * lean
        return mirrored


def _other_elbow(index: Numbers) -> Numbers:
    """For each branch the one that differs in the elbow only, along axis 0 of (8, ...)."""
    pairs: Numbers = index.reshape(2, 2, 2, *index.shape[1:])[:, ::-1].reshape(index.shape)
    return pairs
