"""Nominal plant and flight parameters agree: kinematics, masses, stiffness and actuators."""

import mujoco
import numpy as np
import pytest

from fsw.config import configure
from fsw.dictionary.enums import Joint
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.transforms import Pose, rotation_z
from sim.arms import nominal_params
from sim.plant import Plant
from tests.sim import lab
from tests.tools import TOOLS, tool_index

PARAMS = nominal_params()
CONFIG = configure(PARAMS)
JOINT_PARAMS = dict(zip(Joint, PARAMS.joints.in_order(), strict=True))
LINKS = PARAMS.links.in_order()
SPRINGS = ("rover", "link1", "link2", "link3", "link4")
LUMPS = (
    ("arm1",),
    ("link1", "link1_far"),
    ("link2", "link2_far"),
    ("link3", "link3_far"),
    ("link4", "link4_far"),
    ("link5", "turret"),
)


@pytest.fixture(scope="module")
def nominal() -> Plant:
    return lab.plant()


def random_poses(seed: int, count: int) -> lab.Array:
    """Draw output angles inside the soft limits, (5, count)."""
    rng, arm = np.random.default_rng(seed), CONFIG.arm
    return rng.uniform(arm.soft_min_rad, arm.soft_max_rad, (count, 5)).T


def set_pose(plant: Plant, output_rad: lab.Array) -> None:
    """Set every spring and gear to zero, and the outputs to these angles."""
    mujoco.mj_resetData(plant.model, plant.data)
    plant.data.qpos[plant.at.motor] = output_rad
    mujoco.mj_kinematics(plant.model, plant.data)


def in_rmech(plant: Plant, body: str) -> tuple[lab.Array, lab.Array]:
    """Return position and axes of a body in the rover frame."""
    rmech, of = plant.data.body("rmech"), plant.data.body(body)
    R_RW = rmech.xmat.reshape(3, 3).T
    return R_RW @ (of.xpos - rmech.xpos), R_RW @ of.xmat.reshape(3, 3)


def test_every_tool_and_frame_of_the_rigid_arm_is_where_flight_kinematics_say(nominal):
    """Body arm1 is frame Arm1, turret is Arm6; link1 to link5 are Arm1 to Arm5 turned by their joints."""
    outputs = random_poses(7, 500)
    frames = forward(CONFIG.arm, outputs)
    for k in range(outputs.shape[1]):
        set_pose(nominal, outputs[:, k])
        truth = nominal.truth()
        for tool in TOOLS:
            X_RT = tool_pose(CONFIG.arm, frames, tool)[k]
            np.testing.assert_allclose(truth.p_RoTo_R_m[tool_index(tool)], X_RT.p, rtol=0, atol=1e-10)
            np.testing.assert_allclose(truth.R_RT[tool_index(tool)], X_RT.R, rtol=0, atol=1e-10)
        expected = {"arm1": frames.X_RF[0, k], "turret": frames.X_RF[5, k]}
        for joint in Joint:
            X_RF = frames.X_RF[int(joint), k]
            expected[f"link{joint + 1}"] = Pose(X_RF.R @ rotation_z(outputs[joint, k]), X_RF.p)
        for body, X in expected.items():
            p_R_m, R = in_rmech(nominal, body)
            np.testing.assert_allclose(p_R_m, X.p, rtol=0, atol=1e-10)
            np.testing.assert_allclose(R, X.R, rtol=0, atol=1e-10)


@pytest.mark.parametrize("link", range(6))
def test_each_link_has_the_mass_and_the_centre_that_flight_software_believes(nominal, link):
    """Compare in the rover frame at the zero pose, where flight kinematics give each link frame."""
    set_pose(nominal, np.zeros(5))
    X_RL = forward(CONFIG.arm, np.zeros(5)).X_RL[link]
    rmech = nominal.data.body("rmech")
    lumps = (LINKS[link].near, LINKS[link].far)
    for body, lump in zip(LUMPS[link][::-1], lumps[::-1], strict=False):
        assert nominal.model.body(body).mass[0] == pytest.approx(lump.mass_kg, abs=1e-12)
        p_R_m = rmech.xmat.reshape(3, 3).T @ (nominal.data.body(body).xipos - rmech.xpos)
        np.testing.assert_allclose(p_R_m, X_RL.R @ lump.com_m + X_RL.p, rtol=0, atol=1e-12)
    assert sum(link.near.mass_kg + link.far.mass_kg for link in LINKS) == pytest.approx(65 + 30, abs=1e-12)
    assert nominal.model.body_mass.sum() == pytest.approx(65 + 30, abs=1e-12)


@pytest.mark.parametrize("link", range(5))
def test_each_compliance_is_one_over_the_stiffness_of_the_springs_and_the_turret_has_none(nominal, link):
    axes = ("rx", "ry", "rz", "tx", "ty", "tz")
    springs = [nominal.model.joint(f"{SPRINGS[link]}_{axis}") for axis in axes]
    stiffness = np.diag([float(np.ravel(spring.stiffness)[0]) for spring in springs])
    np.testing.assert_allclose(np.array(LINKS[link].compliance) @ stiffness, np.eye(6), rtol=0, atol=1e-12)
    assert not np.any(LINKS[5].compliance)


@pytest.mark.parametrize("joint", Joint)
def test_each_joint_has_the_gear_hardstops_and_motor_that_flight_software_believes(nominal, joint):
    model, name, believed = nominal.model, joint.name.lower(), JOINT_PARAMS[joint]
    gear, output = model.tendon(f"{name}_gear").id, model.tendon(f"{name}_output").id
    dead_band = np.array([-0.5, 0.5]) * believed.backlash_rad
    np.testing.assert_allclose(model.tendon_lengthspring[gear], dead_band)
    assert np.ravel(model.tendon_stiffness[gear])[0] == believed.gear_stiffness_Nm_rad
    assert model.tendon_frictionloss[output] == believed.output_friction_Nm
    # the hardstops stand two degrees outside of the soft limits
    low, high = model.tendon_lengthspring[output]
    assert believed.soft_min_rad - low == pytest.approx(np.radians(2.0), abs=1e-5)
    assert high - believed.soft_max_rad == pytest.approx(np.radians(2.0), abs=1e-5)
    # the rotor inertia comes through the square of the gear ratio
    rotor_kg_m2, published_Nm = (1.5e-6, 1143.0) if joint <= Joint.ELBOW else (1.0e-6, 259.0)
    reflected = model.dof_armature[model.joint(f"{name}_motor").dofadr[0]]
    assert reflected == pytest.approx(rotor_kg_m2 * believed.gear_ratio**2, rel=1e-3)
    most_Nm = model.actuator(name).gainprm.ravel()[1] * believed.current_limit_A
    assert most_Nm == pytest.approx(published_Nm, rel=1e-3)
