"""Slides: read in mm, moved as MuJoCo moves them, and shown in mm and N; joints that are left out."""

import mujoco
import numpy as np
import pytest

from helpers.effect_lab import motion_of, play
from helpers.slide_arm import command_of, model_text, write_folder, write_logs
from simgap import diagnose, verdict_lines
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.audit import audit
from simgap.command.check import simulate_nominal
from simgap.common.errors import RobotError
from simgap.effects.command import CommandDelay
from simgap.effects.effect import joint_scales
from simgap.loading import load
from simgap.mjcf import place_tied
from simgap.patch.patch import make_patch
from simgap.patch.runtime import RuntimeEffects
from simgap.robot import Robot
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import cut_windows

TIME_S = 0.002 * np.arange(1500)
COMMAND = command_of(3, TIME_S)


@pytest.fixture
def robot(tmp_path):
    return Robot.from_toml(write_folder(tmp_path))


def by_engine(robot, effects=(), size=()):
    """Return the positions of both joints by the engine, (2, n) [m, rad]."""
    windows = cut_windows(robot, motion_of(robot, TIME_S, 0.0 * COMMAND, COMMAND), None, 0.0)
    (found,) = Engine(Models(robot), effects, windows, 1).positions(np.array([size], float))
    return found.reshape(2, -1)


def by_mujoco(text):
    """Return the positions of both joints by a loop of MuJoCo, (2, n)."""
    model = mujoco.MjModel.from_xml_string(text)
    lift, swing = (model.joint(name).qposadr[0] for name in ("lift", "swing"))
    data = mujoco.MjData(model)
    shown, last = [], COMMAND[0]
    for command in COMMAND:
        shown.append((data.qpos[lift], data.qpos[swing]))
        data.ctrl[:2], last = (command + last) / 2, command  # half a step later, as in the engine
        mujoco.mj_step(model, data)
    return np.transpose(shown)


def test_the_engine_and_the_patch_move_a_slide_as_mujoco_does(robot):
    native, engine = by_mujoco(make_patch(robot, [], []).model_xml), by_engine(robot)
    assert np.ptp(native, axis=1).min() > 0.05
    assert np.allclose(engine, native, atol=(5e-4 * np.array([[0.1], [1.0]])))


def test_a_slide_is_read_in_mm_and_from_the_side_of_its_motor(tmp_path):
    of_motor = '{ column = "p_lift", unit = "deg", side = "motor" }\ngear_ratio = 200.0'
    path = write_folder(tmp_path, ('{ column = "p_lift", unit = "mm" }', of_motor))
    log = write_logs(tmp_path, count=4)
    by_motor = load(path, log).motions[0].joints["lift"]
    assert np.abs(by_motor.command.value).max() < 0.3
    write_folder(tmp_path)
    plain = load(path, log).motions[0].joints["lift"]
    assert by_motor.position.value == pytest.approx(plain.position.value * 1e3 * np.pi / 180 / 200)


MOTOR_TURNS = "joints.lift.position.unit: 'mm' is no unit of angle; .*, as 'lift' is a slide; its motor turns"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"p_lift", unit = "mm"', '"p_lift", unit = "rad"', "joints.lift.position.unit: 'rad' is no unit"),
        ('"c_swing", unit = "rad"', '"c_swing", unit = "mm"', "joints.swing.command.unit: 'mm' is no unit"),
        ('"p_lift", unit = "mm"', '"p_lift", unit = "mm", side = "motor"', MOTOR_TURNS),
        ('"p_lift", unit = "mm"', '"p_lift", unit = "mmm"', "position.unit: 'mmm' is no unit of angle or"),
    ],
)
def test_a_unit_of_the_other_kind_of_joint_is_refused(tmp_path, old, new, said):
    with pytest.raises(RobotError, match=said):
        Robot.from_toml(write_folder(tmp_path, (old, new)))


