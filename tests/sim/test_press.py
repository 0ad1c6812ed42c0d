"""Preloads in the plant: the force is the commanded one, and the tool does not slip."""

from functools import cache

import numpy as np
import pytest

from fsw.dictionary.commands import PlaceTool, Preload, Retract
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import FaultResponse, Preloaded
from fsw.dictionary.faults import ContactLost, PreloadOutside
from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import ToolForce, settle_output
from helpers.marks import slow_but
from sim.arms import arm_named
from sim.clearance import tool_forces
from sim.effects.faults import RockGone, SensorFault
from sim.frames import FLIP, p_R_from_N
from sim.loop import ClosedLoop, Setup
from sim.params import nominal_params
from sim.sequence import run_sequence
from sim.setting import Surface, World
from tests.sim.lab import load, plant, run, run_to_rest, settle_fast, tilted_world, true_reference
from tests.tools import tool_index

POINT_N_M = (2.05, 0.1, -0.25)
NORMAL = np.array((-0.5, 0.1, -0.85)) / np.linalg.norm((-0.5, 0.1, -0.85))
PRESSED_N = 20.0
"""Force below which a tool only touches."""
PLACE = PlaceTool("drill", tuple(p_R_from_N(np.array(POINT_N_M)).tolist()), tuple((-NORMAL).tolist()))


@pytest.mark.parametrize("push", slow_but(range(3), 2))
def test_a_push_on_a_tool_moves_it_as_it_does_in_the_plant(push):
    force_R_N = [(0.0, 0.0, -200.0), (120.0, -80.0, 0.0), (-50.0, 60.0, 90.0)][push]
    arm, pose = build_arm(nominal_params()), np.radians([-20.0, -65.0, 100.0, 30.0, 80.0])
    world = tilted_world(5.0, -8.0)
    free = load(plant(world, edit=settle_fast), pose)
    before = free.truth()
    body = free.model.body("drill").id
    force_W = FLIP * np.array(force_R_N)

    def pushed(share: float) -> None:
        at = free.data.site_xpos[free.at.tools[tool_index("drill")]] - free.data.xipos[body]
        free.data.xfrc_applied[body] = share * np.concatenate([force_W, np.cross(at, force_W)])

    run(free, 6.0, pushed)
    run(free, 6.0, lambda _: pushed(1.0))
    after = free.truth()
    push = ToolForce("drill", np.array(force_R_N))
    ours = [
        tool_pose(arm, settle_output(arm, truth.output_rad, world.gravity_N_m_s2, p).frames, "drill").p
        for truth, p in ((before, None), (after, push))
    ]
    moved = after.p_RoTo_R_m[tool_index("drill")] - before.p_RoTo_R_m[tool_index("drill")]
    assert np.linalg.norm(moved) > 5e-3
    assert np.linalg.norm(ours[1] - after.p_RoTo_R_m[tool_index("drill")]) < 2e-5 + np.linalg.norm(
        ours[0] - before.p_RoTo_R_m[tool_index("drill")]
    )


@cache
def half_pressed() -> ClosedLoop:
    """Return a run with the drill on its rock at half of its preload; tests fork it and never run it."""
    loop = on_the_rock()
    for _ in run_sequence(loop, (PLACE, Preload("drill", 300.0))):
        if loop.state.preload is not None and loop.state.preload.force_N > 150.0:
            return loop
    raise AssertionError("the press did not come so far")


def on_the_rock() -> ClosedLoop:
    arm = arm_named("nominal")
    world = World(surface=Surface(POINT_N_M, tuple(NORMAL)))
    return ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, 0, true_reference(arm)))


@pytest.mark.slow
def test_a_rock_that_gives_way_ends_a_press_without_refusing_what_comes_then():
    loop = half_pressed()
    loop = loop.fork((RockGone(loop.plant.data.time),))
    evrs = run_to_rest(loop)
    assert ContactLost("drill") in evrs
    assert FaultResponse("STOP_AND_BRAKE") in evrs
    assert loop.state.mode is Mode.PRELOAD
    assert not loop.state.drive.power_on.any()


@pytest.mark.slow
def test_a_force_that_the_resolvers_do_not_believe_in_is_a_fault():
    loop = half_pressed()
    biased = SensorFault(loop.plant.data.time, "resolver_rad", "biased", Joint.ELBOW, -0.004)
    evrs = run_to_rest(loop.fork((biased,)))
    assert any(isinstance(evr, PreloadOutside) for evr in evrs)
    assert FaultResponse("BRAKE_AND_REFUSE") in evrs


def press_and_release() -> tuple[ClosedLoop, np.ndarray, np.ndarray, list[float]]:
    """Press with 300 N and release: forces (n, 3), places (n, 3), normal force at each `Preloaded`."""
    loop = on_the_rock()
    commands = (PLACE, Preload("drill", 300.0), Preload("drill", 0.0), Retract("drill", 0.1))
    forces, places, pressed = [], [], []
    for record in run_sequence(loop, commands):
        assert not any(isinstance(evr, FaultResponse) for evr in record.outputs.evrs)
        if loop.state.preload is not None:
            forces.append(tool_forces(loop.plant)[tool_index("drill")])
            places.append(loop.plant.truth().p_RoTo_R_m[tool_index("drill")])
            if any(isinstance(evr, Preloaded) for evr in record.outputs.evrs):
                pressed.append(float(forces[-1] @ NORMAL))
    return loop, np.array(forces), np.array(places), pressed


@pytest.mark.slow
def test_the_drill_presses_with_the_force_to_one_percent_and_neither_slips_nor_leans():
    (loop, forces, places, pressed), axis = press_and_release(), -NORMAL
    normal = forces @ -axis
    lateral = np.linalg.norm(forces - np.outer(normal, -axis), axis=1)
    moved = places - places[0]
    slip = np.linalg.norm(moved - np.outer(moved @ axis, axis), axis=1)
    assert loop.state.mode is Mode.DEPLOYED
    assert pressed == [pytest.approx(300.0, rel=0.01), pytest.approx(0.0, abs=1.0)]
    assert normal.max() < 1.05 * 300.0
    assert np.max(lateral[normal > PRESSED_N] / normal[normal > PRESSED_N]) < 0.35
    assert slip.max() < 1e-3
