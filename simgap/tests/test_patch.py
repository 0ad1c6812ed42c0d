"""The patch of a robot: its model and its runtime file simulate what the engine simulates."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from helpers import pendulum as lab
from helpers.effect_lab import own_effect, play
from helpers.planar_arm import planar_arm
from helpers.verdicts import diagnosis
from simgap.catalogue.own_effects import load_effects
from simgap.common.errors import BadOutput, RobotError
from simgap.effects.actuation import BackEmf, DampingGain, DeadZone, GainError, LeakyIntegral
from simgap.effects.command import (
    AccelerationLimit,
    ClampHigh,
    ClampLow,
    CommandDelay,
    EncoderScale,
    JointZero,
    MeasurementDelay,
    VelocityLimit,
)
from simgap.effects.forces import CoulombFriction, LoadFriction, StribeckFriction, ViscousFriction
from simgap.effects.inertia import Armature
from simgap.logs import Logs, Signal
from simgap.patch.patch import make_patch, save_patch
from simgap.patch.runtime import RuntimeEffects, RuntimeJoint
from simgap.robot import ControlMode

ROBOT = lab.pendulum(limit_Nm=1.5)
IN_MODEL = {ViscousFriction: 0.01, CoulombFriction: 0.05, GainError: -0.3, Armature: 0.001}
AT_RUN_TIME = {StribeckFriction: (0.05, 0.4), LoadFriction: 0.1, CommandDelay: 0.013, ClampHigh: 0.3}
AT_RUN_TIME |= {MeasurementDelay: 0.0123, EncoderScale: 0.02, JointZero: 0.03, BackEmf: 0.2, DeadZone: 0.02}
AT_RUN_TIME |= {LeakyIntegral: (1.0, 2.0), VelocityLimit: 2.0, AccelerationLimit: 0.5}
TIME_s = np.arange(0.0, 1.5, 0.01)
COMMAND = lab.waves(TIME_s, seed=5)


def made(sizes):
    """Return effects at the pendulum, and their sizes as tuples."""
    effects = [lab.at_swing(kind, ROBOT) for kind in sizes]
    return effects, [size if isinstance(size, tuple) else (size,) for size in sizes.values()]


def by_engine(effects, sizes, robot=ROBOT, early_s=0.0):
    """Return what the encoder shows in a motion by the engine, (n,); commands may have early stamps."""
    log = lab.motion(TIME_s, np.zeros(TIME_s.size), COMMAND)
    command = Signal(TIME_s - early_s, COMMAND)
    log = replace(log, joints={"swing": replace(log.joints["swing"], command=command)})
    return lab.simulated(robot, log, *zip(effects, sizes, strict=True))


def by_patch(effects, sizes, folder):
    """Return what the encoder shows with the patched model and the runtime file, (n,)."""
    save_patch(ROBOT, diagnosis(effects=tuple(effects), sizes=tuple(sizes)), folder)
    model = mujoco.MjModel.from_xml_path(str(folder / "patched.xml"))
    runtime = RuntimeEffects.from_toml(model, folder / "runtime.toml")
    return play(model, runtime, COMMAND[:, None], np.zeros(1), every=5)[:, 0]


def test_patched_model_and_runtime_file_simulate_what_the_engine_simulates(tmp_path):
    effects, sizes = made(IN_MODEL | AT_RUN_TIME)
    engine, patch = by_engine(effects, sizes), by_patch(effects, sizes, tmp_path)
    assert np.ptp(engine) > 0.3
    assert patch == pytest.approx(engine, abs=1e-9)


def test_a_run_that_begins_with_place_or_a_reset_remembers_no_other(tmp_path):
    effects, sizes = made(AT_RUN_TIME)
    by_patch(effects, sizes, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "patched.xml"))
    runtime = RuntimeEffects.from_toml(model, tmp_path / "runtime.toml")
    first, again = (play(model, runtime, COMMAND[:, None], np.zeros(1)) for _ in range(2))
    assert np.array_equal(first, again)
    inputs = []
    for one in (runtime, RuntimeEffects.from_toml(model, tmp_path / "runtime.toml")):
        data = mujoco.MjData(model)  # its time is before the end of the last run
        one.act(model, data, COMMAND[[60]])
        inputs.append([*data.ctrl, *one.shown(data)])
    assert inputs[0] == inputs[1]


@pytest.mark.parametrize("kind", AT_RUN_TIME, ids=lambda kind: kind.__name__)
def test_each_effect_at_run_time_is_that_of_the_engine_and_is_seen(kind, tmp_path):
    effects, sizes = made({kind: AT_RUN_TIME[kind]})
    engine, patch = by_engine(effects, sizes), by_patch(effects, sizes, tmp_path)
    assert patch == pytest.approx(engine, abs=1e-9)
    assert np.abs(engine - by_engine(*made({}))).max() > 1e-3


@pytest.mark.parametrize(("share_of_last", "early_s"), [(0.0, 0.001), (0.1, 0.0)])
def test_a_loop_without_the_wrapper_is_half_a_step_early_unless_it_mixes_commands(share_of_last, early_s):
    robot = lab.pendulum(step_s=0.002, period_s=0.01)
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
    patch = make_patch(ROBOT, *made(IN_MODEL))
    assert not patch.runtime
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    assert model.actuator_forcerange[0].tolist() == [-1.5, 1.5]


def test_the_runtime_file_of_an_earlier_patch_is_deleted_once_all_others_are_written(tmp_path):
    (tmp_path / "runtime.toml").write_text("old")
    (tmp_path / "effects.toml").mkdir()
    with pytest.raises(BadOutput, match=r"effects.toml: cannot be written"):
        save_patch(ROBOT, diagnosis(effects=(), sizes=()), tmp_path)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["effects.toml", "runtime.toml"]
    (tmp_path / "effects.toml").rmdir()
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


def test_gains_that_are_not_known_leave_no_number_that_is_none():
    joint = replace(ROBOT.joints[0], mode=ControlMode.VELOCITY, kp_Nm_rad=math.nan, kd_Nms_rad=math.nan)
    patch = make_patch(replace(ROBOT, joints=(joint,)), *made({LoadFriction: 0.1}))
    assert 'armature="nan"' not in patch.model_xml
    assert "armature_off_kgm2 = 0.0" in patch.runtime


def test_an_actuator_that_has_the_law_of_the_robot_file_is_not_touched():
    motor = "<general name='m' joint='swing' biastype='affine' gainprm='4' biasprm='0 -4 -.1'/>"
    xml = ROBOT.model_xml.replace("</mujoco>", f"<actuator>{motor}</actuator></mujoco>")
    joint = replace(ROBOT.joints[0], actuator_index=0, torque_limit_Nm=math.inf)
    robot = replace(ROBOT, model=mujoco.MjModel.from_xml_string(xml), model_xml=xml, joints=(joint,))
    assert "torque limit" not in make_patch(robot, [], []).model_xml
    said = "<!-- kp 6, kd 0.15, torque limit inf: swing: gain error, gain_ratio = 0.5 -->"
    assert said in make_patch(robot, *made({GainError: 0.5})).model_xml


def test_added_actuators_have_the_order_of_the_joints():
    robot = planar_arm()
    model = mujoco.MjModel.from_xml_string(make_patch(robot, [], []).model_xml)
    assert [model.actuator(k).name for k in range(model.nu)] == ["shoulder", "elbow"]


def read(folder, actuator, mode="position", of_joint="", more=""):
    """Read the pendulum with an actuator of its own."""
    xml = lab.pendulum().model_xml.replace("</mujoco>", f"<actuator>{actuator}</actuator></mujoco>")
    return lab.read(folder, xml.replace('name="swing"', f'name="swing" {of_joint}'), mode, more=more)


def assert_patch_moves_as_engine(robot):
    """Check that the patched model alone moves as the engine does."""
    model = mujoco.MjModel.from_xml_string(make_patch(robot, [], []).model_xml)
    joint = RuntimeJoint("swing", "swing", "swing", robot.joints[0].mode, 0.0, 0.0)
    patched = play(model, RuntimeEffects(model, [], [joint], 0.002), COMMAND[:, None], np.zeros(1), every=5)[
        :, 0
    ]
    engine = by_engine([], [], robot)
    assert np.ptp(engine) > 0.3
    assert patched == pytest.approx(engine, abs=1e-9)


@pytest.mark.parametrize(
    ("actuator", "mode"),
    [
        ('<position joint="swing" gear="-1" kp="4" kv="0.1" forcerange="-1 1"/>', "position"),
        ('<position joint="swing" gear="-2" kp="1" kv="0.03" forcerange="-0.2 0.2"/>', "position"),
        ('<motor joint="swing" gear="-3" forcerange="-0.1 0.1"/>', "torque"),
        ('<position joint="swing" ctrlrange="-0.1 0.1" kp="4" kv="0.1"/>', "position"),
    ],
)
def test_a_gear_keeps_its_sign_and_a_range_of_commands_limits_neither_engine_nor_patch(
    actuator, mode, tmp_path
):
    assert_patch_moves_as_engine(read(tmp_path, actuator, mode))


@pytest.mark.parametrize("given_Nm", [None, 1.0])
def test_the_torque_limit_is_the_smaller_range_or_that_of_the_file(given_Nm, tmp_path):
    actuator = '<position joint="swing" kp="4" kv="0.1" gear="-2" forcerange="-1 1"/>'
    more = f"torque_limit_Nm = {given_Nm}" if given_Nm else ""
    robot = read(tmp_path, actuator, of_joint='actuatorfrcrange="-0.3 0.3"', more=more)
    assert robot.joints[0].torque_limit_Nm == (given_Nm or 0.3)
    assert_patch_moves_as_engine(robot)


@pytest.mark.parametrize(
    ("of_joint", "range_", "said"),
    [
        ("", "0 2", "forcerange of the model is 0 to 4 N m at the joint; give one limit"),
        ('actuatorfrcrange="-1 3"', "-1 1", "actuatorfrcrange of the model is -1 to 3 N m"),
    ],
)
def test_a_limit_that_differs_by_direction_is_refused(of_joint, range_, said, tmp_path):
    actuator = f'<position joint="swing" kp="4" gear="2" forcerange="{range_}"/>'
    with pytest.raises(RobotError, match=f"joints.swing.torque_limit_Nm: {said}"):
        read(tmp_path, actuator, of_joint=of_joint)


PLAIN = lab.pendulum()
FINE_s = np.arange(0.0, 3.0, 0.002)
COMMANDS = {CommandDelay: 0.0123, VelocityLimit: 2.0, AccelerationLimit: 0.3, ClampLow: 1.2, ClampHigh: 0.4}


def read_runtime(tmp_path, text, model_xml):
    (tmp_path / "runtime.toml").write_text(text)
    return RuntimeEffects.from_toml(mujoco.MjModel.from_xml_string(model_xml), tmp_path / "runtime.toml")


@pytest.mark.parametrize("kind", COMMANDS, ids=lambda kind: kind.__name__)
def test_commands_that_arrive_one_by_one_are_those_of_the_whole_motion(kind):
    effect, command = lab.at_swing(kind, PLAIN), lab.waves(FINE_s, seed=3)
    size, memory = np.array([[COMMANDS[kind]]]), {}
    whole = effect.shape_command(size, command[None, :], 0.002)[0]
    single = [effect.next_command(size, np.array([one]), 0.002, memory)[0] for one in command]
    assert np.array(single) == pytest.approx(whole, abs=1e-12)
    assert np.abs(whole - command).max() > 1e-3


def test_an_effect_of_ones_own_is_loaded_from_its_file(tmp_path):
    (tmp_path / "own.py").write_text(own_effect())
    logs = Logs((lab.motion(FINE_s, lab.waves(FINE_s, 1), lab.waves(FINE_s, 1)),))
    (pull,) = load_effects(tmp_path / "own.py", PLAIN, logs)
    patch = make_patch(PLAIN, [pull], [(0.2,)])
    assert f'file = "{tmp_path / "own.py"}"' in patch.runtime
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime, data = read_runtime(tmp_path, patch.runtime, patch.model_xml), mujoco.MjData(model)
    runtime.act(model, data, np.zeros(1))
    mujoco.mj_step(model, data, runtime.n_steps)
    assert data.qfrc_applied[0] == pytest.approx(0.2)


def test_a_wrapper_holds_what_it_does_not_change_and_the_next_one_what_is_patched(tmp_path):
    patch = make_patch(PLAIN, *made({LoadFriction: 0.1}))
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime = read_runtime(tmp_path, patch.runtime, patch.model_xml)
    data = mujoco.MjData(model)
    gain, limited = model.actuator_gainprm.copy(), model.actuator_forcelimited.copy()
    runtime.act(model, data, np.array([0.3]))
    mujoco.mj_step(model, data, runtime.n_steps)
    assert np.array_equal(model.actuator_gainprm, gain)
    for is_on in (False, True):
        RuntimeEffects.from_toml(model, tmp_path / "runtime.toml").act(model, data, np.zeros(1), is_on=is_on)
    assert np.array_equal(model.actuator_gainprm, gain)
    model.actuator_gainprm *= 2.0  # a change of the user stays
    model.dof_damping[:], armature = 0.5, model.dof_armature.copy()
    last = RuntimeEffects.from_toml(model, tmp_path / "runtime.toml")
    for is_on in (True, False, True):
        last.act(model, data, np.zeros(1), is_on=is_on)
    assert np.array_equal(model.actuator_gainprm, 2.0 * gain)
    assert np.array_equal(model.dof_armature, armature)
    assert model.dof_damping == [0.5]
    assert np.array_equal(model.actuator_forcelimited, limited)
    assert math.isclose(data.time, 0.002)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("friction_per_load =", "friction_per_weight =", "friction_per_weight; it takes friction_per_load"),
        ("simgap.effects.forces:LoadFriction", "os:system", "os is no module of simgap"),
        ("robot runtime 2", "robot runtime 1", "is not 'robot runtime 2'"),
        ('place = "swing"', 'place = "lift"', "lift: .*: its places are not one joint"),
        ('place = "swing"\ntext', 'place = "lift"\ntext', "its places are not one joint"),
        ("", "", "use the patched model"),
    ],
)
def test_a_runtime_file_of_another_format_effect_or_model_is_refused(tmp_path, old, new, said):
    patch = make_patch(PLAIN, *made({LoadFriction: 0.1}))
    assert old in patch.runtime
    with pytest.raises(RobotError, match=said):
        read_runtime(tmp_path, patch.runtime.replace(old, new), patch.model_xml if old else "<mujoco/>")


def test_a_model_without_the_actuators_or_with_another_step_and_a_command_of_another_shape_are_refused(
    tmp_path,
):
    patch = make_patch(PLAIN, *made({LoadFriction: 0.1}))
    with pytest.raises(RobotError, match="no actuator 'swing'"):
        read_runtime(tmp_path, patch.runtime, PLAIN.model_xml)
    with pytest.raises(RobotError, match="its dry friction is not that of a patch"):
        read_runtime(tmp_path, patch.runtime, patch.model_xml.replace("solimpfriction", "solimplimit"))
    for step_s in ("0.0013", "0.1"):
        with pytest.raises(RobotError, match=f"{step_s} s is no whole part of the control period of 0.002 s"):
            read_runtime(tmp_path, patch.runtime, patch.model_xml.replace('"0.002"', f'"{step_s}"', 1))
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime = read_runtime(tmp_path, patch.runtime, patch.model_xml)
    for command in (np.zeros(2), np.array([np.nan]), 0.1):
        with pytest.raises(RobotError, match="give a number for each of 1 joints"):
            runtime.act(model, mujoco.MjData(model), command)
    wrong = [("gain", one) for one in ([np.nan], [np.inf], -1.0, [1.0, 1.0])]
    for name, one in (*wrong, ("is_on", [None]), ("temperature_degC", [20.0, 20.0])):
        with pytest.raises(RobotError, match=f"{name}: is .* for each of 1 joints"):
            runtime.act(model, mujoco.MjData(model), np.zeros(1), **{name: one})


def test_a_loop_of_ones_own_has_the_gains_of_a_column_and_motors_without_torque(tmp_path):
    robot = lab.pendulum(limit_Nm=1.5, step_s=0.002, period_s=0.01)
    effects, sizes = made({CommandDelay: 0.0123, LoadFriction: 0.1, DampingGain: 0.05})
    command = np.repeat(lab.waves(FINE_s[::5], seed=5), 5)
    off = np.repeat(abs(FINE_s[::5] - 1.3) < 0.3, 5)
    enabled = Signal(FINE_s, np.where(off, 0.0, 1.0))
    log = lab.motion(FINE_s, 0.0 * FINE_s, command, gain={"swing": 0.6}, enabled=enabled)
    engine = lab.simulated(robot, log, *zip(effects, sizes, strict=True))
    patch = make_patch(robot, effects, sizes)
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime, data = read_runtime(tmp_path, patch.runtime, patch.model_xml), mujoco.MjData(model)
    shown = []
    for k in range(FINE_s.size):
        shown.append(data.qpos[0])
        if k % 5 == 0:
            runtime.act(model, data, command[[k]], gain=0.6, is_on=not off[k])
        mujoco.mj_step(model, data)
    assert shown[::5] == pytest.approx(engine[::5], abs=1e-9)
    assert np.ptp(shown) > 0.3
