"""Effects change the plant as they claim, and on_params makes flight software know them exactly."""

import mujoco
import numpy as np
import pytest

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.kinematics.arm import Arm, build_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle
from sim.arms import nominal_params
from sim.effects.effect import Effect, nominal_hardware, params_with_effects
from sim.effects.environment import COLD_C, COULOMB_COLD, VISCOUS_COLD, Ambient, CurrentNoise, NothingToTouch
from sim.effects.geometry import FrameError
from sim.effects.joints import BacklashWidth, GearFriction, GearStiffness, HardstopAngle, HardstopStiffness
from sim.effects.structure import LinkMass, LinkStiffness
from sim.plant import Plant
from sim.setting import WARM_C, World
from tests.sim import lab
from tests.tools import TOOLS, tool_index

PARAMS = nominal_params()
NOMINAL = build_arm(PARAMS)
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
        encoder_rad = np.random.default_rng([13, seed]).uniform(NOMINAL.soft_min_rad, NOMINAL.soft_max_rad)
        mujoco.mj_resetData(plant.model, plant.data)
        plant.data.qpos[plant.at.motor] = encoder_rad - error
        truth, frames = plant.truth(), forward(arm, encoder_rad)
        for tool in TOOLS:
            X_RT = tool_pose(arm, frames, tool)
            worst = max(
                worst,
                np.abs(truth.p_RoTo_R_m[tool_index(tool)] - X_RT.p).max(),
                np.abs(truth.R_RT[tool_index(tool)] - X_RT.R).max(),
            )
    return worst


@pytest.mark.parametrize(("frame", "tool"), FRAMES)
def test_a_frame_error_displaces_its_frame_by_its_screw_and_is_known_exactly(frame, tool):
    effect = FrameError(frame, SCREW, tool)
    plant = build(effect)
    assert rigid_difference_m(plant, NOMINAL) > 1e-3
    assert rigid_difference_m(plant, build_arm(params_with(effect))) < 1e-12


def drawn_stops(params: Params) -> lab.Array:
    return np.array([joint.hardstop_rad for joint in params.joints.in_order()])


@pytest.mark.parametrize("joint", Joint)
def test_a_hardstop_off_its_place_is_an_error_of_the_zero_until_flight_software_knows_it(joint):
    """Homing sets the zero so that the output meets its assumed hardstop: the error shows in the tool."""
    effect = HardstopAngle(joint, 0.02)
    plant = build(effect)
    shift = plant.stop_rad() - drawn_stops(PARAMS)
    np.testing.assert_allclose(shift, 0.02 * (np.arange(5) == joint), atol=1e-12)
    assert rigid_difference_m(plant, NOMINAL, -shift) > 1e-3
    left = drawn_stops(params_with(effect)) - plant.stop_rad()
    np.testing.assert_allclose(left, 0.0, atol=1e-12)
    assert rigid_difference_m(plant, build_arm(params_with(effect)), left) < 1e-12


@pytest.mark.parametrize("joint", Joint)
def test_a_hardstop_of_other_stiffness_presses_back_as_flight_software_then_says(joint):
    effect = HardstopStiffness(joint, 0.6)
    plant = build(effect)
    mujoco.mj_resetData(plant.model, plant.data)
    plant.data.qpos[plant.at.motor] = plant.stop_rad() - 1e-3
    believed = np.array([one.hardstop_stiffness_Nm_rad for one in params_with(effect).joints.in_order()])
    np.testing.assert_allclose(plant.stop_torque_Nm(), 1e-3 * believed, rtol=1e-9)
    drawn = np.array([one.hardstop_stiffness_Nm_rad for one in PARAMS.joints.in_order()])
    np.testing.assert_allclose(believed / drawn, np.where(np.arange(5) == joint, 0.6, 1.0))


@pytest.mark.parametrize("joint", [Joint.ELEVATION, Joint.ELBOW, Joint.WRIST])
@pytest.mark.parametrize("kind", [BacklashWidth, GearStiffness])
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
    effect = GearFriction(joint, 1.5)
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
    dofs = [plant.model.joint(f"{name}_motor").dofadr[0] for name in lab.JOINT_NAMES]
    return plant.model.dof_frictionloss[dofs], plant.model.dof_damping[dofs]


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
        plant = build(*effects)
        mujoco.mj_resetData(plant.model, plant.data)
        plant.data.qpos[plant.at.motor] = np.radians([-170.0, 0.0, 0.0, 0.0, 0.0])
        mujoco.mj_forward(plant.model, plant.data)
        assert (plant.data.ncon > 0) is touches
