"""Wrong frames, springs and masses move the tools as predicted; sensors with wrong readings."""

import numpy as np
import pytest

from fsw.config import configure
from fsw.dictionary.enums import Frame, Joint
from fsw.kinematics.arm import build_arm, transform6_to_pose
from fsw.kinematics.chain import forward, frame_jacobian, tool_pose
from fsw.kinematics.statics import settle
from fsw.kinematics.transforms import Pose
from fsw.messages import Sensors
from helpers.marks import slow_but
from sim.arms import nominal_params
from sim.effects import geometry, sensors, structure
from sim.effects.effect import Effect, nominal_hardware
from sim.effects.joints import ResolverBias
from sim.setting import World
from sim.tolerances import SPRING_FRAMES
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import tool_index

PARAMS = nominal_params()
ARM = build_arm(PARAMS)
TILTED = lab.tilted_world(15, -10, "earth")
"""Tilt at which every joint carries a load, so that every output rests on a flank."""
GRAVITY = TILTED.gravity_N_m_s2
TIMES = pytest.mark.parametrize("times", [0.5, 2.0])
TITANIUM_1_K = 8.6e-6
TOOL = "drill"

SHIFTS = [
    geometry.LinkLength(Frame.ARM1, "z", 2e-3),
    geometry.LinkLength(Frame.ARM3, "x", 2e-3),
    geometry.LinkLength(Frame.ARM6, "y", 2e-3),
    geometry.ToolOffset(TOOL, "x", 2e-3),
]
TURNS = [
    geometry.LinkAngle(Frame.ARM1, "y", 1e-3),
    geometry.LinkAngle(Frame.ARM4, "x", 1e-3),
    geometry.LinkAngle(Frame.ARM5, "z", 1e-3),
    geometry.ToolTurn(TOOL, "y", 1e-3),
]
SPRINGS = [
    structure.LinkTorsion(Frame.ARM3, 5e-6),
    structure.LinkTorsion(Frame.ARM4, 5e-6),
    structure.LinkBending(Frame.ARM2, "y", 5e-6),
    structure.LinkBending(Frame.ARM3, "z", 5e-6),
    structure.LinkBending(Frame.ARM4, "y", 5e-6),
    structure.LinkBending(Frame.ARM5, "z", 5e-6),
    structure.RoverCompliance("x", 5e-6),
    structure.RoverCompliance("y", 5e-6),
]
MASSES = [structure.TurretMass(2.0), structure.TurretCentre("x", 0.02), structure.TurretCentre("z", -0.02)]


def rigid_shift_m(*effects: Effect) -> lab.Array:
    """Return the shift of the drill of the undeflected plant by these effects."""
    places = [
        bench.set_angles(bench.build_arm(*e)[0], lab.LEFT_RAD).truth().p_RoTo_R_m[tool_index(TOOL)]
        for e in ((), effects)
    ]
    return places[1] - places[0]


def jacobian() -> lab.Array:
    """Return the undeflected Jacobian of the drill for screws of the frames, (6, 6, 7)."""
    frames = forward(ARM, lab.LEFT_RAD)
    return frame_jacobian(frames, tool_pose(ARM, frames, TOOL))


@pytest.mark.parametrize("effect", [*SHIFTS, *TURNS], ids=str)
def test_a_link_or_tool_of_another_length_or_angle_moves_the_tool_by_its_jacobian(effect):
    if effect in SHIFTS:
        size, first = getattr(effect, "length_m", None) or effect.offset_m, 3
        bound_m = 1e-12
    else:
        size, first = effect.angle_rad, 0
        bound_m = 2 * effect.angle_rad**2
    expected = size * jacobian()[3:, first + "xyz".index(effect.axis), getattr(effect, "frame", Frame.TOOL)]
    np.testing.assert_allclose(rigid_shift_m(effect), expected, atol=bound_m)


@pytest.mark.parametrize("axis", ["y", "z"])
@TIMES
def test_a_link_that_is_warm_on_one_side_bends_to_an_arc(axis, times):
    """Compare with two thousand short pieces, each rotated slightly against the last."""
    length, gradient_K = 0.785, 20.0 * times
    bend = TITANIUM_1_K * gradient_K * length / geometry.WIDTH_M
    turns = bend * (np.arange(2000) + 0.5) / 2000
    along, aside = length * np.cos(turns).mean(), length * np.sin(turns).mean()
    link = nominal_params().links.arm4
    X = transform6_to_pose(link.transform)
    error = geometry.ThermalGradient(Frame.ARM4, axis, gradient_K)._error(X.R.T @ X.p, link.expansion_1_K)
    screw = np.array(error.screw)
    assert screw["xyz".index(axis)] == pytest.approx(bend)
    across = 3 + (2 if axis == "y" else 1)
    assert abs(screw[across]) == pytest.approx(aside, rel=1e-3)
    assert screw[3] == pytest.approx(along - length, abs=1e-6)
    with pytest.raises(ValueError, match="arm4 lies along x; it bends about y and z"):
        geometry.ThermalGradient(Frame.ARM4, "x", 5.0)


