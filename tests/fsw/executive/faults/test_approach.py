"""A guarded tool that touches something although no switch says so."""

import pytest

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Mode
from fsw.dictionary.faults import Fault, PreloadOutside, UnexpectedContact
from tests.fsw.executive.faults.lab import (
    BOUNDS,
    CONFIG,
    REFUSED,
    braked,
    closed,
    found,
    in_guarded_motion,
    moving,
)
from tests.fsw.rig import MARS_R_m_s2, levers_m
from tests.tools import TOOL_SWITCHES, TOOLS

PRESSING = [tool for tool in TOOLS if TOOL_SWITCHES[tool]]
LATEST = 40


def pushed(rig, tool, force_N, cycles, **readings):
    """Resolvers that show a force, and encoders that do not."""
    levers = levers_m(CONFIG.arm, tool, rig.state.joints.output_rad, MARS_R_m_s2)
    wound = force_N * levers / CONFIG.arm.gear_stiffness_Nm_rad
    for _ in range(cycles):
        rig.cycle(resolver_rad=rig.resolver_rad() + wound, **readings)
        if found(rig, Fault):
            break


@pytest.mark.parametrize("tool", PRESSING)
def test_a_force_on_a_guarded_tool_that_closes_no_switch_stops_the_arm(tool):
    rig = in_guarded_motion(tool)
    pushed(rig, tool, 1.5 * BOUNDS.guarded_force_N, LATEST)
    (evr,) = found(rig, Fault)
    assert evr == PreloadOutside(tool, 0.0, evr.error_N, evr.bound_N)
    assert evr.error_N > evr.bound_N >= BOUNDS.guarded_force_N
    assert REFUSED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert braked(rig)


@pytest.mark.parametrize(
    ("share", "switches"),
    [(0.8, ()), (-3.0, ()), (2.0, TOOL_SWITCHES["apxs"][:1])],
    ids=["small", "pull", "touch"],
)
def test_a_force_that_is_small_or_pulls_or_that_a_switch_shows_does_not(share, switches):
    rig = in_guarded_motion()
    pushed(rig, "apxs", share * BOUNDS.guarded_force_N, LATEST, **closed(*switches))
    assert not found(rig, Fault)


def test_a_large_force_is_felt_within_three_cycles():
    rig = in_guarded_motion()
    pushed(rig, "apxs", 10.0 * BOUNDS.guarded_force_N, 3)
    assert found(rig, PreloadOutside)


def test_in_free_space_a_force_is_an_unexpected_contact():
    rig = moving()
    for _ in range(CYCLE_HZ):  # until the mean of the wind-up is known
        rig.cycle()
    pushed(rig, "apxs", 4.0 * BOUNDS.guarded_force_N, 2 * LATEST)
    (evr,) = found(rig, Fault)
    assert isinstance(evr, UnexpectedContact)
    assert REFUSED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert rig.state.fault.may_touch
    assert braked(rig)
