"""A press is trimmed by the currents: they tell how stiff the arm is, whatever friction and weight add."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import Preload
from fsw.dictionary.evrs import ForceFelt, Preloaded
from fsw.dictionary.joints import Tool
from fsw.motion.move import Phase
from fsw.motion.trim import FEWEST, PressFit
from tests.fsw.executive.lab import TOUCHED, guarded_in_contact

FRICTION_NM = np.array([170.0, 170.0, 170.0, 39.0, 39.0])


def pressed(stiffness: float, friction: float = 1.0, offset_Nm: float = 0.0, force_N: float = 200.0):
    """A press on an arm so many times as stiff as believed, its motors drawing what that takes.

    Friction is so many times what the hardstops told, and every current is off by so much torque.
    """
    rig = guarded_in_contact()
    joints = rig.state.joints
    reference = replace(joints.reference, friction_Nm=FRICTION_NM)
    rig.state = replace(rig.state, joints=replace(joints, reference=reference))
    rig.cycle(Preload(Tool.APXS, force_N), **TOUCHED)
    while rig.outputs.joint.busy:
        rig.cycle(current_A=currents(rig, stiffness, friction, offset_Nm), **TOUCHED)
    return rig


def currents(rig, stiffness: float, friction: float, offset_Nm: float) -> np.ndarray:
    state, config = rig.state, rig.config
    move = state.move
    if move.phase is not Phase.RUN:
        return np.full(5, 1e-9 * state.tick)
    extra = (stiffness - 1.0) * move.press.torque_per_N * state.pressing.force_N
    resisting = friction * FRICTION_NM * np.sign(move.hold.rate_rad_s)
    torque = resisting - state.load.torque_Nm - extra + offset_Nm
    return torque / config.torque_constant_Nm_A + 1e-9 * state.tick


@pytest.mark.parametrize("stiffness", [0.8, 0.9, 1.15])
@pytest.mark.parametrize(("friction", "offset_Nm"), [(1.0, 0.0), (1.05, 5.0)])
def test_the_share_of_the_force_is_felt_and_made_up_for(stiffness, friction, offset_Nm):
    rig = pressed(stiffness, friction, offset_Nm)
    (felt,) = [evr for evr in rig.evrs if isinstance(evr, ForceFelt)]
    assert felt.share == pytest.approx(stiffness, abs=0.03)
    assert Preloaded(Tool.APXS, 200.0) in rig.evrs
    assert rig.state.pressing.force_N * stiffness == pytest.approx(200.0, rel=0.04)


def test_an_arm_as_stiff_as_believed_is_pressed_once():
    rig = pressed(1.0)
    assert not any(isinstance(evr, ForceFelt) for evr in rig.evrs)
    assert rig.state.pressing.force_N == 200.0


@pytest.mark.parametrize("slope", [0.3, 3.0])
def test_a_slope_beyond_belief_is_none(slope):
    x = np.linspace(0.0, 300.0, 2 * FEWEST)
    fit = PressFit(x.size, x.sum(), slope * x.sum(), (x * x).sum(), slope * (x * x).sum(), 0.0, 300.0)
    assert fit.slope() is None


def test_too_few_cycles_or_too_little_force_tell_nothing():
    x = np.linspace(100.0, 110.0, 2 * FEWEST)
    fit = PressFit(x.size, x.sum(), x.sum(), (x * x).sum(), (x * x).sum(), 100.0, 110.0)
    assert fit.slope() is None
    assert replace(fit, n=FEWEST - 1, most_N=300.0).slope() is None
