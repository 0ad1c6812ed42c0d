"""Forward simulation of many candidates in many windows at once, with effects in each control period."""

import ctypes
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import mujoco
import mujoco.batch
import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.effects.effect import Effect, Fields
from simgap.mjcf import place_tied
from simgap.robot import ControlMode
from simgap.simulation.compiled import Models, Rotors, nominal_fields, powered_numbers
from simgap.simulation.periods import Acting, Periods
from simgap.simulation.windows import Sampling, Window


@contextmanager
def profiler_off() -> Iterator[None]:
    """Switch the profiler off, as it is in the C library; the Python package switches it on.

    It takes a quarter of the time of a step of one joint. No bit of a simulation depends on it.
    `mujoco.set_mjcb_time(None)` would switch it on again, so the pointer itself is set.
    """
    try:
        clock = ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._structs.__file__), "mjcb_time")
    except (AttributeError, OSError, ValueError):  # another build of MuJoCo: its steps only take longer
        yield
        return
    before = clock.value
    try:
        clock.value = None
        yield
    finally:
        clock.value = before


CHUNK: Final = 1024
"""Control periods whose positions are kept until they are sampled: some seconds, a multiple of `SPAN`."""
SPAN: Final = 64
"""Most control periods in one call of MuJoCo; then simulations that blew up are looked for."""
LEAST_WORK: Final = 300
"""Control periods of a thread in a call, over all simulations and joints. While Python prepares the next
call, the thread waits, which takes 100 us of processor time, as much as 60 steps of one joint."""


@dataclass(frozen=True, slots=True)
class ActiveEffect:
    """An effect and its sizes."""

    effect: Effect
    size: Array
    """(n_candidates, n_windows, n_sizes)."""


