"""The interface between the selection of effects and the three kinds of residual.

Forward simulation, inverse dynamics and a second encoder each predict what the logs say, for many candidates
at once. Selection, fit and verdict know no more of them than this.
"""

from collections.abc import Iterator, Sequence
from typing import Final, Protocol, runtime_checkable

import mujoco
import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect
from simgap.logs import Motion, Signal
from simgap.robot import Robot

SECOND_ENCODER: Final = "second encoder"
"""Kind of the residual between two encoders."""


class ResidualModel(Protocol):
    """Predict measured minus predicted values for candidates: sets of effects with their sizes."""

    kind: str
    """"simulation", "inverse dynamics", "second encoder" or "tracker"."""
    units: tuple[str, ...]
    """Unit of the residuals of each joint."""
    joints: tuple[str, ...]
    motions: tuple[str, ...]
    """Names of the units of inference: motions, or blocks of a motion."""
    repeat_of: tuple[str, ...]
    """Motions with the same text repeat one another; empty text: never repeated."""
    joint_of: Integers
    """Index of the joint of each residual, (n,)."""
    motion_of: Integers
    """Index of the motion of each residual, (n,)."""
    time_s: Array
    """Time of each residual in its motion, (n,)."""
    method: str
    """How the residuals are made: a sentence for a report."""
    step_s: float
    """Time step of the simulation; 0 for a kind that simulates nothing."""
    noise_std: float
    """Standard deviation of the noise of all residuals, in their unit, if it is known to be white; 0: only
    repeats show the noise."""
    by_motion: bool
    """True if `residuals` also takes sizes that differ from motion to motion, (n_candidates, n_motions, total
    sizes)."""

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n).

        Args:
            effects: Union of the effects of all candidates.
            sizes: Sizes of all effects one after the other, (n_candidates, total sizes); zeros where absent.
                Where `by_motion` is true, also (n_candidates, n_motions, total sizes).
        """
        ...

    def select(self, motions: Sequence[str]) -> "ResidualModel":
        """Return the residuals of these motions alone, which cost less."""
        ...

    def explain(self, name: str) -> Array:
        """Return a variable on which a residual may depend, (n,), at the measured motion.

        Args:
            name: "position" [rad], "velocity" [rad/s], "load" [N m], "time" [s], "temperature" [degC] or
                "command" in its unit.
        """
        ...


@runtime_checkable
class Referred(Protocol):
    """Residual model with a reference, from which starts and the error of its time step follow."""

    def around(self, effects: Sequence[Effect], sizes: Array) -> ResidualModel:
        """Return the residuals with another reference: effects with their sizes, (1, total sizes)."""
        ...


def refer_to(model: ResidualModel, effects: Sequence[Effect], sizes: Array) -> ResidualModel:
    """Return a residual model with sizes, (total sizes,), as reference, or the same if its kind has none."""
    return model.around(effects, sizes[None]) if isinstance(model, Referred) else model


def residuals_by_motion(model: ResidualModel, effects: Sequence[Effect], sizes: Array) -> Array:
    """Return the residuals of candidates, (n_candidates, n), whose sizes may differ from motion to motion.

    Args:
        sizes: Sizes of all effects one after the other, in their own units, (n_candidates, total sizes) or
            (n_candidates, n_motions, total sizes).
    """
    if model.by_motion or sizes.ndim == 2:
        return model.residuals(effects, sizes)
    found = []
    for candidate in sizes:
        distinct, which = np.unique(candidate, axis=0, return_inverse=True)
        rows = model.residuals(effects, distinct)
        found.append(rows[which.reshape(-1)[model.motion_of], np.arange(rows.shape[1])])
    return np.array(found)


class WrappedResiduals:
    """Residuals that follow from those of another model, sample by sample."""

    def __init__(self, raw: ResidualModel) -> None:
        """Take over what describes the samples."""
        self.raw = raw
        self.kind, self.units, self.joints, self.motions = raw.kind, raw.units, raw.joints, raw.motions
        self.by_motion, self.step_s, self.method = raw.by_motion, raw.step_s, raw.method
        self.noise_std = raw.noise_std
        self.repeat_of, self.joint_of, self.motion_of = raw.repeat_of, raw.joint_of, raw.motion_of
        self.time_s = raw.time_s

    def explain(self, name: str) -> Array:
        """Return a variable at the measured motion, (n,)."""
        return self.raw.explain(name)


def split_sizes(effects: Sequence[Effect], sizes: Array) -> Iterator[tuple[Effect, Array]]:
    """Yield each effect with its own sizes, (..., n_sizes), of those of all, (..., total sizes)."""
    first = 0
    for effect in effects:
        yield effect, sizes[..., first : first + len(effect.sizes)]
        first += len(effect.sizes)


def add_sizes(terms: Sequence[tuple[Effect, Array]], shape: tuple[int, ...]) -> tuple[list[Effect], Array]:
    """Add the sizes of effects that stand there several times, by their keys.

    Args:
        terms: Effects with sizes that fit to (*shape, n_sizes), in the units of their names.

    Returns:
        Each effect once, and all sizes one after the other, (*shape, total sizes); a sum ends at the bounds
        of the effect that comes first.
    """
    effects: dict[str, Effect] = {}
    sums: dict[str, Array] = {}
    for effect, size in terms:
        effects.setdefault(effect.key, effect)
        sums[effect.key] = sums.get(effect.key, np.zeros((*shape, len(effect.sizes)))) + size
    ends = [np.array([(size.low, size.high) for size in one.sizes]).T for one in effects.values()]
    parts = [np.clip(total, *end) for total, end in zip(sums.values(), ends, strict=True)]
    return [*effects.values()], np.concatenate([np.zeros((*shape, 0)), *parts], axis=-1)


def pseudo_huber(z: Array) -> Array:
    """Compute the loss, (n,), of residuals over their scale: the square, or twice the value of large ones."""
    square = z * z
    # exact for small residuals too
    return np.asarray(2.0 * square / (np.sqrt(1.0 + square) + 1.0))


def half_loss_derivatives(z: Array) -> tuple[Array, Array]:
    """Compute slope and curvature of half the pseudo-Huber loss of residuals over their scale, (n,) each."""
    return z / np.sqrt(1.0 + z * z), (1.0 + z * z) ** -1.5


def root_weight(z: Array) -> Array:
    """Compute roots of weights, (n,), with which squares act as the pseudo-Huber loss near residuals."""
    return np.asarray((1.0 + z * z) ** -0.25)


SMOOTH_SAMPLES = 5
"""Samples of the straight lines that give speeds and accelerations, as at the start of windows."""


def measured_variable(
    robot: Robot, motions: Sequence[Motion], name: str, motion_of: Integers, joint_of: Integers, time_s: Array
) -> Array:
    """Interpolate a variable of `ResidualModel.explain` at times in motions, (n,); NaN without a log."""
    if name == "time":
        return time_s.copy()
    value = np.full(time_s.size, np.nan)
    for m, motion in enumerate(motions):
        of_motion = motion_of == m
        for j, joint in enumerate(robot.joints):
            here = np.flatnonzero(of_motion & (joint_of == j))
            log = motion.joints.get(joint.name)
            if log is None or not here.size:
                continue
            if name == "load":
                value[here] = _load_Nm(robot, motion, j, time_s[here])
                continue
            signal = {
                "position": log.position,
                "velocity": slopes(log.position),
                "temperature": log.temperature,
                "command": log.command,
            }[name]
            if signal is not None:
                value[here] = np.interp(time_s[here], signal.time_s, signal.value)
    return value


def slopes(signal: Signal) -> Signal:
    """Differentiate a signal by straight lines through some neighbouring samples."""
    n = min(SMOOTH_SAMPLES, signal.time_s.size)
    t = np.lib.stride_tricks.sliding_window_view(signal.time_s, n)
    x = np.lib.stride_tricks.sliding_window_view(signal.value, n)
    middle = t.mean(axis=1, keepdims=True)
    spread = np.sum((t - middle) ** 2, axis=1)
    return Signal(middle[:, 0], np.sum((t - middle) * x, axis=1) / spread)


def _load_Nm(robot: Robot, motion: Motion, j: int, time_s: Array) -> Array:
    """Compute `State.load_Nm` of a joint at the measured motion."""
    model, data = robot.model, mujoco.MjData(robot.model)
    q, v, a = (np.zeros((time_s.size, len(robot.joints))) for _ in range(3))
    for i, joint in enumerate(robot.joints):
        log = motion.joints.get(joint.name)
        if log is None:
            continue
        speed = slopes(log.position)
        acceleration = slopes(speed)
        q[:, i] = np.interp(time_s, log.position.time_s, log.position.value)
        v[:, i] = np.interp(time_s, speed.time_s, speed.value)
        a[:, i] = np.interp(time_s, acceleration.time_s, acceleration.value)
    qpos = [joint.qpos_index for joint in robot.joints]
    dof = [joint.dof_index for joint in robot.joints]
    load, torque = np.empty(time_s.size), np.empty(model.nv)
    for k in range(time_s.size):
        data.qpos[qpos], data.qvel[dof], data.qacc[dof] = q[k], v[k], a[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, torque)
        load[k] = torque[robot.joints[j].dof_index]
    return load