@TIMES
def test_an_arm_that_is_warmer_reaches_farther_by_what_flight_software_makes_of_warmth(times):
    warming_K, J = 40.0 * times, jacobian()
    growth = np.column_stack([ARM.expansion_F, ARM.expansion_T[:, tool_index(TOOL)]]) * warming_K
    expected = np.einsum("ijk,jk->i", J, growth)[3:]
    np.testing.assert_allclose(rigid_shift_m(geometry.Warming(warming_K)), expected, rtol=1e-3, atol=1e-9)
    one = rigid_shift_m(geometry.LinkWarming(Frame.ARM4, warming_K))
    np.testing.assert_allclose(one, J[3:, :, 3] @ growth[:, 3], rtol=1e-3, atol=1e-9)


TOLD = [
    geometry.FrameError(Frame.ARM3, (0.0022, -0.0014, 0.0026, 0.0008, -0.0012, 0.001)),
    *SHIFTS,
    *TURNS[:3],
    *SPRINGS,
    *(structure.LinkStiffness(frame, 0.6) for frame in SPRING_FRAMES),
    *MASSES,
    *(structure.LinkMass(frame, 1.3, (0.02, -0.03, 0.04)) for frame in [*SPRING_FRAMES[1:], Frame.ARM6]),
    *(structure.StandInTurret(mass_kg) for mass_kg in (0.0, 8.0, 19.0)),
    geometry.ThermalGradient(Frame.ARM3, "z", 20.0),
]


@pytest.mark.parametrize("effect", slow_but(TOLD, *TOLD[::3]), ids=str)
def test_flight_software_that_is_told_of_an_effect_knows_where_the_arm_rests(effect):
    plant, _ = bench.build_arm(effect, world=TILTED, calm=True)
    lab.load(plant, lab.LEFT_RAD, duration_s=2.0, rest_s=2.0)
    there = plant.truth().p_RoTo_R_m[tool_index(TOOL)]

    def missed_m(params) -> float:
        arm = build_arm(params)
        expected = settle(arm, plant.motor_rad(), plant.backlash_rad(), GRAVITY)
        return float(np.linalg.norm(tool_pose(arm, expected.frames, TOOL).p - there))

    assert missed_m(effect.on_params(PARAMS)) < 1e-6
    assert missed_m(PARAMS) > 20 * missed_m(effect.on_params(PARAMS))


@pytest.mark.parametrize("joint", Joint)
def test_flight_software_that_is_told_of_a_lost_count_knows_where_the_tools_are(joint):
    effect = sensors.EncoderZero(joint, 3e-3)
    believed = lab.LEFT_RAD + 3e-3 * (np.arange(5) == joint)
    true, arm = forward(ARM, lab.LEFT_RAD), build_arm(effect.on_params(PARAMS))
    poses: list[Pose] = [tool_pose(ARM, true, TOOL), tool_pose(arm, forward(arm, believed), TOOL)]
    np.testing.assert_allclose(poses[1].p, poses[0].p, atol=1e-12)
    np.testing.assert_allclose(poses[1].R, poses[0].R, atol=1e-12)


def test_a_link_creeps_under_its_load_as_far_as_a_softer_link_bends_and_no_farther():
    places = []
    for effect in (
        None,
        structure.LinkCreep(Frame.ARM3, "y", 2e-5, 2.0),
        structure.LinkBending(Frame.ARM3, "y", 2e-5),
    ):
        plant, hardware = bench.build_arm(*([effect] if effect else []), world=TILTED)
        plant.place(lab.READY_RAD, 4.0)
        seen = []
        for cycle in range(8 * lab.CYCLE_HZ):
            hardware = bench.apply_cycle_effects(plant, hardware)
            if cycle in (0, 2 * lab.CYCLE_HZ):
                seen.append(plant.truth().p_RoTo_R_m[tool_index(TOOL)])
            plant.step()
        places.append([*seen, plant.truth().p_RoTo_R_m[tool_index(TOOL)]])
    nominal, creeping, soft = np.array(places)
    way = np.linalg.norm(soft[-1] - nominal[-1])
    moved = np.linalg.norm(creeping - nominal, axis=1) / way
    assert way > 1e-4
    np.testing.assert_allclose(moved, [0.0, 1.0 - np.exp(-1.0), 1.0], atol=0.05)


RESOLVER_LSB_RAD = nominal_hardware().resolver_step_rad
JOINTS = pytest.mark.parametrize("joint", [Joint.AZIMUTH, Joint.WRIST])
FACTORS = pytest.mark.parametrize("times", [0.5, 1.0, 2.0])


def read(
    *effects: Effect, motor_rad: lab.Array = lab.LEFT_RAD, current_A: float | lab.Array = 0.0
) -> Sensors:
    """Read the sensors at these motor angles, undeflected, without noise, at these motor currents."""
    plant, hardware = bench.build_arm(*effects)
    bench.set_angles(plant, motor_rad)
    plant.data.actuator_force[:] = current_A * bench.TORQUE_CONSTANT_NM_A
    return bench.avionics(plant, hardware).sense()


