"""Dry friction of the outputs: full at any speed, no creep below it, and one crossing of the backlash."""

import numpy as np
import pytest

from helpers.marks import slow_but
from sim.plant import Plant
from tests.sim import lab

SLOW_RAD_S = np.radians(0.1)
CREEP_RAD = 1e-6
"""Limit for 60 s at nine tenths of the friction: a five-hundredth of what moves the tool by a millimetre."""


def weightless() -> Plant:
    """Return the ready pose without gravity, on its brakes."""
    plant = lab.plant()
    plant.model.opt.gravity[:] = 0.0
    plant.place(lab.READY_RAD, 0.0)
    return plant


@pytest.mark.parametrize("direction", [1, -1])
def test_output_friction_is_there_in_full_at_a_tenth_of_a_degree_per_second(direction: int) -> None:
    """The motors drag the outputs at a steady rate, so that the gear torque is the friction."""
    plant = weightless()
    lab.hold_by_motors(plant)
    travelled = 0.0
    for _ in range(8 * lab.CYCLE_HZ):
        travelled += direction * SLOW_RAD_S / lab.CYCLE_HZ
        plant.data.ctrl[0::2] = lab.READY_RAD + travelled
        plant.data.ctrl[1::2] = direction * SLOW_RAD_S
        plant.step()
    before = plant.output_rad()
    transmitted = []
    for _ in range(lab.CYCLE_HZ):
        travelled += direction * SLOW_RAD_S / lab.CYCLE_HZ
        plant.data.ctrl[0::2] = lab.READY_RAD + travelled
        plant.step()
        transmitted.append(lab.gear_torque_Nm(plant))
    np.testing.assert_allclose(plant.output_rad() - before, direction * SLOW_RAD_S, rtol=0.05)
    np.testing.assert_allclose(np.mean(transmitted, axis=0), -direction * lab.OUTPUT_FRICTION_NM, rtol=0.02)


def pulled(share: float) -> Plant:
    """Return the weightless arm with a share of their friction on all outputs."""
    plant = weightless()
    gears = [plant.model.joint(f"{name}_gear").dofadr[0] for name in lab.JOINT_NAMES]
    plant.data.qfrc_applied[gears] = share * lab.OUTPUT_FRICTION_NM
    return plant


@pytest.mark.parametrize("side", slow_but([1, -1], 1))
def test_below_the_friction_an_output_in_its_gap_does_not_creep_and_above_it_goes_to_the_flank(side):
    plant = pulled(0.9 * side)
    lab.run(plant, 1.0)
    start = plant.output_rad()
    assert np.all(np.abs(lab.gear_rad(plant)) < 0.1 * lab.HALF_BACKLASH_RAD)
    lab.run(plant, 60.0)
    assert np.abs(plant.output_rad() - start).max() < CREEP_RAD
    plant = pulled(1.1 * side)
    lab.run(plant, 10.0)
    assert np.all(side * lab.gear_rad(plant) > 0.999 * lab.HALF_BACKLASH_RAD)


def flanks(gear_rad: lab.Array, joint: int) -> list[int]:
    """Return the sequence of flanks on which a joint lay, with 0 for between them, without repetitions."""
    half = lab.HALF_BACKLASH_RAD[joint]
    side = np.where(np.abs(gear_rad) < half, 0, np.sign(gear_rad)).astype(int)
    return [int(s) for k, s in enumerate(side) if k == 0 or s != side[k - 1]]


@pytest.mark.parametrize("held", slow_but(["brakes", "motors"], "motors"))
def test_the_gap_is_crossed_once_when_gravity_changes_side(held: str) -> None:
    """Turn gravity over a horizontal line in 40 s; every joint but the azimuth changes flank, each once.

    Every step is checked, so that a bounce of a single step would show.
    """
    plant = lab.plant()
    pose = np.radians([0.0, -60.0, 60.0, 0.0, 90.0])
    start, end = 4.0, -4.0
    plant.model.opt.gravity[:] = (0.0, 1.5, -start)
    lab.load(plant, pose)
    if held == "motors":
        lab.hold_by_motors(plant)
    plant.steps_per_cycle = 1
    gear = []
    steps = round(40 / plant.model.opt.timestep)
    for k in range(steps):
        plant.model.opt.gravity[2] = -(start + (end - start) * (k + 1) / steps)
        plant.step()
        gear.append(plant.data.qpos[plant.at.gear])
    way = np.array(gear)
    for joint in (1, 2, 3):
        assert flanks(way[:, joint], joint) in ([1, 0, -1], [-1, 0, 1])
        crossing = way[np.abs(way[:, joint]) < lab.HALF_BACKLASH_RAD[joint], joint]
        onward = np.diff(crossing) * np.sign(way[-1, joint])
        assert -onward[onward < 0].sum() < 0.01 * lab.HALF_BACKLASH_RAD[joint]


@pytest.mark.slow
def test_the_gap_is_crossed_once_when_a_joint_carries_its_load_over_the_vertical() -> None:
    """The wrist swings the turret at 1 deg/s through the pose of zero load."""
    plant = lab.plant()
    lab.load(plant, np.radians([0.0, -60.0, 60.0, 40.0, 0.0]))
    lab.hold_by_motors(plant)
    plant.steps_per_cycle = 1
    gear, rate = [], np.radians(-1.0)
    step_s = plant.model.opt.timestep
    for k in range(round(80 / step_s)):
        plant.data.ctrl[6] = np.radians(40.0) + rate * (k + 1) * step_s
        plant.data.ctrl[7] = rate
        plant.step()
        gear.append(plant.data.qpos[plant.at.gear[3]])
    assert flanks(np.array(gear), 3) in ([1, 0, -1], [-1, 0, 1])
