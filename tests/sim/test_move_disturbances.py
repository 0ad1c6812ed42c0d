"""Move disturbances are drawn when a move begins, from the seed of the run and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.types import joints5
from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import forward, frame_jacobian, tool_pose
from sim.arms import arm_named
from sim.effects.geometry import FramePlay
from sim.effects.joints import ServoError, Windup
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementRun
from sim.record import LINK_BODIES, frame_body, no_move_disturbance
from sim.setting import Surface, World
from tests.sim import lab
from tests.tools import TOOLS, tool_index

NOMINAL = arm_named("nominal")
PLAY = (1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4)
BODIES = (*LINK_BODIES, *(frame_body(Frame.TOOL, tool) for tool in TOOLS))
BY_CHANCE = (
    FramePlay(Frame.ARM3, PLAY),
    FramePlay(Frame.TOOL, PLAY, "drill"),
    Windup(Joint.ELBOW, 2e-4),
    ServoError(Joint.WRIST, 6e-5),
)


def start_loop(seed: int = 0, effects: tuple = BY_CHANCE) -> ClosedLoop:
    setup = Setup(NOMINAL, World(), joints5(lab.READY_RAD), seed, true_reference(NOMINAL), effects)
    return ClosedLoop(setup)


def drawn(loop: ClosedLoop) -> np.ndarray:
    scatter = loop.plant.move_disturbance
    screws = [scatter.screw(body) for body in BODIES]
    return np.concatenate([*screws, scatter.gear_rad, scatter.motor_rad])


def test_before_the_first_move_everything_stands_as_it_was_built_and_sensors_have_the_same_noise():
    loop = start_loop()
    assert not drawn(loop).any()
    resolvers = [one.cycle().sensors.resolver_rad for one in (loop, start_loop(effects=()))]
    assert np.array_equal(*resolvers)


def test_every_move_draws_anew_from_its_seed_and_stays_with_it_and_flight_software_does_not_see_it():
    loop, other = start_loop(), start_loop(seed=1)
    for one in (loop, other):
        one.cycle((MoveJoints(joints5(lab.READY_RAD + 0.01)),))
    first = drawn(loop)
    assert not np.any((drawn(other) == first) & (first != 0))
    assert not [evr for evr in lab.run_to_rest(loop) if evr.severity.name.startswith(("WARNING", "FATAL"))]
    assert np.array_equal(drawn(loop), first)
    off_rad = (loop.plant.motor_rad() - loop.state.joints.motor_rad)[Joint.WRIST]
    assert off_rad == pytest.approx(loop.plant.move_disturbance.motor_rad[Joint.WRIST], abs=1e-5)
    fork = loop.fork()
    for one in (loop, fork):
        one.cycle((MoveJoints(joints5(lab.READY_RAD + 0.02)),))
    assert np.array_equal(drawn(loop), drawn(fork))
    assert np.count_nonzero(first) == 14
    assert not np.any((drawn(loop) == first) & (first != 0))


@pytest.mark.slow
def test_what_presses_on_something_stays_where_it_is():
    point, normal = (2.1, 0.2, -0.3), (-0.3, 0.0, -1.0)
    world = World(surface=Surface(point, normal))
    loop = ClosedLoop(
        Setup(NOMINAL, world, NOMINAL.params.poses.ready_rad, 1, true_reference(NOMINAL), BY_CHANCE)
    )
    at_end = {}
    for record in PlacementRun(loop, Placement("apxs", point, normal)):
        for evr in record.outputs.evrs:
            if isinstance(evr, CommandCompleted):
                at_end[evr.command] = drawn(loop)
    assert np.array_equal(at_end["GuardedMove"], at_end["Retract"])
    assert not np.array_equal(at_end["MoveTool"], at_end["GuardedMove"])


def test_a_displaced_frame_moves_what_it_carries_and_the_next_draw_begins_where_it_was_built():
    plant = lab.plant()
    plant.show(lab.READY_RAD, np.zeros((6, 6)))
    before = plant.truth().p_RoTo_R_m[tool_index("apxs")]
    screw = np.array((1e-4, -2e-4, 3e-4, 1e-4, 2e-4, -1e-4))
    scatter = replace(no_move_disturbance(), screws={frame_body(Frame.ARM4, None): screw})
    for _ in range(2):
        plant.set_move_disturbance(scatter)
    plant.show(lab.READY_RAD, np.zeros((6, 6)))
    moved = plant.truth().p_RoTo_R_m[tool_index("apxs")] - before
    arm = build_arm(NOMINAL.params)
    frames = forward(arm, lab.READY_RAD)
    J = frame_jacobian(frames, tool_pose(arm, frames, "apxs"))
    assert np.allclose(moved, (J[:, :, Frame.ARM4] @ screw)[3:], atol=3e-7)
    plant.set_move_disturbance(no_move_disturbance())
    plant.show(lab.READY_RAD, np.zeros((6, 6)))
    assert np.allclose(plant.truth().p_RoTo_R_m[tool_index("apxs")], before, atol=1e-12)


def test_a_shifted_gear_is_not_taken_for_a_gap():
    plant = lab.plant()
    plant.set_move_disturbance(replace(no_move_disturbance(), gear_rad=np.full(5, 3e-4)))
    assert np.allclose(plant.half_backlash_rad, lab.HALF_BACKLASH_RAD)
    plant.data.qpos[plant.at.gear] = lab.HALF_BACKLASH_RAD + 3e-4
    assert np.allclose(plant.backlash_rad(), lab.HALF_BACKLASH_RAD)


def test_bodies_are_those_of_the_frames():
    assert len(set(BODIES)) == 11
    assert all(lab.plant().model.body(body).name == body for body in BODIES)
    assert [frame_body(frame, None) for frame in list(Frame)[:6]] == list(LINK_BODIES)
    with pytest.raises(ValueError, match="names its tool"):
        frame_body(Frame.TOOL, None)
