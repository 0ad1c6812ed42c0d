"""Taught places: the true tool returns to them, whatever the errors of flight software."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveTeachPoint
from fsw.dictionary.evrs import CommandCompleted
from sim.arms import arm_named
from sim.effects.environment import NothingToTouch
from sim.frames import p_R_from_N
from sim.loop import ClosedLoop, Setup
from sim.scenario.data import TaughtPoint
from sim.scenario.run import NotTaught, teach
from sim.sequence import run_sequence
from sim.setting import World
from tests.sim import lab
from tests.tools import tool_index

AIR = TaughtPoint("air", "apxs", (2.0, 0.2, -0.5), (0.3, 0.0, 1.0))
"""Place in free air."""
WORLD = World(tilt_roll_rad=0.1, tilt_pitch_rad=-0.2)


def teaching_errors(name: str, point: TaughtPoint = AIR) -> tuple[float, float, float]:
    """Return the true errors of the tool in position [m] and axis [rad], and the stored offset [m]."""
    arm = arm_named(name)
    reference = lab.true_reference(arm)
    known = teach(arm, reference, (point,), WORLD)
    setup = Setup(known, WORLD, arm.params.poses.ready_rad, 1, reference, (NothingToTouch(),))
    loop = ClosedLoop(setup)
    evrs = [evr for record in run_sequence(loop, (MoveTeachPoint("air"),)) for evr in record.outputs.evrs]
    assert CommandCompleted("MoveTeachPoint") in evrs, evrs[-1].message
    truth, place = loop.plant.truth(), p_R_from_N(np.array(point.p_N_m))
    believed = next(p for p in known.params.teach if p.name == "air")
    axis = truth.R_RT[tool_index(point.tool)][:, 0]
    return (
        float(np.linalg.norm(truth.p_RoTo_R_m[tool_index(point.tool)] - place)),
        float(np.arccos(np.clip(axis @ point.approach_N / np.linalg.norm(point.approach_N), -1, 1))),
        float(np.linalg.norm(np.array(believed.p_RoTo_R_m) - place)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nominal", "as-built:3", "as-built:8"])
def test_an_arm_comes_back_to_the_true_place_even_if_it_believes_to_be_elsewhere(name):
    off_m, axis_rad, believed_m = teaching_errors(name)
    if name == "nominal":
        assert max(off_m, believed_m) < 1e-3
        assert axis_rad < 2e-3
    else:
        assert believed_m > 4e-3
        assert off_m < 3e-3
        assert axis_rad < np.radians(1.5)


def test_places_of_the_drawing_stay_and_those_of_the_same_name_are_taught_anew():
    arm = arm_named("nominal")
    names = [point.name for point in arm.params.teach]
    anew = TaughtPoint(names[0], AIR.tool, AIR.p_N_m, AIR.approach_N)
    known = teach(arm, lab.true_reference(arm), (anew,), World())
    assert sorted(point.name for point in known.params.teach) == sorted(names)


def test_a_place_out_of_reach_is_told():
    arm = arm_named("nominal")
    far = TaughtPoint("far", "drill", (9.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    with pytest.raises(NotTaught, match="nominal: far is out of reach of the drill"):
        teach(arm, lab.true_reference(arm), (far,), World())
