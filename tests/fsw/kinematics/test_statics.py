"""The arm at rest under gravity: virtual work, energy, linearity, convergence."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.kinematics.chain import forward
from fsw.kinematics.statics import ToolForce, load_arm, push_torque, settle, settle_output
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits

EARTH_R_m_s2 = np.array([0.0, 0.0, 9.81])
TILTED_R_m_s2 = np.array([0.9, -1.2, 3.4])
ARMS = ["nominal", "calibrated:3"]


def potential_J(arm, frames, gravity):
    """Compute the potential energy of the masses under gravity."""
    energy = 0.0
    for i in range(6):
        X_RL, X_LD = frames.X_RL[i], frames.X_LD[i]
        near = X_RL.R @ arm.near_p_L_m[:, i] + X_RL.p
        far = X_RL.R @ (X_LD.R @ arm.far_p_C_m[:, i] + X_LD.p) + X_RL.p
        energy -= gravity @ (arm.near_kg[i] * near + arm.far_kg[i] * far)
    return energy


def compliances(arm):
    """Return the stiffness of each link, (6, 6) each."""
    return np.moveaxis(arm.compliance, -1, 0)


def rigid(arm):
    return replace(arm, compliance=np.zeros_like(arm.compliance))


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize(
    "gravity", [MARS_R_m_s2, EARTH_R_m_s2, TILTED_R_m_s2], ids=["mars", "earth", "tilted"]
)
def test_joint_torque_is_the_slope_of_the_potential_energy(name, gravity):
    config, h = config_of(name), 1e-5
    for q in in_limits(config, np.random.default_rng(1), 10).T:
        for arm in (rigid(config.arm), config.arm):
            at_rest = settle_output(arm, q, gravity)
            for joint in range(5):
                e = h * np.eye(5)[joint]
                up = potential_J(arm, forward(arm, q + e, at_rest.strain), gravity)
                down = potential_J(arm, forward(arm, q - e, at_rest.strain), gravity)
                assert at_rest.torque_Nm[joint] == pytest.approx(-(up - down) / (2 * h), abs=2e-6)


@pytest.mark.parametrize("name", ARMS)
def test_at_rest_the_total_energy_is_stationary_in_every_spring_coordinate(name):
    config, h = config_of(name), 1e-6
    arm = config.arm
    for q in in_limits(config, np.random.default_rng(2), 4).T:
        for gravity in (EARTH_R_m_s2, TILTED_R_m_s2):
            here = settle_output(arm, q, gravity)

            def energy(strain, q=q, gravity=gravity):
                pairs = zip(strain.T, compliances(arm), strict=True)  # rigid directions have no energy
                springs_J = sum(0.5 * s @ np.linalg.pinv(C) @ s for s, C in pairs)
                return potential_J(arm, forward(arm, q, strain), gravity) + springs_J

            for i in range(6):
                yields = np.abs(compliances(arm)[i]).sum(axis=1) > 0
                for k in np.flatnonzero(yields):
                    e = np.zeros((6, 6))
                    e[k, i] = h
                    slope = (energy(here.strain + e) - energy(here.strain - e)) / (2 * h)
                    # a newton or newton metre out of hundreds would be an error of the model
                    assert abs(slope) < 2e-3


@pytest.mark.parametrize("name", ARMS)
def test_the_equilibrium_converges_everywhere_inside_the_limits_on_mars_and_on_earth(name):
    config = config_of(name)
    q = in_limits(config, np.random.default_rng(6), 300)
    for gravity in (MARS_R_m_s2, EARTH_R_m_s2, TILTED_R_m_s2):
        here = settle(config.arm, q, np.zeros_like(q), gravity)
        assert here.converged.all()
        _, again, torque = load_arm(config.arm, here.output_rad, here.strain, gravity)
        np.testing.assert_allclose(again, here.strain, atol=1e-10)
        np.testing.assert_allclose(torque, here.torque_Nm, atol=1e-5)


def test_the_output_is_the_motor_angle_plus_backlash_plus_wind_up():
    config, rng = config_of(), np.random.default_rng(7)
    motor = in_limits(config, rng, 30)
    gap = rng.choice([-1.0, 1.0], (5, 30)) * config.half_backlash_rad[:, None]
    here = settle(config.arm, motor, gap, MARS_R_m_s2)
    wind_up = here.torque_Nm / config.arm.gear_stiffness_Nm_rad[:, None]
    np.testing.assert_allclose(here.output_rad, motor + gap + wind_up, atol=1e-10)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("force_N", [pytest.param(None, marks=pytest.mark.slow), (30.0, -20.0, 10.0)])
def test_frames_and_load_of_a_batch_are_those_of_single_poses(name, force_N):
    arm, rng = config_of(name).arm, np.random.default_rng(10)
    push = None if force_N is None else ToolForce("drill", np.array(force_N))
    q, strain = in_limits(config_of(name), rng, 200), rng.normal(0, 0.01, (6, 6, 200))
    frames, new_strain, torque = load_arm(arm, q, strain, TILTED_R_m_s2, push)
    for k in range(200):
        one, one_strain, one_torque = load_arm(arm, q[:, k], strain[..., k], TILTED_R_m_s2, push)
        for of_batch, X in ((frames.X_RL, one.X_RL), (frames.X_LD, one.X_LD), (frames.X_RF, one.X_RF)):
            np.testing.assert_allclose(of_batch.R[..., k], X.R, rtol=0, atol=2e-15)
            np.testing.assert_allclose(of_batch.p[..., k], X.p, rtol=0, atol=3e-15)
        np.testing.assert_allclose(new_strain[..., k], one_strain, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(torque[:, k], one_torque, rtol=1e-13, atol=1e-12)


def test_the_torque_of_a_push_is_what_it_adds_to_the_load():
    arm, rng = config_of("calibrated:3").arm, np.random.default_rng(12)
    push = ToolForce("apxs", np.array([40.0, 5.0, -70.0]))
    for q in in_limits(config_of(), rng, 20).T:
        strain = rng.normal(0, 0.01, (6, 6))
        frames, _, pushed_Nm = load_arm(arm, q, strain, TILTED_R_m_s2, push)
        _, _, free_Nm = load_arm(arm, q, strain, TILTED_R_m_s2)
        np.testing.assert_allclose(push_torque(arm, frames, push), pushed_Nm - free_Nm, rtol=0, atol=1e-11)


def test_a_strain_is_rotation_first_and_the_links_come_second():
    """The arm is level and straight; only the upper arm deflects, about the z axis of its frame."""
    config = config_of()
    compliance = np.zeros_like(config.arm.compliance)
    compliance[2, 2, 2] = 1e-9
    arm = replace(config.arm, compliance=compliance)
    here = settle_output(arm, np.zeros(5), MARS_R_m_s2)
    assert set(zip(*np.nonzero(here.strain), strict=True)) == {(2, 2)}
    # beyond the spring: half the upper arm's structure, the actuator of the elbow, and all that they carry
    beyond_m = 0.827 - 0.4135
    lever_kg_m = 3.4 * (0.62675 - 0.4135) + 7.8 * beyond_m
    lever_kg_m += 6.4 * (beyond_m + 0.33) + 4.24 * (beyond_m + 0.785)
    lever_kg_m += 4.92 * (beyond_m + 0.785 - 0.08) + 4.24 * (beyond_m + 0.785 - 0.144)
    lever_kg_m += 31.4 * (beyond_m + 0.785 - 0.144 + 0.02)
    assert here.strain[2, 2] == pytest.approx(1e-9 * 3.711 * lever_kg_m, rel=1e-6)
