"""Effects, also of moves and of heat, change the plant as they claim; flight software can be told of them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fsw.config import configure, configure_at
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.evrs import CommandCompleted
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5
from fsw.kinematics.arm import Arm, build_arm
from fsw.kinematics.chain import forward, frame_jacobian, tool_pose
from fsw.kinematics.statics import settle
from marsarm.accuracy.trial import configure_true
from sim.arms import arm_named, nominal_params
from sim.effects import joints
from sim.effects.effect import Effect, nominal_hardware, params_with_effects
from sim.effects.environment import COLD_C, COULOMB_COLD, VISCOUS_COLD, Ambient, CurrentNoise, NothingToTouch
from sim.effects.geometry import Expansion, FrameError, FramePlay
from sim.effects.sensors import StructureSensor
from sim.effects.structure import LinkMass, LinkStiffness
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementRun
from sim.plant import Plant
from sim.record import LINK_BODIES, frame_body, no_move_disturbance
from sim.setting import WARM_C, Surface, World
from sim.tolerances import list_frames
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import TOOLS, tool_index

PARAMS = nominal_params()
ARM = build_arm(PARAMS)
SCREW = (0.011, -0.007, 0.013, 0.004, -0.006, 0.005)
FRAMES = [(frame, None) for frame in Frame if frame is not Frame.TOOL] + [
    (Frame.TOOL, tool) for tool in TOOLS
]

TILTED_EARTH = lab.tilted_world(15, -10, "earth")


def build(*effects: Effect, world: World | None = None) -> Plant:
    def edit(spec: mujoco.MjSpec) -> None:
        lab.settle_fast(spec)
        for effect in effects:
            effect.on_model(spec)

    return lab.plant(world, edit=edit)


def params_with(*effects: Effect) -> Params:
    return params_with_effects(effects, PARAMS)


def rigid_difference_m(plant: Plant, arm: Arm, motor_error_rad: lab.Array | None = None) -> float:
    """Return the largest distance of plant and flight kinematics at points of the unit axes of a tool."""
    error = np.zeros(5) if motor_error_rad is None else motor_error_rad
    worst = 0.0
    for seed in range(4):
        encoder_rad = np.random.default_rng([13, seed]).uniform(ARM.soft_min_rad, ARM.soft_max_rad)
        truth, frames = bench.set_angles(plant, encoder_rad - error).truth(), forward(arm, encoder_rad)
        for tool in TOOLS:
            X_RT = tool_pose(arm, frames, tool)
            p, R = truth.p_RoTo_R_m[tool_index(tool)], truth.R_RT[tool_index(tool)]
            worst = max(worst, np.abs(p - X_RT.p).max(), np.abs(R - X_RT.R).max())
    return worst


@pytest.mark.parametrize(("frame", "tool"), FRAMES)
def test_a_frame_error_displaces_its_frame_by_its_screw_and_is_known_exactly(frame, tool):
    effect = FrameError(frame, SCREW, tool)
    plant = build(effect)
    assert rigid_difference_m(plant, ARM) > 1e-3
    assert rigid_difference_m(plant, build_arm(params_with(effect))) < 1e-12


def drawn_stops(params: Params) -> lab.Array:
    return np.array([joint.hardstop_rad for joint in params.joints.in_order()])


@pytest.mark.parametrize("joint", Joint)
def test_a_hardstop_off_its_place_is_an_error_of_the_zero_until_flight_software_knows_it(joint):
    """Homing sets the zero so that the output meets its assumed hardstop: the error shows in the tool."""
    effect = joints.HardstopAngle(joint, 0.02)
    plant = build(effect)
    shift = plant.stop_rad() - drawn_stops(PARAMS)
    np.testing.assert_allclose(shift, 0.02 * (np.arange(5) == joint), atol=1e-12)
    assert rigid_difference_m(plant, ARM, -shift) > 1e-3
    left = drawn_stops(params_with(effect)) - plant.stop_rad()
    np.testing.assert_allclose(left, 0.0, atol=1e-12)
    assert rigid_difference_m(plant, build_arm(params_with(effect)), left) < 1e-12


@pytest.mark.parametrize("joint", Joint)
def test_a_hardstop_of_other_stiffness_presses_back_as_flight_software_then_says(joint):
    effect = joints.HardstopStiffness(joint, 0.6)
    plant = build(effect)
    bench.set_angles(plant, plant.stop_rad() - 1e-3)
    believed = np.array([one.hardstop_stiffness_Nm_rad for one in params_with(effect).joints.in_order()])
    np.testing.assert_allclose(plant.stop_torque_Nm(), 1e-3 * believed, rtol=1e-9)
    drawn = np.array([one.hardstop_stiffness_Nm_rad for one in PARAMS.joints.in_order()])
    np.testing.assert_allclose(believed / drawn, np.where(np.arange(5) == joint, 0.6, 1.0))


@pytest.mark.parametrize("joint", [Joint.ELEVATION, Joint.ELBOW, Joint.WRIST])
@pytest.mark.parametrize("kind", [joints.BacklashWidth, joints.GearStiffness])
def test_a_gear_of_other_backlash_or_stiffness_lets_the_tool_sag_as_flight_software_then_says(joint, kind):
    effect = kind(joint, 0.6)
    plant = build(effect, world=TILTED_EARTH)
    arm = build_arm(params_with(effect))
    lab.load(plant, lab.LEFT_RAD, duration_s=2.0, rest_s=2.0)
    believed = getattr(params_with(effect).joints, joint.name.lower())
    half_backlash_rad = believed.backlash_rad / 2
    assert abs(plant.backlash_rad()[joint]) == pytest.approx(half_backlash_rad, rel=1e-9)
    expected = settle(arm, plant.motor_rad(), plant.backlash_rad(), TILTED_EARTH.gravity_N_m_s2)
    wind_up = lab.gear_rad(plant)[joint] - plant.backlash_rad()[joint]
    assert wind_up == pytest.approx(expected.torque_Nm[joint] / believed.gear_stiffness_Nm_rad, rel=1e-3)
    untouched = np.delete(plant.backlash_rad(), joint)
    assert np.all(np.abs(untouched) <= np.delete(lab.HALF_BACKLASH_RAD, joint))


@pytest.mark.parametrize("joint", Joint)
def test_gear_friction_is_on_the_motor_and_flight_software_has_no_word_for_it(joint):
    effect = joints.GearFriction(joint, 1.5)
    for one, drawn in zip(motor_friction(build(effect)), motor_friction(build()), strict=True):
        np.testing.assert_allclose(one / drawn, np.where(np.arange(5) == joint, 1.5, 1.0))
    assert params_with(effect) == PARAMS


def test_effects_add_up_in_any_order_of_different_places():
    effects = (FrameError(Frame.ARM3, SCREW), LinkStiffness(Frame.ARM3, 0.8), LinkMass(Frame.ARM3, 1.1))
    one, other = params_with(*effects), params_with(*effects[::-1])
    assert build_arm(one).theta_rad.tolist() == build_arm(other).theta_rad.tolist()
    np.testing.assert_allclose(build_arm(one).compliance, build_arm(other).compliance)
    np.testing.assert_allclose(build_arm(one).far_kg, build_arm(other).far_kg)


def motor_friction(plant: Plant) -> tuple[lab.Array, lab.Array]:
    return plant.model.dof_frictionloss[plant.at.motor], plant.model.dof_damping[plant.at.motor]


@pytest.mark.parametrize(
    ("temperature_C", "share"),
    [(WARM_C, 0.0), (COLD_C, 1.0), (0.5 * (WARM_C + COLD_C), 0.5), (40.0, -20 / 75)],
)
def test_in_the_cold_every_motor_has_more_friction_and_is_as_cold_as_it_is(temperature_C, share):
    effect = Ambient(temperature_C)
    for one, warm, cold in zip(
        motor_friction(build(effect)), motor_friction(build()), (COULOMB_COLD, VISCOUS_COLD), strict=True
    ):
        np.testing.assert_allclose(one / warm, cold**share)
    assert (effect.on_hardware(nominal_hardware()).ambient_C == temperature_C).all()
    assert CurrentNoise(0.07).on_hardware(nominal_hardware()).current_noise_A == 0.07
    assert params_with(effect) == params_with(CurrentNoise(0.07)) == PARAMS


def test_an_arm_with_nothing_to_touch_goes_through_the_rover():
    for effects, touches in (((), True), ((NothingToTouch(),), False)):
        plant = bench.set_angles(build(*effects), np.radians([-170.0, 0.0, 0.0, 0.0, 0.0]))
        assert (plant.data.ncon > 0) is touches


NOMINAL = arm_named("nominal")
PLAY = (1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4)
BODIES = (*LINK_BODIES, *(frame_body(Frame.TOOL, tool) for tool in TOOLS))
BY_CHANCE = (
    FramePlay(Frame.ARM3, PLAY),
    FramePlay(Frame.TOOL, PLAY, "drill"),
    joints.Windup(Joint.ELBOW, 2e-4),
    joints.ServoError(Joint.WRIST, 6e-5),
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


def begin_move(loop, pose_rad):
    """From a command until the brakes let go."""
    record = loop.cycle((MoveJoints(joints5(pose_rad)),))
    while not record.outputs.drive.brake_release.any():
        record = loop.cycle()


def test_every_move_draws_anew_from_its_seed_and_stays_with_it_and_flight_software_does_not_see_it():
    loop, other = start_loop(), start_loop(seed=1)
    for one in (loop, other):
        begin_move(one, lab.READY_RAD + 0.01)
    first = drawn(loop)
    assert not np.any((drawn(other) == first) & (first != 0))
    assert not [evr for evr in lab.run_to_rest(loop) if evr.severity.name.startswith(("WARNING", "FATAL"))]
    assert np.array_equal(drawn(loop), first)
    off_rad = (loop.plant.motor_rad() - loop.state.joints.motor_rad)[Joint.WRIST]
    assert off_rad == pytest.approx(loop.plant.move_disturbance.motor_rad[Joint.WRIST], abs=1e-5)
    fork = loop.fork()
    for one in (loop, fork):
        begin_move(one, lab.READY_RAD + 0.02)
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


CONFIG = configure(NOMINAL.params)
HALF = tuple(Expansion(frame, 0.5, tool) for frame, tool in list_frames(NOMINAL.params.tool_names))
POSES = 40
"""Poses of each of the five tools."""


def growth_errors_m(warming_K: float, compensated_share: float, *effects: Effect) -> np.ndarray:
    """Compare the tools of MuJoCo with those of flight software at equal joint angles, undeflected."""
    warm_C = CONFIG.params.heat.calibration_C + warming_K
    plant, hardware = bench.build_arm(*effects, Ambient(warm_C))
    heat = replace(CONFIG.params.heat, compensated_share=compensated_share)
    believed = configure_at(
        configure(replace(NOMINAL.params, heat=heat)), hardware.structure_C + hardware.structure_offset_K
    )
    rng, found = np.random.default_rng(7), []
    for _ in range(POSES):
        pose_rad = rng.uniform(CONFIG.arm.soft_min_rad, CONFIG.arm.soft_max_rad)
        true_m = bench.set_angles(plant, pose_rad).truth().p_RoTo_R_m
        frames = forward(believed.arm, pose_rad)
        believed_m = np.array([tool_pose(believed.arm, frames, tool).p for tool in plant.tools])
        found.append(np.linalg.norm(true_m - believed_m, axis=1))
    return np.concatenate(found)


@pytest.mark.parametrize("warming_K", [-75.0, 30.0])
def test_flight_software_compensates_the_growth_of_the_arm(warming_K):
    left_m, off_m = growth_errors_m(warming_K, 1.0), growth_errors_m(warming_K, 0.0)
    assert left_m.size == 200
    assert left_m.max() < 0.02e-3
    assert np.median(off_m) > 0.02e-3 * abs(warming_K)


def test_a_sensor_that_reads_a_kelvin_too_much_costs_what_the_arm_grows_in_a_kelvin():
    offset_m = growth_errors_m(0.0, 1.0, StructureSensor(1.0))
    np.testing.assert_allclose(offset_m, growth_errors_m(1.0, 0.0), rtol=1e-3)


def test_what_statics_know_of_an_arm_has_its_temperature_and_coefficients():
    warmed = configure_at(CONFIG, CONFIG.params.heat.calibration_C + 0.5 * 30.0).arm
    true = configure_true(replace(NOMINAL, effects=(*HALF, Ambient(50.0)))).arm
    pose_rad = np.array(NOMINAL.params.poses.ready_rad)
    for tool in NOMINAL.params.tool_names:
        one, other = (tool_pose(arm, forward(arm, pose_rad), tool) for arm in (true, warmed))
        np.testing.assert_allclose(one.p, other.p, atol=1e-6)
