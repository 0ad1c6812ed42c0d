"""Plant with other numerical settings: nearly the same arm, and not a hypothesis."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from sim.effects.catalogue import hypotheses
from sim.effects.environment import Numerics
from sim.scenario.effects import effect_text, parse_effect_text
from tests.marks import slow_but
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import TOOLS

FINER = 6


def test_it_is_no_hypothesis() -> None:
    assert Numerics not in {one.kind for one in hypotheses()}


def test_it_comes_back_from_what_is_written_of_it() -> None:
    for one in (Numerics("implicit", 2), Numerics("explicit", 6)):
        assert parse_effect_text(effect_text(one), TOOLS) == one


@pytest.mark.parametrize("scheme", slow_but(["implicit", "explicit"], "implicit"))
def test_the_arm_hangs_where_it_hangs_whatever_computes_it(scheme: str) -> None:
    drawn, other = (bench.build_arm(*effects)[0] for effects in ((), (Numerics(scheme, FINER),)))
    for plant in (drawn, other):
        plant.place(lab.READY_RAD, 16.0)
    assert other.steps_per_cycle == FINER * drawn.steps_per_cycle
    np.testing.assert_allclose(other.output_rad(), drawn.output_rad(), atol=2e-6)
    held = other.gear_torque_Nm()[Joint.ELEVATION]
    assert held == pytest.approx(drawn.gear_torque_Nm()[Joint.ELEVATION], rel=0.02)
