"""Patches of an arm of three joints: links, gravity, contact, gears, each against the engine."""

import mujoco
import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, play, robot_of, simulate
from helpers.verdicts import diagnosis
from simgap.effects.forces import PlaneContact
from simgap.effects.inertia import GravityDirection, LinkCentre, LinkInertia, LinkLength, LinkMass, Payload
from simgap.effects.transmission import Backlash, JointCompliance, JointCoupling
from simgap.logs import Signal
from simgap.patch.patch import make_patch, save_patch
from simgap.patch.runtime import RuntimeEffects
from simgap.simulation.windows import held_means

ARM = robot_of(ARM_XML)
TIME_S = ARM.control_period_s * np.arange(200)
COMMAND = np.array([0.0, 0.2, 0.0]) + 0.5 * np.sin(np.outer(TIME_S, (5.0, 4.0, 3.0)))
EDGES_S = ARM.control_period_s * np.arange(TIME_S.size + 1) - 0.5 * ARM.model.opt.timestep
HELD = np.stack([held_means(Signal(TIME_S, one), EDGES_S) for one in COMMAND.T], axis=1)
"""Commands as the engine takes them from a log; a loop without the wrapper sets them itself."""
START_RAD = COMMAND[0]
WITH_NAMES = {
    "payload": (Payload("elbow", "tool", 0.05, 0.5, 0.1), (0.1, 0.02, 0.0, -0.03)),
    "mass": (LinkMass("lift", 0.3), (0.1,)),
    "centre": (LinkCentre("elbow", 0.15), (0.02, 0.01)),
    "inertia": (LinkInertia("elbow", -1e-4, 0.01), (0.005,)),
    "length": (LinkLength("lift", "elbow", 0.15), (0.05,)),
    "gravity": (GravityDirection("base"), (0.1, -0.2)),
}
MADE_ANEW = {
    "plane": (PlaneContact("tool", -0.1, 0.5), (0.2,)),
    "backlash": (Backlash("lift", 1, True, 0.01, 0.1), (0.03,)),
    "backlash behind the encoder": (Backlash("lift", 1, False, 0.01, 0.1), (0.03,)),
    "compliance": (JointCompliance("elbow", 2, True, 0.02, 0.2), (0.02,)),
    "coupling": (JointCoupling("lift", 1, "elbow", 2, 0.05), (0.1,)),
}


def shown(effects, sizes, folder):
    """Return what the encoders show with the patch at each control period, (n_joints, n_ticks)."""
    save_patch(ARM, diagnosis(effects=tuple(effects), sizes=tuple(sizes)), folder)
    model = mujoco.MjModel.from_xml_path(str(folder / "patched.xml"))
    if (folder / "runtime.toml").exists():
        return play(model, RuntimeEffects.from_toml(model, folder / "runtime.toml"), COMMAND, START_RAD).T
    data = mujoco.MjData(model)
    joints = [model.joint(joint.name).qposadr[0] for joint in ARM.joints]
    data.qpos[joints] = START_RAD
    rows = [START_RAD]
    for held in HELD[:-1]:
        data.ctrl[:] = held
        mujoco.mj_step(model, data, 5)
        rows.append(data.qpos[joints].copy())
    return np.array(rows).T


@pytest.mark.parametrize("name", [*WITH_NAMES, *MADE_ANEW])
def test_the_patch_moves_as_the_engine_and_a_change_of_links_or_gravity_is_in_the_model_alone(name, tmp_path):
    effect, size = (WITH_NAMES | MADE_ANEW)[name]
    engine = simulate(ARM, [effect], [size, np.zeros(len(size))], HELD, START_RAD)
    near_rad, least_rad = (1e-7, 1e-4) if name in WITH_NAMES else (1e-4, 1e-3)
    assert shown([effect], [size], tmp_path) == pytest.approx(engine[0], abs=near_rad)
    assert np.abs(engine[0] - engine[1]).max() > least_rad
    assert name in MADE_ANEW or not (tmp_path / "runtime.toml").exists()


def test_effects_of_two_kinds_at_one_joint_add_up(tmp_path):
    compliance = (JointCompliance("lift", 1, True, 0.02, 0.2), (0.02,))
    pairs = [MADE_ANEW["backlash"], compliance, WITH_NAMES["mass"]]
    effects, sizes = [one for one, _ in pairs], [size for _, size in pairs]
    (engine,) = simulate(ARM, effects, [[value for size in sizes for value in size]], HELD, START_RAD)
    assert shown(effects, sizes, tmp_path) == pytest.approx(engine, abs=1e-4)


def test_a_body_without_a_name_is_found_by_its_joint():
    robot = robot_of(ARM_XML.replace('<body name="forearm"', "<body"))
    text = make_patch(robot, [LinkMass("elbow", 0.15)], [(0.1,)]).model_xml
    assert mujoco.MjModel.from_xml_string(text).body_mass[-1] == pytest.approx(0.25)