class Simulation:
    """A batch. Simulation s is candidate s % n_candidates in window s // n_candidates, the longest first."""

    def __init__(
        self,
        models: Models,
        effects: Sequence[ActiveEffect],
        windows: Sequence[Window],
        n_candidates: int,
        n_threads: int,
    ) -> None:
        """Set models, commands and starts; no more than `n_threads` threads are used."""
        self._compiled = models.compiled([one.effect for one in effects])
        self._robot = self._compiled.robot
        self._order = sorted(range(len(windows)), key=lambda w: -windows[w].n_ticks)
        self._windows = [windows[w] for w in self._order]
        self._n_candidates = n_candidates
        self._n_sims = n_candidates * len(windows)
        # an encoder behind a gear asks for a call a period too
        has_calls = any(_changes_periods(one.effect) or one.effect.overrides("vary") for one in effects)
        periods = self._n_sims * len(self._robot.joints) * (1 if has_calls else SPAN)
        useful = max(1, periods // LEAST_WORK)
        self._batch = mujoco.batch.Batch(self._robot.model, self._n_sims, nthread=min(n_threads, useful))
        names = [joint.name for joint in self._robot.joints]
        self._effects = [
            Acting(
                one.effect,
                one.size[:, self._order].swapaxes(0, 1).reshape(self._n_sims, -1),
                names.index(one.effect.place) if one.effect.place in names else -1,
                {},
            )
            for one in effects
        ]
        fields = self._set_model()
        self._set_start()
        self._command = self._commands()
        self._switches = self._list_switches()
        # `keep` cuts the sizes of ended simulations off, but samples need them
        acting = [Acting(one.effect, one.size, one.joint, {}) for one in self._effects]
        heat = self._each(np.array([window.temperature_degC for window in self._windows]))
        self._periods = Periods(self._compiled, self._batch, fields, self._rotors, acting, heat)

    def _with(self, hook: str) -> list[Acting]:
        return [one for one in self._effects if one.effect.overrides(hook)]

    def _at(self, hook: str, joint: int) -> list[Acting]:
        return [one for one in self._with(hook) if one.joint == joint]

    def _sims(self, w: int) -> slice:
        """Return the simulations of a window."""
        return slice(w * self._n_candidates, (w + 1) * self._n_candidates)

    def _each(self, of_windows: Array) -> Array:
        """Repeat numbers of windows, (n_windows, ...), for all simulations."""
        return np.repeat(of_windows, self._n_candidates, axis=0)

    def _set_model(self) -> Fields:
        """Set the numbers of the model, and return them with those of the controllers."""
        dof, batch = self._compiled.dof, self._batch
        fields = nominal_fields(self._robot, self._n_sims, batch)
        fields.kp_Nm_rad *= self._each(np.array([window.gain for window in self._windows]))
        for one in self._with("set_model"):
            one.effect.set_model(one.size, fields, self._robot)
        fields.damping_Nms_rad = np.maximum(fields.damping_Nms_rad, 0.0)
        fields.frictionloss_Nm = np.maximum(fields.frictionloss_Nm, 0.0)
        damping, armature = powered_numbers(self._robot, fields, np.ones_like(fields.kp_Nm_rad))
        self._rotors = Rotors(self._robot, fields)
        for name, value in (
            ("dof_damping", damping),
            ("dof_armature", armature),
            ("dof_frictionloss", fields.frictionloss_Nm),
        ):
            batch.expand(name)[:, dof] = value
            self._rotors.move(batch.expand(name), value)
        batch.set_const()
        return fields

    def _commands(self) -> Array:
        """Compute the commands as they arrive, (n_ticks, n_sims, n_joints)."""
        period_s, longest = self._robot.control_period_s, self._windows[0]
        command = np.empty((longest.n_ticks, self._n_sims, len(self._robot.joints)))
        # all windows together: some effects shape a command period by period in Python
        missing = [((0, longest.n_ticks - one.n_ticks), (0, 0)) for one in self._windows]
        given = np.array(
            [np.pad(one.command, n, "edge") for one, n in zip(self._windows, missing, strict=True)]
        )
        window_of = np.arange(self._n_sims) // self._n_candidates
        for j, joint in enumerate(self._robot.joints):
            shaping = self._at("shape_command", j)
            # many candidates have the same sizes here
            different = np.column_stack([window_of, *(one.size for one in shaping)])
            _, some, of_sim = np.unique(different, axis=0, return_index=True, return_inverse=True)
            arrived = given[window_of[some], :, j]
            for one in shaping:
                arrived = one.effect.shape_command(one.size[some], arrived, period_s)
            arrived = arrived[of_sim]
            if joint.mode is ControlMode.POSITION:
                for one in reversed(self._at("decode", j)):
                    arrived = one.effect.decode(one.size, arrived)
            command[:, :, j] = arrived[:, longest.n_lead :].T
        return command

    def _list_switches(self) -> frozenset[int]:
        """List the control periods in which motors get or lose torque; empty where all always have it."""
        if all(window.enabled.all() for window in self._windows):
            return frozenset()
        changes = [1 + np.flatnonzero(np.diff(one.enabled, axis=0).any(axis=1)) for one in self._windows]
        return frozenset((0, *(int(k) for of_window in changes for k in of_window)))

    def _set_start(self) -> None:
        """Set the measured starts."""
        q = self._each(np.array([window.q_rad for window in self._windows]))
        for one in reversed(self._with("decode")):
            q[:, one.joint] = one.effect.decode(one.size, q[:, [one.joint]])[:, 0]
        self._qpos = self._batch.bind("qpos")
        self._qpos[:, self._compiled.qpos] = q
        v = self._each(np.array([window.v_rad_s for window in self._windows]))
        speed = self._batch.bind("qvel")
        speed[:, self._compiled.dof] = v
        place_tied(self._robot.model, [one.dof_index for one in self._robot.joints], self._qpos, speed)
        self._rotors.start(self._batch)

    def positions(self) -> Array:
        """Simulate, and return what encoders show, (n_candidates, n_samples) [rad]; NaN where one failed."""
        sampling, periods = self._sampling(), self._periods
        failed = np.zeros(self._n_sims, dtype=bool)
        self._call(failed, self._batch.forward)
        ends = np.array([window.n_ticks for window in self._windows])
        n_ticks = int(ends[0])
        alive = self._n_candidates * np.sum(ends > np.arange(n_ticks)[:, None], axis=1)
        path = np.empty((CHUNK + 1, self._n_sims, len(self._robot.joints)))
        periods.show(self._qpos, path[0])
        begin, ids = 0, np.flatnonzero(~failed)
        for first, last in pairwise(self._edges()):
            if alive[first] != periods.n:
                periods.keep(int(alive[first]))
                ids = ids[ids < periods.n]
            self._advance(first, last, ids, failed, path[first + 1 - begin : last + 1 - begin])
            if last % SPAN == 0 or last == n_ticks:
                failed |= self._batch.warning.reshape(self._n_sims, -1).any(axis=1)
                ids = np.flatnonzero(~failed[: periods.n])
            if last - begin == CHUNK or last == n_ticks:
                sampling.take(path, begin, last)
                path[0], begin = path[last - begin], last
        return self._encoded(sampling.values, failed)

    def _edges(self) -> list[int]:
        """Return the control periods at which more than the commands may change, and the end."""
        n_ticks = self._windows[0].n_ticks
        if not self._periods.are_steady:
            return list(range(n_ticks + 1))
        ends = (window.n_ticks for window in self._windows)
        return sorted({n_ticks, *range(0, n_ticks, SPAN), *ends, *self._switches})

    def _advance(self, first: int, last: int, ids: Integers, failed: Flags, path: Array) -> None:
        """Simulate control periods in which only commands change, and write their ends to a path."""
        periods, enabled = self._periods, None
        if first in self._switches:
            now = [window.enabled[first] for window in self._windows[: periods.n // self._n_candidates]]
            enabled = self._each(np.array(now, dtype=float))
        periods.set_inputs(first, self._command[first, : periods.n], enabled)
        if last - first > 1:
            periods.show(self._rollout(first, last, ids, failed), path)
            return
        some = None if ids.size == self._n_sims else ids
        self._call(failed, lambda: self._batch.step(some, nstep=periods.n_steps))
        periods.show(self._qpos, path[0])

    def _rollout(self, first: int, last: int, ids: Integers, failed: Flags) -> Array:
        """Simulate control periods in one call; return the ends of all, (n_periods, n_sims, n_qpos) [rad].

        Without effects in between, the bits are those of a call a period. A call takes a third of a step of
        one joint for each simulation, and Python between two calls as long as ten steps.
        """
        n_steps, n_qpos = self._periods.n_steps, self._robot.model.nq
        control = self._periods.control(self._command[first:last, ids])
        steps = np.zeros((*control.shape[:2], n_qpos))
        self._call(
            failed, lambda: self._batch.rollout(control.shape[1], control, ids=ids, out={"qpos": steps})
        )
        qpos = np.zeros((last - first, self._n_sims, n_qpos))
        qpos[:, ids] = steps[:, n_steps - 1 :: n_steps].swapaxes(0, 1)
        return qpos

    def _call(self, failed: Flags, job: Callable[[], None]) -> None:
        """Call MuJoCo, and mark the simulations that it cannot continue."""
        try:
            job()
        except mujoco.batch.SimulationError as error:
            failed[error.ids] = True

    def _sampling(self) -> Sampling:
        """Prepare the samples, with their delays."""
        late_s = np.zeros((len(self._windows), self._n_candidates, len(self._robot.joints)))
        for one in self._with("sample_delay_s"):
            delay_s = one.effect.sample_delay_s(one.size)
            late_s[:, :, one.joint] += delay_s.reshape(len(self._windows), self._n_candidates)
        return Sampling(self._windows, self._order, late_s, self._robot.control_period_s)

    def _encoded(self, q_rad: Array, failed: Flags) -> Array:
        """Return what the encoders show at sampled positions, (n_candidates, n_samples)."""
        first = 0
        for w in np.argsort(self._order):
            sims = self._sims(int(w))
            for j, time_s in enumerate(self._windows[w].sample_time_s):
                part = slice(first, first + time_s.size)
                for one in self._at("encode", j):
                    q_rad[:, part] = one.effect.encode(one.size[sims], q_rad[:, part])
                q_rad[failed[sims], part] = np.nan
                first += time_s.size
        return q_rad


MEMORY_BYTES: Final = 20_000_000
"""Commands that are kept at once, beside a few copies. More candidates in one batch would not be faster."""


class Engine:
    """Simulations of a robot with a set of effects in a set of windows.

    A candidate is simulated with those effects alone that have a size other than 0, so that its result does
    not depend on the other candidates.
    """

    def __init__(
        self, models: Models, effects: Sequence[Effect], windows: Sequence[Window], n_threads: int = 0
    ) -> None:
        """Keep what is common to all candidates; no result depends on the largest number of threads.

        0 threads stand for as many as this process may use processors.
        """
        self.models = models
        self.windows = tuple(windows)
        self.n_threads = n_threads or count_processors()
        first = np.cumsum([0, *(len(effect.sizes) for effect in effects)])
        columns = [slice(int(a), int(b)) for a, b in pairwise(first)]
        parts = [(one, own) for effect, own in zip(effects, columns, strict=True) for one in effect.parts]
        self.effects, self._sizes = [one for one, _ in parts], [own for _, own in parts]

    def positions(self, sizes: Array) -> Array:
        """Simulate candidates; return what encoders show, (n_candidates, n_samples) [rad].

        Samples are in the order of windows, joints, times; NaN in windows in which the simulation blew up.

        Args:
            sizes: Sizes of all effects one after the other, (n_candidates, n_sizes) or (n_candidates,
                n_windows, n_sizes), each in its own unit.
        """
        if sizes.ndim == 2:
            sizes = np.repeat(sizes[:, None], len(self.windows), axis=1)
        active = np.zeros((sizes.shape[0], len(self.effects)), dtype=bool)
        for e, part in enumerate(self._sizes):
            active[:, e] = np.any(sizes[..., part] != 0.0, axis=(1, 2))
        n_samples = sum(one.size for window in self.windows for one in window.sample_time_s)
        shown = np.empty((sizes.shape[0], n_samples))
        for rows in self._groups(active):
            chosen = np.flatnonzero(active[rows].any(axis=0))
            effects = [ActiveEffect(self.effects[e], sizes[rows][..., self._sizes[e]]) for e in chosen]
            simulation = Simulation(self.models, effects, self.windows, len(rows), self.n_threads)
            with profiler_off():
                shown[rows] = simulation.positions()
        return shown

    def _groups(self, active: Integers) -> list[Integers]:
        """Put candidates together that have the same model, and like effects in each control period."""
        varies = np.array([effect.overrides("vary") for effect in self.effects], dtype=bool)
        acts = np.array([_changes_periods(effect) for effect in self.effects], dtype=bool)
        # candidates without effects in each period need no Python between the steps
        kind = np.column_stack([active[:, varies], active[:, acts].any(axis=1)])
        keys = np.column_stack([kind, active[:, acts]])
        order = np.lexsort(keys.T[::-1])
        longest = max(window.n_ticks for window in self.windows)
        candidate_bytes = 8 * longest * len(self.models.robot.joints) * len(self.windows)
        at_once = max(1, MEMORY_BYTES // candidate_bytes)
        groups = []
        first = 0
        for k in range(1, order.size + 1):
            is_end = k == order.size or k - first == at_once
            if is_end or np.any(kind[order[k]] != kind[order[first]]):
                groups.append(order[first:k])
                first = k
        return groups


def count_processors() -> int:
    """Return how many processors this process may use; a container often has fewer than the machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _changes_periods(effect: Effect) -> bool:
    hooks = ("act",) if effect.is_steady else ("act", "friction_Nm", "torque_Nm")
    return effect.overrides(*hooks)
