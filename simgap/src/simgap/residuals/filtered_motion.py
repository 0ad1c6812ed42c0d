"""Measured motion, low-passed without a phase shift: positions, speeds, accelerations and torques.

Speeds and accelerations are central differences of filtered positions. Torques pass the same filter, so that
both sides of an equation of motion lose the same frequencies.

The filter is a Butterworth filter of second order, run forward and backward; it halves the amplitude at its
cut-off. The cut-off is the highest frequency at which

- the noise of the acceleration, through the inertia of the joint, makes at most `NOISE_SHARE` of the scatter
  of its torque, and
- a central difference is right within 7 %: a tenth of the sample rate.

White noise of standard deviation s in positions with the period T has, below the frequency f,
    speed noise        = 2 pi s sqrt(2 T f^3 / 3),
    acceleration noise = (2 pi)^2 s sqrt(2 T f^5 / 5).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np
from scipy.signal import butter, sosfiltfilt

from simgap.arrays import Array, Flags
from simgap.common.errors import RobotError
from simgap.logs import JointLog, Motion, Signal
from simgap.robot import Robot

NOISE_SHARE: Final = 0.01
"""Share of the scatter of a torque that noise of accelerations may make: a residual does not show it then."""
HIGHEST_PER_RATE: Final = 0.1
"""Highest cut-off over the sample rate."""
CERTAIN: Final = 3.0
"""Standard deviations of its noise beyond which the sign of a speed is certain."""
LEAST_SAMPLES: Final = 20
"""Fewer samples than this are shorter than the filter."""


@dataclass(frozen=True, slots=True)
class LowPass:
    """A filter without a shift in time."""

    cut_off_Hz: float
    period_s: float
    speed_noise_rad_s: Array
    """Standard deviation of the noise of filtered speeds, (n_joints,)."""

    @property
    def friction_speed_rad_s(self) -> Array:
        """Speed over which the sign of a speed is smoothed in dry friction, (n_joints,); never 0."""
        return np.maximum(CERTAIN * self.speed_noise_rad_s, np.finfo(float).tiny)

    def describe(self) -> str:
        """Return the filter in words, as a diagnosis states it."""
        return (
            "a Butterworth filter of second order, forward and backward, with a cut-off of "
            f"{self.cut_off_Hz:.3g} Hz"
        )

    def __call__(self, values: Array, axis: int = 0) -> Array:
        """Return filtered values."""
        return np.asarray(sosfiltfilt(_sections(self.cut_off_Hz, self.period_s), values, axis=axis))


@lru_cache
def _sections(cut_off_Hz: float, period_s: float) -> Array:
    """Design the filter once: this takes as long as to filter a motion."""
    return np.asarray(butter(2, cut_off_Hz, fs=1 / period_s, output="sos"))


@dataclass(frozen=True, slots=True)
class FilteredMotion:
    """Samples of all joints at the same times."""

    name: str
    time_s: Array
    """(n,)."""
    raw_rad: Array
    """Measured positions, (n, n_joints)."""
    q_rad: Array
    """Filtered positions, (n, n_joints)."""
    v_rad_s: Array
    a_rad_s2: Array
    torque_Nm: Array
    """Filtered torques, (n, n_joints); NaN where they are not logged."""
    temperature_degC: Array
    """(n, n_joints); NaN where it is not logged."""


def find_usable(log: JointLog, keep: Flags | None, time_s: Array, distance_s: float) -> Flags:
    """Find the times, (n_times,) [s], farther than this from position samples without `keep`, (n,) flags."""
    if keep is None or keep.all():
        return np.ones(time_s.size, dtype=bool)
    refused_s = log.position.time_s[~keep]
    after = np.searchsorted(refused_s, time_s)
    gap_s = np.minimum(
        np.abs(time_s - refused_s[np.maximum(after - 1, 0)]),
        np.abs(time_s - refused_s[np.minimum(after, refused_s.size - 1)]),
    )
    return np.asarray(gap_s > distance_s)


def choose_filter(robot: Robot, motions: Sequence[Motion]) -> LowPass:
    """Derive a cut-off from the noise of positions, the lowest that a motion needs; RobotError if short."""
    period_s = max(_period_s(motion) for motion in motions)
    inertia_kgm2 = robot.model.dof_M0[[joint.dof_index for joint in robot.joints]]
    cut_off_Hz = HIGHEST_PER_RATE / period_s
    noise_rad = np.zeros(len(robot.joints))
    for j, joint in enumerate(robot.joints):
        for motion in motions:
            log = motion.joints.get(joint.name)
            if log is None:
                continue
            noise_rad[j] = max(noise_rad[j], position_noise_rad(log.position.value))
            if log.torque is not None and noise_rad[j] > 0:
                allowed = NOISE_SHARE * float(np.std(log.torque.value)) / inertia_kgm2[j]
                ratio = allowed / ((2 * np.pi) ** 2 * noise_rad[j])
                cut_off_Hz = min(cut_off_Hz, (2.5 * ratio**2 / period_s) ** 0.2)
    longest_s = max(float(motion_time_s(motion, period_s)[-1]) for motion in motions)
    cut_off_Hz = max(cut_off_Hz, 4 / longest_s)  # a slower filter would leave nothing of the motion
    speed_noise = 2 * np.pi * noise_rad * np.sqrt(2 * period_s * cut_off_Hz**3 / 3)
    return LowPass(float(cut_off_Hz), period_s, speed_noise)


def position_noise_rad(position_rad: Array) -> float:
    """Estimate white noise [rad] from third differences of samples (n,), which smooth motion scarcely has.

    The median is that of a normal distribution, so that jerks at the ends of a motion do not count.

    Third differences have 20 times the variance of the samples.
    """
    third = np.diff(position_rad, 3)
    return float(1.4826 * np.median(np.abs(third)) / np.sqrt(20.0)) if third.size else 0.0


def filter_motion(robot: Robot, motion: Motion, low_pass: LowPass) -> FilteredMotion:
    """Filter the signals of a motion, 0 for joints without a log; RobotError if it is too short.

    Signals are interpolated to common times, since the equations of motion need all joints at one instant.
    """
    period_s = low_pass.period_s
    time_s = motion_time_s(motion, period_s)
    if time_s.size < LEAST_SAMPLES:
        raise RobotError(
            f"motion {motion.name!r} has {time_s.size} samples; a filter needs {LEAST_SAMPLES} or more"
        )
    raw = np.zeros((time_s.size, len(robot.joints)))
    torque, heat = np.full_like(raw, np.nan), np.full_like(raw, np.nan)
    for j, joint in enumerate(robot.joints):
        log = motion.joints.get(joint.name)
        if log is None:
            continue
        raw[:, j] = _at(log.position, time_s)
        if log.torque is not None:
            torque[:, j] = low_pass(_at(log.torque, time_s))
        if log.temperature is not None:
            heat[:, j] = _at(log.temperature, time_s)
    q, v, a = differentiate(raw, low_pass)
    return FilteredMotion(motion.name, time_s, raw, q, v, a, torque, heat)


def differentiate(raw_rad: Array, low_pass: LowPass) -> tuple[Array, Array, Array]:
    """Return filtered positions [rad], speeds [rad/s] and accelerations [rad/s2], (n, n_joints) each."""
    q = low_pass(raw_rad)
    v = np.gradient(q, low_pass.period_s, axis=0)
    return q, v, np.gradient(v, low_pass.period_s, axis=0)


def inverse_dynamics(
    model: mujoco.MjModel, robot: Robot, q_rad: Array, v_rad_s: Array, a_rad_s2: Array
) -> tuple[Array, Array]:
    """Compute torques of a motion without armature, damping, dry friction, limits and contacts.

    Args:
        model: Model; it is changed: those numbers become 0, because the caller adds them.
        q_rad: Positions, (n, n_joints) [rad].

    Returns:
        Torques at the joints, and `State.load_Nm`, which has no springs of the model: (n, n_joints) each.
    """
    model.dof_armature[:] = model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    dof = [joint.dof_index for joint in robot.joints]
    qpos = np.tile(model.qpos0, (len(q_rad), 1))
    qpos[:, [joint.qpos_index for joint in robot.joints]] = q_rad
    qvel, qacc, torque_Nm, passive_Nm = (np.zeros((len(q_rad), model.nv)) for _ in range(4))
    qvel[:, dof], qacc[:, dof] = v_rad_s, a_rad_s2
    for k in range(len(q_rad)):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[k], qvel[k], qacc[k]
        mujoco.mj_inverse(model, data)
        torque_Nm[k], passive_Nm[k] = data.qfrc_inverse, data.qfrc_passive
    return torque_Nm[:, dof], (torque_Nm + passive_Nm)[:, dof]


def motion_time_s(motion: Motion, period_s: float) -> Array:
    """Return times, (n,) [s], at which all signals of positions and torques exist."""
    signals = [log.position for log in motion.joints.values()]
    signals += [log.torque for log in motion.joints.values() if log.torque is not None]
    start_s = max(float(signal.time_s[0]) for signal in signals)
    end_s = min(float(signal.time_s[-1]) for signal in signals)
    # a time stamp that is short of a whole period by rounding is one
    return np.asarray(start_s + period_s * np.arange(int((end_s - start_s) / period_s + 1e-6) + 1))


def _period_s(motion: Motion) -> float:
    times = [log.position.time_s for log in motion.joints.values()]
    if min(one.size for one in times) < LEAST_SAMPLES:
        raise RobotError(
            f"motion {motion.name!r} has too few samples; a filter needs {LEAST_SAMPLES} or more"
        )
    return max(float(np.median(np.diff(one))) for one in times)


def _at(signal: Signal, time_s: Array) -> Array:
    return np.asarray(np.interp(time_s, signal.time_s, signal.value))
