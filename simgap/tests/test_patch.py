"""The patch of a robot: its model and its runtime file simulate what the engine simulates."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from helpers.pendulum import motion, pendulum, waves
from helpers.planar_arm import planar_arm
from helpers.verdicts import diagnosis
from simgap.effects.actuation import BackEmf, DeadZone, GainError, LeakyIntegral
from simgap.effects.command import (
    AccelerationLimit,
    ClampHigh,
    CommandDelay,
    EncoderScale,
    JointZero,
    MeasurementDelay,
    VelocityLimit,
)
from simgap.effects.effect import JointScales
from simgap.effects.forces import CoulombFriction, LoadFriction, StribeckFriction, ViscousFriction
from simgap.effects.inertia import Armature
from simgap.logs import Signal
from simgap.patch.patch import make_patch, save_patch
from simgap.patch.runtime import RuntimeEffects
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import cut_windows

SCALES = {"swing": JointScales(0.02, 0.0, 0.01, 0.002, -1, 1, 5, 50, -1, 1, 2.0, math.nan, math.nan)}
ROBOT = pendulum(limit_Nm=1.5)
IN_MODEL = {ViscousFriction: 0.01, CoulombFriction: 0.05, GainError: -0.3, Armature: 0.001}
AT_RUN_TIME = {StribeckFriction: (0.05, 0.4), LoadFriction: 0.1, CommandDelay: 0.013, ClampHigh: 0.3}
AT_RUN_TIME |= {MeasurementDelay: 0.0123, EncoderScale: 0.02, JointZero: 0.03, BackEmf: 0.2, DeadZone: 0.02}
AT_RUN_TIME |= {LeakyIntegral: (1.0, 2.0), VelocityLimit: 2.0, AccelerationLimit: 0.5}
TIME_s = np.arange(0.0, 1.5, 0.01)
COMMAND = waves(TIME_s, seed=5)


def made(sizes):
    """Return effects at the pendulum, and their sizes as tuples."""
    effects = [kind.at(ROBOT, "swing", SCALES) for kind in sizes]
    return effects, [size if isinstance(size, tuple) else (size,) for size in sizes.values()]


def by_engine(effects, sizes, robot=ROBOT, early_s=0.0):
    """Return what the encoder shows in a motion by the engine, (n,); commands may have early stamps."""
    log = motion(TIME_s, np.zeros(TIME_s.size), COMMAND)
    command = Signal(TIME_s - early_s, COMMAND)
    log = replace(log, joints={"swing": replace(log.joints["swing"], command=command)})
    (window,) = cut_windows(robot, log, None, 0.0)
    engine = Engine(Models(robot), effects, [window], n_threads=1)
    return engine.positions(np.array([value for size in sizes for value in size])[None, :])[0]


def by_patch(effects, sizes, folder):
    """Return what the encoder shows with the patched model and the runtime file, (n,)."""
    save_patch(ROBOT, diagnosis(effects=tuple(effects), sizes=tuple(sizes)), folder)
    model = mujoco.MjModel.from_xml_path(str(folder / "patched.xml"))
    data = mujoco.MjData(model)
    runtime = RuntimeEffects.from_toml(model, folder / "runtime.toml")
    runtime.place(data, np.zeros(1))
    shown = [0.0]
    for k in range(round(TIME_s[-1] / 0.002)):
        runtime.act(model, data, COMMAND[[k // 5]])
        mujoco.mj_step(model, data, runtime.n_steps)
        if (k + 1) % 5 == 0:
            shown.append(runtime.shown(data)[0])
    return np.array(shown)


def test_patched_model_and_runtime_file_simulate_what_the_engine_simulates(tmp_path):
    effects, sizes = made(IN_MODEL | AT_RUN_TIME)
    engine, patch = by_engine(effects, sizes), by_patch(effects, sizes, tmp_path)
    assert np.ptp(engine) > 0.3
    assert patch == pytest.approx(engine, abs=1e-9)


@pytest.mark.parametrize("kind", AT_RUN_TIME, ids=lambda kind: kind.__name__)
def test_each_effect_at_run_time_is_that_of_the_engine_and_is_seen(kind, tmp_path):
    effects, sizes = made({kind: AT_RUN_TIME[kind]})
    engine, patch = by_engine(effects, sizes), by_patch(effects, sizes, tmp_path)
    assert patch == pytest.approx(engine, abs=1e-9)
    assert np.abs(engine - by_engine(*made({}))).max() > 1e-3


@pytest.mark.parametrize(("share_of_last", "early_s"), [(0.0, 0.001), (0.1, 0.0)])
def test_a_loop_without_the_wrapper_is_half_a_step_early_unless_it_mixes_commands(share_of_last, early_s):
    robot = pendulum(step_s=0.002, period_s=0.01)
    effects, sizes = made(IN_MODEL)
    model = mujoco.MjModel.from_xml_string(make_patch(robot, effects, sizes).model_xml)
    data, shown, last = mujoco.MjData(model), [0.0], COMMAND[0]
    for command in COMMAND[:-1]:
        data.ctrl[:] = (1.0 - share_of_last) * command + share_of_last * last
        mujoco.mj_step(model, data, 5)
        shown.append(data.qpos[0])
        last = command
    assert shown == pytest.approx(by_engine(effects, sizes, robot, early_s), abs=1e-9)


def test_effects_of_the_model_alone_need_no_runtime_file(tmp_path):
    effects, sizes = made(IN_MODEL)
    made_patch = make_patch(ROBOT, effects, sizes)
    assert not made_patch.runtime
    model = mujoco.MjModel.from_xml_string(made_patch.model_xml)
    assert model.dof_damping[0] == pytest.approx(0.03)
    assert model.dof_frictionloss[0] == pytest.approx(0.06)
    half_step_s, kd_Nms_rad = 0.001, 0.07
    assert model.dof_armature[0] == pytest.approx(0.003 - half_step_s * (0.03 + kd_Nms_rad))
    assert model.actuator_gainprm[0, 0] == pytest.approx(2.8)
    assert model.actuator_forcerange[0].tolist() == [-1.5, 1.5]


def test_the_runtime_file_of_an_earlier_patch_is_deleted(tmp_path):
    (tmp_path / "runtime.toml").write_text("old")
    save_patch(ROBOT, diagnosis(effects=(), sizes=()), tmp_path)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["effects.toml", "patched.xml"]


def test_a_comment_above_each_change_says_the_effect_and_what_the_user_wrote_stays():
    xml = ROBOT.model_xml.replace("<worldbody>", "<worldbody><!-- my arm --><light name='sun'/>")
    robot = replace(ROBOT, model_xml=f"<!-- head -->{xml}")
    text = make_patch(robot, *made({CoulombFriction: 0.05})).model_xml
    assert "<!-- frictionloss 0.01 to 0.06: swing: Coulomb friction, coulomb_Nm = 0.05 -->" in text
    assert text.startswith("<!-- head -->")
    assert "<!-- my arm -->" in text
    assert 'name="sun"' in text


def test_a_size_of_zero_changes_no_number_of_the_model():
    effects, _ = made({CoulombFriction: 0.0, StribeckFriction: (0.0, 0.0)})
    patch = make_patch(ROBOT, effects, [(0.0,), (0.0, 0.0)])
    assert "Coulomb" not in patch.model_xml
    assert not patch.runtime


def test_an_actuator_that_has_the_law_of_the_robot_file_is_not_touched():
    motor = "<general name='m' joint='swing' biastype='affine' gainprm='4' biasprm='0 -4 -.1'/>"
    xml = ROBOT.model_xml.replace("</mujoco>", f"<actuator>{motor}</actuator></mujoco>")
    joint = replace(ROBOT.joints[0], actuator_index=0, torque_limit_Nm=math.inf)
    robot = replace(ROBOT, model=mujoco.MjModel.from_xml_string(xml), model_xml=xml, joints=(joint,))
    assert not [one for one in make_patch(robot, [], []).changes if one.startswith("actuator")]
    changes = make_patch(robot, *made({GainError: 0.5})).changes
    (changed,) = [one for one in changes if one.startswith("actuator")]
    assert changed == "actuator m: kp 6, kd 0.15, torque limit inf: swing: gain error, gain_ratio = 0.5"


def test_added_actuators_have_the_order_of_the_joints():
    robot = planar_arm()
    model = mujoco.MjModel.from_xml_string(make_patch(robot, [], []).model_xml)
    assert [model.actuator(k).name for k in range(model.nu)] == ["shoulder", "elbow"]