def test_effects_of_a_slide_are_told_in_its_units(robot, tmp_path):
    logs = load(robot, write_logs(tmp_path, count=4))
    effects = [*catalogue(robot, logs), *base_effects(robot, logs)]
    of_slide = [one for one in effects if one.place == "lift"]
    names = {size.name for one in of_slide for size in one.sizes}
    assert {"coulomb_N", "damping_Ns_m", "armature_kg", "kd_Ns_m", "stribeck_m_s"} <= names
    assert {"backlash_m", "compliance_m_N", "stiffness_N_m", "inverse_limit_1_N"} <= names
    assert not any("rad" in name or "Nm" in name or "kgm2" in name for name in names)
    hinged = {"position-dependent torque", "link inertia", "joint coupling"}
    assert hinged.isdisjoint(one.name for one in of_slide)
    texts = [one.describe(np.array([size.typical for size in one.sizes])) for one in of_slide]
    assert not any("rad" in text or "N m" in text for text in texts)
    of_hinge = {size.name for one in effects if one.place == "swing" for size in one.sizes}
    assert {"coulomb_Nm", "damping_Nms_rad", "armature_kgm2", "zero_rad"} <= of_hinge


def test_the_check_of_a_sound_slide_has_no_remark(robot, tmp_path):
    assert audit(robot, load(robot, write_logs(tmp_path, delay_s=0.0, friction_N=0.0, count=4))).remarks == ()


@pytest.mark.parametrize(
    ("more", "said"),
    [("", "times its command: is the position in mm, "), (", factor = 0.01", "is the position in cm")],
)
def test_a_slide_in_another_unit_than_m_is_told(tmp_path, more, said):
    path = write_folder(tmp_path, ('"p_lift", unit = "mm"', f'"p_lift", unit = "m"{more}'))
    robot = Robot.from_toml(path)
    (remark,) = audit(robot, load(robot, write_logs(tmp_path, count=4))).remarks
    assert said in remark.text
    assert "degrees" not in remark.text


LEFT_OUT = ('model = "model.xml"', 'model = "model.xml"\nleft_out = ["left", "right"]')


def test_a_gripper_that_is_left_out_stands_still_and_stays_in_the_patch(tmp_path):
    robot = Robot.from_toml(write_folder(tmp_path, LEFT_OUT, has_gripper=True))
    assert robot.model.nv == 2
    assert robot.model.body("left").mass[0] == pytest.approx(0.05)
    assert by_engine(robot).shape[0] == 2
    text = make_patch(robot, [], []).model_xml
    assert "<!-- a user's own words -->" in text
    assert mujoco.MjModel.from_xml_string(text).nv == 4
    held = mujoco.MjSpec.from_string(text)
    for one in (*held.equalities, *(held.joint(name) for name in ("left", "right")), held.actuators[2]):
        held.delete(one)
    assert np.allclose(by_engine(robot), by_mujoco(held.to_xml()), atol=5e-4)


GRIP = """
[joints.left]
mode = "position"
command = { column = "c_left", unit = "percent", at_0_rad = 0.0, at_1_rad = 0.04 }
position = { column = "p_left", unit = "percent", at_0_rad = 0.0, at_1_rad = 0.04 }
"""


def test_a_gripper_with_its_own_log_starts_where_its_tie_puts_both_fingers(tmp_path):
    path = write_folder(tmp_path, has_gripper=True)
    path.write_text(path.read_text() + GRIP)
    columns = ("motion", "repeat", "t", "c_lift", "c_swing", "p_lift", "p_swing", "c_left", "p_left")
    rows = [f"m,,{0.01 * k:.2f},0,0,-5,0,50,50" for k in range(200)]
    (tmp_path / "log.csv").write_text("\n".join([",".join(columns), *rows]))
    robot = Robot.from_toml(path)
    (motion,) = load(robot, tmp_path / "log.csv").motions
    assert motion.joints["left"].position.value == pytest.approx(0.02)
    assert simulate_nominal(Models(robot), motion).position["left"] == pytest.approx(0.02, abs=1e-5)
    windows = cut_windows(robot, motion, None, 0.0)
    (shown,) = Engine(Models(robot), [], windows, 1).positions(np.zeros((1, 0)))
    assert shown.reshape(3, -1)[2] == pytest.approx(0.02, abs=1e-5)