@FACTORS
@JOINTS
def test_a_resolver_off_its_axis_differs_from_its_encoder_by_a_wave_once_a_turn(joint, times):
    effect = sensors.ResolverEccentricity(joint, 1e-3 * times, -2e-3 * times)
    angles = np.linspace(-0.3, 5.5, 9) if joint is not Joint.AZIMUTH else np.linspace(-3.0, 1.5, 9)
    for angle in angles:
        pose = np.where(np.arange(5) == joint, angle, lab.LEFT_RAD)
        plant, hardware = bench.build_arm(effect)
        sensed = bench.avionics(bench.set_angles(plant, pose), hardware).sense()
        encoder = sensed.encoder_count * hardware.rad_per_count + hardware.counter_zero_rad
        apart = sensed.resolver_rad - encoder
        expected = times * (1e-3 * np.cos(angle) - 2e-3 * np.sin(angle))
        np.testing.assert_allclose(
            apart, np.where(np.arange(5) == joint, expected, 0.0), atol=0.6 * RESOLVER_LSB_RAD
        )


@JOINTS
def test_gain_and_bias_of_a_current_sensor_and_biases_of_a_resolver_are_in_its_readings(joint):
    here = np.arange(5) == joint
    gain = read(sensors.CurrentGain(joint, 1.3), current_A=1.5)
    bias = read(sensors.CurrentBias(joint, -0.2), current_A=1.5)
    np.testing.assert_allclose(gain.current_A, 1.5 * np.where(here, 1.3, 1.0))
    np.testing.assert_allclose(bias.current_A - 1.5, -0.2 * here, atol=1e-12)
    more = read(ResolverBias(joint, 2e-3), ResolverBias(joint, 1e-3)).resolver_rad - read().resolver_rad
    np.testing.assert_allclose(more, 3e-3 * here, atol=RESOLVER_LSB_RAD)
    # a lost count is not there yet when joints look for their hardstops
    assert ResolverBias.built_in
    assert not sensors.EncoderZero.built_in


def test_a_current_sensor_with_crosstalk_reads_a_share_of_the_current_of_the_joint_before():
    currents_A = np.array([1.0, 2.0, -3.0, 4.0, 5.0])
    more = read(sensors.CurrentCrosstalk(Joint.WRIST, 0.1), current_A=currents_A).current_A - currents_A
    np.testing.assert_allclose(more, [0.0, 0.0, 0.0, -0.3, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="azimuth has no joint between itself and the rover"):
        sensors.CurrentCrosstalk(Joint.AZIMUTH, 0.1)


@FACTORS
@JOINTS
def test_scales_of_resolver_and_encoder_make_them_read_in_proportion_to_the_angle(joint, times):
    error = 3e-3 * times
    more = read(sensors.ResolverScale(joint, error)).resolver_rad - read().resolver_rad
    expected = error * np.where(np.arange(5) == joint, lab.LEFT_RAD, 0.0)
    np.testing.assert_allclose(more, expected, atol=RESOLVER_LSB_RAD)
    counts = read(sensors.EncoderScale(joint, error)).encoder_count - read().encoder_count
    from_zero = lab.LEFT_RAD - nominal_hardware().counter_zero_rad
    expected = expected * from_zero / lab.LEFT_RAD / nominal_hardware().rad_per_count
    np.testing.assert_allclose(counts, expected, atol=1.0)


def test_flight_software_that_knows_the_scale_of_an_encoder_has_the_right_angle():
    effect = sensors.EncoderScale(Joint.ELBOW, 2e-3)
    known = configure(effect.on_params(nominal_params())).rad_per_count
    np.testing.assert_allclose(known, effect.on_hardware(nominal_hardware()).rad_per_count, rtol=1e-12)


@FACTORS
@JOINTS
def test_an_encoder_that_lost_count_reads_too_much_and_its_motor_goes_less_far(joint, times):
    offset = 3e-3 * times
    plant, hardware = bench.build_arm(sensors.EncoderZero(joint, offset))
    drawn, lost = (
        bench.avionics(*found)
        for found in (bench.build_arm(), (bench.set_angles(plant, lab.LEFT_RAD), hardware))
    )
    bench.set_angles(drawn._plant, lab.LEFT_RAD)
    counts = lost.encoder_count() - drawn.encoder_count()
    expected = offset / hardware.rad_per_count * (np.arange(5) == joint)
    np.testing.assert_allclose(counts, expected, atol=1.0)


@pytest.mark.parametrize(("axis", "sign"), [("x", -1.0), ("y", 1.0)])
@FACTORS
def test_an_imu_mounted_askew_sees_gravity_turned(axis, sign, times):
    """Down is z: a rotation about x tilts it to -y, one about y to +x."""
    angle = 5e-3 * times
    g = read(sensors.GravityDirection(axis, angle)).gravity_R_m_s2
    size = np.linalg.norm(World().gravity_N_m_s2)
    leaning = 1 if axis == "x" else 0
    expected = np.zeros(3)
    expected[2], expected[leaning] = size * np.cos(angle), sign * size * np.sin(angle)
    np.testing.assert_allclose(g, expected, atol=1e-12)
