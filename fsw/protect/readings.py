"""Monitors of the readings themselves: whether they are numbers, alive, and as many as there should be."""

from math import hypot, isfinite
from operator import eq
from typing import Final

from fsw.config import Config
from fsw.dictionary.evrs import CyclesSkipped, Evr
from fsw.dictionary.faults import CyclesMissed, GravityImplausible, SensorFrozen, SensorNotFinite
from fsw.messages import Sensors

LIVELY: Final = ("resolver_rad",) * 5 + ("current_A",) * 5 + ("gravity_R_m_s2",) * 3
"""Of which sensor each number is that is never the same for long, even at rest: it has noise."""
LIVE: Final = (0,) * len(LIVELY)
"""For how many cycles each of those has been the same, if none is."""
ANALOG: Final = ("resolver_rad", "current_A", "winding_C", "gravity_R_m_s2")
"""The sensors whose readings are real numbers."""


def unusable(config: Config, sensors: Sensors) -> tuple[Evr, ...]:
    """Readings that nothing may be computed from.

    This comes first: comparisons with NaN are all false and clip nothing, and a wild value stays in filters.
    """
    # hypot warns of nothing, and is finite only if all its arguments are
    if not isfinite(hypot(*lively(sensors), *sensors.winding_C.tolist())):
        found = tuple(
            SensorNotFinite(name) for name in ANALOG if not isfinite(hypot(*getattr(sensors, name).tolist()))
        )
        if found:
            return found
    gravity, bounds = hypot(*sensors.gravity_R_m_s2.tolist()), config.params.monitors
    if bounds.gravity_min_m_s2 <= gravity <= bounds.gravity_max_m_s2:
        return ()
    return (GravityImplausible(gravity, bounds.gravity_min_m_s2, bounds.gravity_max_m_s2),)


def lively(sensors: Sensors) -> tuple[float, ...]:
    """The numbers that have noise, in the order of LIVELY."""
    return (
        *sensors.resolver_rad.tolist(),
        *sensors.current_A.tolist(),
        *sensors.gravity_R_m_s2.tolist(),
    )


def frozen(
    config: Config, last: tuple[int, ...], before: tuple[float, ...], now: tuple[float, ...]
) -> tuple[tuple[int, ...], tuple[Evr, ...]]:
    """A number that stays the same to the last bit; for how many cycles each has, and what was found."""
    if not any(map(eq, before, now)):
        return LIVE, ()
    same = tuple([count + 1 if a == b else 0 for a, b, count in zip(before, now, last, strict=True)])
    bound = config.params.monitors.frozen_persistence
    if max(same) < bound:
        return same, ()
    stands = {name: count for name, count in zip(LIVELY, same, strict=True) if count >= bound}
    return same, tuple(SensorFrozen(name, count) for name, count in stands.items())


def missed(config: Config, before: int | None, now: int) -> tuple[Evr, ...]:
    """Cycles of the avionics in which flight software was not called: a few of them are only reported."""
    if before is None or now <= before + 1:
        return ()
    cycles, bound = now - before - 1, config.params.monitors.missed_cycles
    return (CyclesSkipped(cycles),) if cycles <= bound else (CyclesMissed(cycles, bound),)
