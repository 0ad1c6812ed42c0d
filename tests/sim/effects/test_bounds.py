"""Every effect at both ends of its bounds, on an arm that moves: the plant does not diverge."""

from itertools import product
from typing import get_args

import numpy as np
import pytest

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import joints5
from helpers.marks import slow_but
from sim.arms import arm_named
from sim.effects.catalogue import all_places, catalogue, parameters_of
from sim.effects.faults import SensorFault, SensorName, WeakMotor
from sim.effects.structure import LinkCreep
from sim.loop import ClosedLoop, Setup
from sim.scenario.effects import effect_text
from sim.setting import World
from tests.sim.lab import true_reference

NOMINAL = arm_named("nominal")
READY = np.array(NOMINAL.params.poses.ready_rad)
TURN_RAD = 0.05
RUN_S = 3.0
BEGIN_S = 1.0
"""Time at which timed effects begin: the joints are at full speed."""


def ends_of(parameter) -> tuple[object, ...]:
    """Return both ends of a parameter; one value for a time, and for a parameter without bounds."""
    size = parameter.spec
    if parameter.field == "at_s":
        return (BEGIN_S,)
    if size is None:
        return (parameter.default,)
    ends = [int(end) if size.unit == "cycle" else end for end in (size.low, size.high)]
    return tuple(end if parameter.count == 1 else (end,) * parameter.count for end in ends)


def places_of(kind) -> list[dict[str, object]]:
    """Return the first and the last place of an effect; those of all sensors whose error has a size."""
    if kind is SensorFault:
        return [{"sensor": name, "kind": way} for name in get_args(SensorName) for way in ("biased", "noisy")]
    places = list(all_places(kind))
    return places[:: max(len(places) - 1, 1)]


def effects_at_their_ends(kind):
    """Yield the effect at its places, with every combination of the ends."""
    parameters = parameters_of(kind)
    for place in places_of(kind):
        for ends in product(*map(ends_of, parameters)):
            try:
                yield kind(**place, **dict(zip((p.field for p in parameters), ends, strict=True)))
            except ValueError:
                continue  # the class itself refuses this combination, with a reason


def moving_with(effect) -> ClosedLoop:
    """Return an arm with an effect that begins to turn all joints."""
    loop = ClosedLoop(
        Setup(NOMINAL, World(), joints5(READY), reference=true_reference(NOMINAL), effects=(effect,))
    )
    loop.cycle((MoveJoints(joints5(READY + TURN_RAD)),))
    return loop


@pytest.mark.parametrize("name", slow_but(catalogue(), "weak-motor", "link-creep", "bus-sag", "joint-seized"))
def test_an_arm_with_an_effect_at_either_end_of_its_bounds_does_not_diverge(name):
    tried = 0
    for effect in effects_at_their_ends(catalogue()[name]):
        loop = moving_with(effect)
        for _ in range(round(RUN_S * CYCLE_HZ)):
            loop.cycle()  # PlantDiverged tells of a plant that does
            assert loop.failure is None, effect_text(effect)
        assert np.isfinite(loop.plant.data.qpos).all(), effect_text(effect)
        tried += 1
    assert tried


def test_a_motor_without_torque_stands_and_its_current_reads_at_its_limit():
    loop = moving_with(WeakMotor(BEGIN_S, Joint.WRIST, 0.0))
    for _ in range(CYCLE_HZ + 1):
        loop.cycle()
    at_rad = loop.plant.motor_rad()[Joint.WRIST]
    largest_A = 0.0
    for _ in range(CYCLE_HZ):
        largest_A = max(largest_A, abs(loop.plant.motor_current_A()[Joint.WRIST]))
        loop.cycle()
    assert largest_A == pytest.approx(loop.config.current_limit_A[Joint.WRIST], rel=1e-6)
    assert loop.plant.motor_rad()[Joint.WRIST] == pytest.approx(at_rad, abs=2e-3)


def test_a_link_that_would_creep_faster_than_a_cycle_creeps_to_compliance_times_load():
    creep = LinkCreep(Frame.ARM3, "y", 1e-4, 0.1)
    loop = ClosedLoop(Setup(NOMINAL, World(), joints5(READY), effects=(creep,)))
    for _ in range(3 * CYCLE_HZ):
        loop.cycle()
    model, data, at = loop.plant.model, loop.plant.data, loop.plant.at.springs[creep.frame][1]
    load_Nm = model.jnt_stiffness[model.dof_jntid[at]] * (data.qpos[at] - model.qpos_spring[at])
    assert abs(load_Nm) > 10.0
    assert model.qpos_spring[at] == pytest.approx(creep.compliance_rad_Nm * load_Nm, rel=0.01)
