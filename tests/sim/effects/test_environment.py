"""Surroundings of the arm: surfaces nearer or stiffer than measured, and other numerical settings."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.dictionary.types import vector3
from helpers.marks import slow_but
from sim.effects.effect import Effect
from sim.effects.environment import ContactStiffness, Numerics, SurfacePosition
from sim.frames import P_NR_M
from sim.plant import Plant
from sim.setting import Surface, World
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import tool_index

DEEP_M = 2e-4


def put_in_rock(*effects: Effect, deep_m: float = DEEP_M, calm: bool = False) -> Plant:
    """Put the pads of the APXS slightly inside a rock, at rest."""
    truth = bench.set_angles(bench.build_arm()[0], lab.READY_RAD).truth()
    normal = -truth.R_RT[tool_index("apxs")][:, 0]
    face = truth.p_RoTo_R_m[tool_index("apxs")] + P_NR_M + deep_m * normal
    world = World(surface=Surface(vector3(face), vector3(normal)))
    plant, _ = bench.build_arm(*effects, world=world, calm=calm)
    return bench.set_angles(plant, lab.READY_RAD)


def depth_m(plant: Plant) -> float:
    return float(np.mean([-contact.dist for contact in plant.data.contact]))


@pytest.mark.parametrize("offset_m", [-1e-4, 1e-4, 3e-4])
def test_a_surface_that_is_nearer_is_met_that_much_earlier(offset_m: float) -> None:
    assert put_in_rock().data.ncon == 2
    assert depth_m(put_in_rock()) == pytest.approx(DEEP_M, abs=1e-9)
    assert depth_m(put_in_rock(SurfacePosition(offset_m))) == pytest.approx(DEEP_M + offset_m, abs=1e-9)


@pytest.mark.parametrize("factor", [0.5, 2.0, 4.0])
def test_what_is_stiffer_gives_way_less_under_the_same_force(factor: float) -> None:
    """Press the braked arm into the rock by its own springs, at rest."""
    stiffness = []
    for effects in ((), (ContactStiffness(factor),)):
        plant = put_in_rock(*effects, deep_m=1e-3, calm=True)
        plant.place(lab.READY_RAD, 4.0)
        assert plant.truth().contact_force_N > 5.0
        stiffness.append(plant.truth().contact_force_N / (len(plant.data.contact) * depth_m(plant)))
    assert stiffness[1] / stiffness[0] == pytest.approx(factor, rel=0.02)


def test_where_there_is_no_rock_there_is_nothing_to_shift() -> None:
    bench.build_arm(SurfacePosition(1e-3))


FINER = 6


@pytest.mark.parametrize("scheme", slow_but(["implicit", "explicit"], "implicit"))
def test_the_arm_hangs_where_it_hangs_whatever_computes_it(scheme: str) -> None:
    drawn, other = (bench.build_arm(*effects)[0] for effects in ((), (Numerics(scheme, FINER),)))
    for plant in (drawn, other):
        plant.place(lab.READY_RAD, 8.0)
    assert other.steps_per_cycle == FINER * drawn.steps_per_cycle
    np.testing.assert_allclose(other.output_rad(), drawn.output_rad(), atol=2e-6)
    held = other.gear_torque_Nm()[Joint.ELEVATION]
    assert held == pytest.approx(drawn.gear_torque_Nm()[Joint.ELEVATION], rel=0.02)
