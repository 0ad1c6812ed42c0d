"""Rest positions of the arm: they converge with the time step, and each gear rests where its load puts it."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.evrs import CommandCompleted
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.mujoco_settings import REFERENCE_STEP_S
from sim.sequence import run_sequence
from sim.setting import World
from tests.sim import lab

CONVERGED_MM = 0.005
STOPPED_MM = 0.02
"""Limit with the motors on, which stop within three of their counts of their set-points."""
FINE_S = REFERENCE_STEP_S
AT_REST_J = 1e-7
"""Energy at which the arm still swings by about 6 um."""
WORLDS = {"mars": World(), "mars, 25 deg": lab.tilted_world(20, -15), "earth": World("earth")}
POSES = {"straight": lab.STRAIGHT_RAD, "ready": lab.READY_RAD, "stowed": lab.STOWED_RAD, "left": lab.LEFT_RAD}


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
@pytest.mark.parametrize("pose", POSES)
def test_on_its_brakes_the_arm_rests_at_the_same_pose_with_a_tenth_of_the_step(world, pose):
    coarse, fine = (lab.load(lab.plant(world, step_s), POSES[pose]) for step_s in (None, FINE_S))
    assert max(coarse.truth().kinetic_energy_J, fine.truth().kinetic_energy_J) < AT_REST_J
    assert lab.tool_distance_mm(coarse, fine) < CONVERGED_MM


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
@pytest.mark.parametrize("pose", ["straight", "ready"])
def test_held_by_its_motors_the_arm_rests_at_the_same_pose_with_a_tenth_of_the_step(world, pose):
    coarse, fine = (
        lab.load(lab.plant(world, step_s), POSES[pose], duration_s=4.0) for step_s in (None, FINE_S)
    )
    for plant in (coarse, fine):
        lab.hold_by_motors(plant)
        lab.run(plant, 6.0)
        np.testing.assert_allclose(plant.motor_rad(), POSES[pose], atol=2e-5)
    assert lab.tool_distance_mm(coarse, fine) < STOPPED_MM


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_after_a_move_the_arm_rests_at_the_same_pose_with_a_tenth_of_the_step(world):
    goal = tuple(float(a) for a in np.radians([5.0, -55.0, 115.0, 135.0, 95.0]))
    coarse, fine = (move_arm(world, step_s, goal) for step_s in (None, FINE_S))
    assert coarse.plant.motor_rad() == pytest.approx(goal, abs=0.02)
    assert lab.tool_distance_mm(coarse.plant, fine.plant) < STOPPED_MM


def move_arm(world: World, time_step_s: float | None, goal_rad: tuple[float, ...]) -> ClosedLoop:
    """Return the arm after a move from the ready pose, on its brakes again."""
    arm = arm_named("nominal")
    ready, known = arm.params.poses.ready_rad, lab.true_reference(arm)
    loop = ClosedLoop(Setup(arm, world, ready, seed=1, reference=known, time_step_s=time_step_s))
    sequence = run_sequence(loop, (MoveJoints(goal_rad),))
    evrs = [evr for record in sequence for evr in record.outputs.evrs]
    assert CommandCompleted("MoveJoints") in evrs
    for _ in range(lab.CYCLE_HZ):
        loop.cycle()
    assert loop.plant.data.eq_active[loop.plant.at.brake].all()
    return loop


@pytest.mark.parametrize("side", [1, -1])
def test_at_rest_a_gear_stands_at_half_its_backlash_and_its_wind_up(side):
    """Apply known torques to all outputs, without gravity, so that friction carries a known share.

    If the load grew, friction carries its full F of it, and the gear the rest. If the load fell by more than
    2 F, friction has changed sign, and the gear carries F more than the load.
    """
    torque = side * np.array([400.0, 400.0, 300.0, 120.0, 60.0])
    plant = lab.plant()
    plant.model.opt.gravity[:] = 0.0
    plant.place(lab.READY_RAD, 0.0)
    gears = [plant.model.joint(f"{name}_gear").dofadr[0] for name in lab.JOINT_NAMES]
    more = side * 4 * lab.OUTPUT_FRICTION_NM

    def apply(loads: lab.Array) -> None:
        plant.data.qfrc_applied[gears] = loads

    lab.run(plant, 8.0, lambda amount: apply(torque * lab.smooth_step(amount)))
    lab.run(plant, 1.0)
    from_less = lab.gear_rad(plant)
    lab.run(plant, 1.0, lambda amount: apply(torque + more * lab.smooth_step(amount)))
    lab.run(plant, 1.0, lambda amount: apply(torque + more * lab.smooth_step(1 - amount)))
    lab.run(plant, 1.0)
    from_more = lab.gear_rad(plant)

    stand = side * lab.HALF_BACKLASH_RAD + torque / lab.STIFFNESS_NM_RAD
    share = side * lab.OUTPUT_FRICTION_NM / lab.STIFFNESS_NM_RAD
    np.testing.assert_allclose(from_less, stand - share, rtol=0.002)
    np.testing.assert_allclose(from_more, stand + share, rtol=0.002)
    np.testing.assert_allclose((from_less + from_more) / 2, stand, rtol=0.02)