def test_a_joint_that_depends_on_another_is_placed_by_the_law_of_the_tie():
    text = model_text(has_gripper=True).replace('joint2="right"', 'joint2="right" polycoef="0.001 2 0 0 0"')
    model = mujoco.MjModel.from_xml_string(text)
    left, right = (int(model.joint(name).dofadr[0]) for name in ("left", "right"))
    for known, other, q, v in ((right, left, 0.021, 0.6), (left, right, 0.0045, 0.15)):
        qpos, qvel = np.zeros((2, model.nq)), np.zeros((2, model.nv))
        qpos[:, known], qvel[:, known] = 0.01, 0.3
        place_tied(model, [known], qpos, qvel)
        assert (qpos[1, other], qvel[1, other]) == pytest.approx((q, v))


def test_the_wrapper_moves_a_slide_as_the_engine_does(robot, tmp_path):
    delay = CommandDelay.at(
        robot, "lift", joint_scales(robot, [motion_of(robot, TIME_S, 0.0 * COMMAND, COMMAND)])
    )
    patch = make_patch(robot, [delay], [(0.0123,)])
    (tmp_path / "runtime.toml").write_text(patch.runtime)
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime = RuntimeEffects.from_toml(model, tmp_path / "runtime.toml")
    shown = play(model, runtime, COMMAND, np.zeros(2)).T
    assert shown == pytest.approx(by_engine(robot, [delay], [0.0123]), abs=1e-12)


NO_TABLE = "joints: the model drives 'left', which has no table; add one, or write "


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("", rf'{NO_TABLE}left_out = \["left", "right"\]'),
        ('"left"', r"ties 'left' to others; leave out"),
        ('"lef"', "left_out: the model has no joint 'lef'"),
        ('"lift", "left", "right"', "left_out: 'lift' has the table joints.lift; remove one of them"),
    ],
)
def test_what_is_left_out_is_told_in_one_sentence(tmp_path, names, said):
    changes = [(LEFT_OUT[0], f"{LEFT_OUT[0]}\nleft_out = [{names}]")] * bool(names)
    with pytest.raises(RobotError, match=said):
        Robot.from_toml(write_folder(tmp_path, *changes, has_gripper=True))


@pytest.mark.parametrize(
    "joint", ["<freejoint/>", '<freejoint name="root"/>', '<joint name="root" type="free"/>']
)
def test_a_free_base_is_refused_or_held(tmp_path, joint):
    path = write_folder(tmp_path)
    base = f'<body name="base" pos="0 0 1">{joint}<inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>'
    text = model_text().replace("<worldbody>", f"<worldbody>{base}")
    text = text.replace("</worldbody>", "</body></worldbody>")
    (tmp_path / "model.xml").write_text(text)
    name = "root" if "root" in joint else "base"
    said = rf"model: the joint of '{name}' is free, .* left_out = \[\"{name}\"\] holds"
    with pytest.raises(RobotError, match=said):
        Robot.from_toml(path)
    path.write_text(path.read_text().replace(LEFT_OUT[0], f'{LEFT_OUT[0]}\nleft_out = ["{name}"]'))
    robot = Robot.from_toml(path)
    assert robot.model.nv == 2
    assert np.ptp(by_engine(robot)[0]) > 0.05
    assert mujoco.MjModel.from_xml_string(make_patch(robot, [], []).model_xml).nv == 8


@pytest.mark.slow
def test_the_delay_and_the_friction_of_a_slide_are_found(robot, tmp_path):
    logs = load(robot, write_logs(tmp_path), held_out=["m2", "m4"])
    result = diagnose(robot, logs.fit, held_out=logs.judged)
    found = next(one for one in result.findings if "lift: command delay" in one.effects)
    assert found.places == ("lift",)
    assert found.size[0] == pytest.approx(0.03, abs=2e-3)
    base = {one.name: one.value for one in result.base if one.place == "lift"}
    assert base["coulomb_N"] == pytest.approx(10.0, abs=0.5)
    lift = result.errors[0]
    assert lift.unit == "m"
    assert lift.explained < 0.1 * lift.nominal
    assert " mm" in verdict_lines(result)[2]
