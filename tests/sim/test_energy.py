"""Energy of the plant, and the friction that takes it."""

import mujoco
import numpy as np
import pytest

from helpers.marks import slow_but
from sim.mujoco_settings import REFERENCE_STEP_S
from sim.plant import Plant, PlantDiverged
from sim.setting import World
from tests.sim import lab

ELEVATION = 1
OUTBOARD = (
    # kg, and metres forward of the elevation axis: the tables Mass and Kinematics of the drawing;
    # structure and actuator of a link apart
    (6.8, 0.42),
    (7.8, 0.827),
    (6.4, 0.827 + 0.33),
    (4.24, 0.827 + 0.785),
    (4.92, 0.827 + 0.785 - 0.08),
    (4.24, 0.827 + 0.785 - 0.144),
    (31.4, 0.827 + 0.785 - 0.144 + 0.02),
)
SIDEWAYS_M_S2 = (3.711, 0.0, 0.0)


def test_the_torque_that_holds_the_arm_is_its_load_give_or_take_the_friction():
    plant = lab.load(lab.plant(World("earth")), lab.STRAIGHT_RAD)
    lab.hold_by_motors(plant)
    lab.run(plant, 8.0)
    by_hand = 9.81 * sum(kg * arm_m for kg, arm_m in OUTBOARD)
    assert abs(plant.truth().motor_torque_Nm[ELEVATION]) == pytest.approx(by_hand, abs=171 + 10)


def remove_friction(spec: mujoco.MjSpec) -> None:
    """Remove friction from the specification, and compute the energy in every step."""
    spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    lab.without_output_friction(spec)
    for name in lab.JOINT_NAMES:
        motor = spec.joint(f"{name}_motor")
        motor.frictionloss = 0.0
        motor.damping = 0.0 * motor.damping


def remove_friction_and_damping(spec: mujoco.MjSpec) -> None:
    """Remove friction and damping."""
    remove_friction(spec)
    for part in (*spec.joints, *spec.tendons):
        part.damping = 0.0 * part.damping


def free_swing(plant: Plant) -> tuple[lab.Array, lab.Array, lab.Array]:
    """Swing the level arm about its azimuth axis for three seconds, under sideways gravity.

    Returns total energy, kinetic energy and the power of the dampers after each step.
    """
    model, data = plant.model, plant.data
    model.opt.gravity[:] = SIDEWAYS_M_S2
    lab.load(plant, np.radians([-20.0, 0.0, 0.0, 0.0, 0.0]), duration_s=4.0)
    plant.brake(0, False)
    total, kinetic, power = [], [], []
    for step in range(round(3.0 / model.opt.timestep)):
        if step % plant.steps_per_cycle == 0:
            plant.damp_gears()
        mujoco.mj_step(model, data)
        total.append(data.energy.sum())
        kinetic.append(data.energy[1])
        damping, gears = effective_damping(model)
        power.append(damping @ data.qvel**2 + gears @ data.ten_velocity**2)
    assert not data.warning.number.any()
    assert np.ptp(total) > 0.0
    return np.array(total), np.array(kinetic), np.array(power)


def effective_damping(model: mujoco.MjModel) -> tuple[lab.Array, lab.Array]:
    """Return the damping of joints and tendons, with the part that the integrator adds."""
    step_s = model.opt.timestep
    joints = model.dof_damping + step_s * model.jnt_stiffness
    on_flank = model.tendon_damping != 0
    return joints, model.tendon_damping + step_s * model.tendon_stiffness * on_flank


@pytest.mark.slow
def test_without_friction_and_damping_a_free_swing_keeps_its_energy():
    """The tolerance at the reference step is one per cent of the exchanged energy; no step gains any."""
    total, kinetic, _ = free_swing(lab.plant(time_step_s=REFERENCE_STEP_S, edit=remove_friction_and_damping))
    assert kinetic.max() > 10.0
    assert total.max() - total[0] < 1e-3
    assert total[0] - total[-1] < 0.01 * kinetic.max()


@pytest.mark.parametrize(
    ("step_s", "share"),
    slow_but([(None, 0.01), (REFERENCE_STEP_S, 0.0015)], (None, 0.01)),
    ids=["own", "reference"],
)
def test_with_damping_a_free_swing_loses_what_the_dampers_take(step_s, share):
    """The tolerance is a share of the exchanged energy."""
    plant = lab.plant(time_step_s=step_s, edit=remove_friction)
    total, kinetic, power = free_swing(plant)
    taken = plant.model.opt.timestep * power[1:].sum()
    assert taken > 0.005 * kinetic.max()
    assert total[0] - total[-1] == pytest.approx(taken, abs=share * kinetic.max())


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_a_plant_that_blows_up_is_not_believed_and_leaves_no_file(bad, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plant = lab.plant()
    plant.place(lab.READY_RAD, 0.1)
    plant.data.qvel[0] = bad
    with pytest.raises(PlantDiverged, match=r"mjWARN_BAD\w+ at \d+\.\d+ s"):
        plant.step()
    assert not list(tmp_path.iterdir())


def test_a_plant_that_blows_up_while_it_is_placed_is_not_believed():
    plant = lab.plant()
    with pytest.raises(PlantDiverged):
        plant.place(np.array([np.nan, 0.0, 0.0, 0.0, 0.0]), 0.1)


def test_a_step_that_does_not_divide_the_control_cycle_is_refused():
    with pytest.raises(ValueError, match="does not divide"):
        lab.plant(time_step_s=1 / 500)


SLOW_RAD_S = np.radians(0.1)
CREEP_RAD = 1e-6
"""Limit for 60 s at nine tenths of the friction: a five-hundredth of what moves the tool by a millimetre."""


@pytest.mark.parametrize("direction", [1, -1])
def test_output_friction_is_there_in_full_at_a_tenth_of_a_degree_per_second(direction):
    """The motors drag the outputs at a steady rate, so that the gear torque is the friction."""
    plant, setpoint_rad, transmitted = lab.weightless(), lab.READY_RAD.copy(), []
    lab.hold_by_motors(plant)
    for _ in range(9 * lab.CYCLE_HZ):
        setpoint_rad += direction * SLOW_RAD_S / lab.CYCLE_HZ
        plant.command(setpoint_rad, np.full(5, direction * SLOW_RAD_S))
        plant.step()
        transmitted.append(lab.gear_torque_Nm(plant))
    mean_Nm = np.mean(transmitted[-lab.CYCLE_HZ :], axis=0)
    np.testing.assert_allclose(mean_Nm, -direction * lab.OUTPUT_FRICTION_NM, rtol=0.02)


def pulled(share: float) -> Plant:
    """Return the weightless arm with a share of their friction on all outputs."""
    plant = lab.weightless()
    plant.data.qfrc_applied[plant.at.gear] = share * lab.OUTPUT_FRICTION_NM
    return plant


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, -1])
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


@pytest.mark.slow
@pytest.mark.parametrize("held", ["brakes", "motors"])
def test_the_gap_is_crossed_once_when_gravity_changes_side(held):
    """Turn gravity over a horizontal line in 20 s; every joint but the azimuth changes flank, each once.

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
    steps = round(20 / plant.model.opt.timestep)
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
