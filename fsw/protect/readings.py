"""Monitors of the readings: finite, plausible, alive, as many as there should be; gravity as at the start."""

from math import atan2, dist, hypot, isfinite, sin
from operator import eq
from typing import Final

import numpy as np

from fsw.dictionary.evrs import CyclesSkipped, Evr
from fsw.dictionary.faults import (
    CycleCountWrong,
    CyclesMissed,
    GravityImplausible,
    SensorFrozen,
    SensorNotFinite,
    StructureTemperatureImplausible,
    TiltChanged,
)
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.protect.bounds import ProtectionBounds

NOISY: Final = ("resolver_rad",) * 5 + ("current_A",) * 5 + ("gravity_R_m_s2",) * 3 + ("structure_C",)
"""Sensor of each number that has noise: it never stays the same for long, even at rest."""
NONE_UNCHANGED: Final = (0,) * len(NOISY)
ANALOG: Final = ("resolver_rad", "current_A", "winding_C", "gravity_R_m_s2", "structure_C")
"""Sensors whose readings are real numbers."""


def check_readings(bounds: ProtectionBounds, sensors: Sensors) -> tuple[Evr, ...]:
    """Find readings that nothing may be computed from: not finite, no gravity, or no temperature of an arm.

    This comes first in a cycle. Comparisons with NaN are all false and clip nothing, and a wild value stays
    in filters.
    """
    # hypot raises no warning, and is finite only if all its arguments are
    if not isfinite(hypot(*noisy_readings(sensors), *sensors.winding_C.tolist())):
        found = tuple(
            SensorNotFinite(name)
            for name in ANALOG
            if not isfinite(hypot(*np.ravel(getattr(sensors, name)).tolist()))
        )
        if found:
            return found
    gravity, monitors = hypot(*sensors.gravity_R_m_s2.tolist()), bounds.monitors
    if not monitors.gravity_min_m_s2 <= gravity <= monitors.gravity_max_m_s2:
        return (GravityImplausible(gravity, monitors.gravity_min_m_s2, monitors.gravity_max_m_s2),)
    low, high = monitors.structure_min_C, monitors.structure_max_C
    if not low <= sensors.structure_C <= high:
        return (StructureTemperatureImplausible(sensors.structure_C, low, high),)
    return ()


def noisy_readings(sensors: Sensors) -> tuple[float, ...]:
    """Return the numbers that have noise, in the order of NOISY."""
    return (
        *sensors.resolver_rad.tolist(),
        *sensors.current_A.tolist(),
        *sensors.gravity_R_m_s2.tolist(),
        sensors.structure_C,
    )


def check_frozen(
    bounds: ProtectionBounds, unchanged: tuple[int, ...], before: tuple[float, ...], now: tuple[float, ...]
) -> tuple[tuple[int, ...], tuple[Evr, ...]]:
    """Check that no noisy reading stays the same to the last bit.

    Args:
        bounds: Bounds of protection.
        unchanged: For how many cycles each reading had been the same, in the order of NOISY.
        before: Noisy readings of the cycle before.
        now: Noisy readings of this cycle.

    Returns:
        For how many cycles each reading has been the same, and the faults.
    """
    if not any(map(eq, before, now)):
        return NONE_UNCHANGED, ()
    counts = tuple([n + 1 if a == b else 0 for a, b, n in zip(before, now, unchanged, strict=True)])
    bound = bounds.monitors.frozen_persistence
    if max(counts) < bound:
        return counts, ()
    frozen = {name: count for name, count in zip(NOISY, counts, strict=True) if count >= bound}
    return counts, tuple(SensorFrozen(name, count) for name, count in frozen.items())


def check_cycle_count(bounds: ProtectionBounds, before: int | None, now: int) -> tuple[Evr, ...]:
    """Check that the cycle count of the avionics rises by one; a few missed cycles are only reported."""
    if before is None or now == before + 1:
        return ()
    if now <= before:
        return (CycleCountWrong(now, before),)
    cycles, bound = now - before - 1, bounds.monitors.missed_cycles
    return (CyclesSkipped(cycles),) if cycles <= bound else (CyclesMissed(cycles, bound),)


def check_tilt(
    bounds: ProtectionBounds, count: int, planned_R: Array, read_R: Array
) -> tuple[int, tuple[Evr, ...]]:
    """Check that gravity has the direction that the move under way was planned for.

    Args:
        bounds: Bounds of protection.
        count: Cycles in a row in which the direction was beyond its bound.
        planned_R: Gravity when the move began, in the rover frame, shape (3,); any length.
        read_R: Gravity as it is read, in the rover frame, shape (3,); any length.

    Returns:
        The count with this cycle, and the fault.
    """
    monitors, planned = bounds.monitors, planned_R.tolist()
    # vectors this close cannot differ more in direction
    if dist(planned, read_R.tolist()) <= sin(monitors.tilt_rad) * hypot(*planned):
        return 0, ()
    turned = atan2(float(np.linalg.norm(np.cross(planned_R, read_R))), float(planned_R @ read_R))
    if turned <= monitors.tilt_rad:
        return 0, ()
    if count + 1 < monitors.tilt_persistence:
        return count + 1, ()
    return count + 1, (TiltChanged(turned, monitors.tilt_rad),)
