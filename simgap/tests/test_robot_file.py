"""Robot files and their page: what they say is in the robot, and what is wrong is one sentence."""

import math

import mujoco
import pytest

from helpers.real_robots import repository_file
from helpers.robot_folder import MODEL, write_robot
from simgap.common.errors import RobotError
from simgap.files import robot_file
from simgap.loading import SplitFile, SplitTable
from simgap.robot import ControlMode, Robot

GAIN = 'gain_column = "gain"\nkp_Nm_rad = 15.0\n'


def test_numbers_that_the_file_leaves_out_are_those_of_the_model(tmp_path):
    shoulder = Robot.from_toml(write_robot(tmp_path, (GAIN, ""))).joint("shoulder")
    assert (shoulder.kp_Nm_rad, shoulder.kd_Nms_rad, shoulder.torque_limit_Nm) == (30.0, 2.0, 5.0)
    assert shoulder.mode is ControlMode.POSITION
    assert not shoulder.is_known
    assert math.isnan(shoulder.torque_constant_Nm_A)


def test_numbers_of_the_file_count_more_than_those_of_the_model(tmp_path):
    said = 'mode = "position"\nkd_Nms_rad = 0.0\ntorque_limit_Nm = 3.0\nis_known = true'
    shoulder = Robot.from_toml(write_robot(tmp_path, ('mode = "position"', said))).joint("shoulder")
    assert (shoulder.kp_Nm_rad, shoulder.kd_Nms_rad, shoulder.torque_limit_Nm) == (15.0, 0.0, 3.0)
    assert shoulder.is_known


def test_a_joint_has_its_limit_and_counts_as_loaded_where_gravity_moves_it_more_than_friction_holds(tmp_path):
    robot = Robot.from_toml(write_robot(tmp_path))
    assert robot.joint("elbow").torque_limit_Nm == pytest.approx(5.0)  # of a geared actuator
    assert robot.joint("shoulder").is_loaded_by_gravity
    assert not robot.joint("elbow").is_loaded_by_gravity  # its axis is vertical
    stiff = MODEL.replace('frictionloss="0.1"', 'frictionloss="100"')
    assert not Robot.from_toml(write_robot(tmp_path, model=stiff)).joint("shoulder").is_loaded_by_gravity


def test_a_joint_may_have_another_name_than_in_the_model(tmp_path):
    path = write_robot(tmp_path, ("[joints.elbow]", '[joints.forearm]\njoint = "elbow"\nactuator = "elbow"'))
    assert Robot.from_toml(path).joint("forearm").dof_index == 1


def test_an_included_file_brings_its_meshes_and_the_text_of_the_model_compiles_from_anywhere(
    tmp_path, monkeypatch
):
    (tmp_path / "parts").mkdir()
    points = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4"
    (tmp_path / "parts" / "link.obj").write_text(points)
    (tmp_path / "arm.xml").write_text(
        '<mujoco><compiler meshdir="parts"/><asset><mesh file="link.obj"/></asset>'
        '<include file="deep.xml"/></mujoco>'
    )
    (tmp_path / "deep.xml").write_text("<mujocoinclude><option gravity='0 0 -1.6'/></mujocoinclude>")
    model = MODEL.replace("<worldbody>", '<!-- kept --><include file="arm.xml"/><worldbody>')
    robot = Robot.from_toml(write_robot(tmp_path, model=model))
    monkeypatch.chdir("/")
    again = mujoco.MjModel.from_xml_string(robot.model_xml)
    assert again.nmesh == robot.model.nmesh == 1
    assert again.opt.gravity[2] == robot.model.opt.gravity[2] == -1.6
    assert "<!-- kept -->" in robot.model_xml


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<mujoco><include file="arm.xml"/></mujoco>', "arm.xml: includes itself; remove this include"),
        ('<mujoco><include file="none.xml"/></mujoco>', r"none.xml: cannot be read \(No such file"),
        ("<mujoco>", "arm.xml: is not XML"),
    ],
)
def test_an_include_that_cannot_be_read_is_one_sentence(tmp_path, text, said):
    (tmp_path / "arm.xml").write_text(text)
    model = MODEL.replace("<worldbody>", '<include file="arm.xml"/><worldbody>')
    with pytest.raises(RobotError, match=said):
        Robot.from_toml(write_robot(tmp_path, model=model))


def test_the_file_of_a_tracked_arm_points_to_its_serial_arm(tmp_path):
    text = 'name = "arm"\nserial_arm = "arm.toml"\n[poses]\n"poses.csv" = "map.toml"'
    (tmp_path / "robot.toml").write_text(text)
    found = robot_file.read_robot_file(tmp_path / "robot.toml")
    assert isinstance(found, robot_file.SerialFile)
    assert found.poses == {"poses.csv": "map.toml"}
    with pytest.raises(RobotError, match="serial_arm: has tracker poses and no MJCF model"):
        Robot.from_toml(tmp_path / "robot.toml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('model = "model.xml"', "", "model: is missing; add it"),
        ('model = "model.xml"', 'modle = "model.xml"', "modle: is not known; did you mean model?"),
        ("time_step_s = 0.002", "time_step_s = nan", "time_step_s: should be a finite number, not nan"),
        ("time_step_s = 0.002", "time_step_s = 0", "time_step_s: should be greater than or equal to"),
        ("time_step_s = 0.002", 'time_step_s = "2 ms"', "time_step_s: should be a valid number, not '2 ms'"),
        ("time_step_s = 0.002", "time_step_s = 0.003", "control_rate_Hz: its period is 1.33333 time steps"),
        ("control_rate_Hz = 250.0", "control_rate_Hz = 2000.0", "write time_step_s = 0.0005, or a rate"),
        ('mode = "torque"', 'mode = "force"', "joints.elbow.mode: should be 'position', 'velocity'"),
        ('mode = "torque"', 'mode = "current"', "joints.elbow.torque_constant_Nm_A: is missing"),
        ("gear_ratio = 50.0", "gear_ratio = -50.0", "joints.elbow.gear_ratio: should be greater than 0"),
        (
            "kp_Nm_rad = 15.0",
            "kp_Nm_rad = 15.0\ntorque_limit_Nm = -8.0",
            "torque_limit_Nm: should be greater than 0",
        ),
        ("gear_ratio = 50.0", "gear_ration = 50.0", "joints.elbow.gear_ration: is not known; did you mean"),
        ("counts_per_turn = 4096.0, ", "", "joints.elbow.position: counts_per_turn is needed for the units"),
        ('column = "c1"', 'colum = "c1"', "joints.shoulder.command.colum: is not known; did you mean"),
        ('unit = "mN m"', 'unit = "mNm"', "joints.elbow: torque.unit: 'mNm' is no unit of torque or force"),
        ('"c1", unit = "deg"', '"c1", unit = "fraction"', "command: at_0_rad and at_1_rad are needed"),
        ('mode = "torque"', 'mode = "position"', "joints.elbow.kp_Nm_rad: is 0 or missing, and the model"),
        ('tool_site = "tip"', 'tool_site = "top"', "tool_site: the model has no site 'top'; did you mean"),
        ("[joints.elbow]", "[joints.elbo]", "joints.elbo.joint: the model has no joint 'elbo'; did you"),
        ("[joints.elbow]", '[joints.b]\njoint = "shoulder"', "joints.b.joint: is the joint of another table"),
        ('mode = "torque"', 'actuator = "x"\nmode = "torque"', "joints.elbow.actuator: the model has no"),
        ("kp_Nm_rad = 15.0", "", "joints.shoulder: kp_Nm_rad: is missing; with a gain column it is the"),
        ('name = "two links"', "name = ", "is not TOML: "),
    ],
)
def test_an_error_is_one_sentence_with_the_path_of_its_key(tmp_path, old, new, said):
    path = write_robot(tmp_path, (old, new))
    with pytest.raises(RobotError) as error:
        Robot.from_toml(path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


SLIDE = MODEL.replace('joint name="shoulder"', 'joint name="shoulder" type="slide"')
BALL = MODEL.replace('name="elbow" axis="0 0 1" range="-2 2"', 'name="elbow" type="ball"')


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (MODEL.replace("</body>", "", 1), "is not XML: "),
        ("<robot/>", "its root is <robot>; name an MJCF file"),
        (MODEL.replace('mass="1"', 'mass="-1"'), "MuJoCo cannot compile it: "),
        (
            SLIDE,
            "joints.shoulder.command.unit: 'deg' is no unit of length; write one of m, cm, mm, um, as 's",
        ),
        (BALL, "'elbow' is no hinge and no slide"),
    ],
)
def test_a_model_that_is_wrong_is_refused(tmp_path, model, said):
    with pytest.raises(RobotError, match=said):
        Robot.from_toml(write_robot(tmp_path, model=model))


def test_a_driven_joint_that_has_no_table_is_refused(tmp_path):
    head, _, _ = write_robot(tmp_path).read_text().partition("[joints.elbow]")
    (tmp_path / "robot.toml").write_text(head)
    with pytest.raises(RobotError, match="joints: the model drives 'elbow', which has no table; add one"):
        Robot.from_toml(tmp_path / "robot.toml")


TABLES = {
    "Robot": robot_file.RobotFile,
    "`[time]`": robot_file.TimeTable,
    "`[motion]`": robot_file.MotionTable,
    "`[conditions.NAME]`": robot_file.ConditionTable,
    "Numbers that a condition sets": robot_file.SettingTable,
    "`[csv]`": robot_file.CsvTable,
    "`[joints.NAME]`": robot_file.JointTable,
    "Columns": robot_file.SignalColumn,
    "Split file": SplitFile,
    "`[splits.NAME]`": SplitTable,
    "Arm with tracker poses": robot_file.SerialFile,
}


def lines_of(record):
    """Return the lines of the list of a record: key, default, meaning."""
    lines = []
    for key, field in record.model_fields.items():
        default = field.get_default(call_default_factory=True)
        is_plain = isinstance(default, (str, float, int)) and default != ""
        shown = " (needed)" if field.is_required() else f" (`{str(default).lower()}`)" if is_plain else ""
        lines.append(f"- `{key}`{shown}: {' '.join(str(field.description).split())}")
    return lines


@pytest.mark.parametrize("heading", TABLES)
def test_the_page_has_a_line_for_each_key(heading):
    section = repository_file("docs/robot-file.md").read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    shown = [line for line in section.splitlines() if line.startswith("- `")]
    assert shown == lines_of(TABLES[heading])
