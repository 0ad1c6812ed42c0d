"""`simgap init`: columns are matched to joints, units are found, and each doubt is a question."""

import json
import os
import tomllib

import mujoco
import numpy as np
import pytest

from helpers.command import run_simgap, snapshot
from helpers.message_logs import rows, write_mcap
from helpers.real_robots import repository_file
from helpers.robot_folder import changed
from simgap.command.check import check_robot
from simgap.command.request import CheckRequest
from simgap.robot import Robot
from simgap.setup.column_names import parse_name

MODEL = """
<mujoco model="two links">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" range="-2 2" limited="true" damping="1" armature="0.1"/>
      <inertial pos="0.2 0 0" mass="2" diaginertia="0.02 0.02 0.02"/>
      <body name="lower" pos="0.4 0 0">
        <joint name="elbow" axis="0 1 0" range="-2.5 2.5" limited="true" damping="1" armature="0.1"/>
        <inertial pos="0.15 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
        <site name="tcp"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>
"""
TIME_s = np.arange(0.0, 20.0, 0.01)
POSITION_rad = np.column_stack([0.5 * np.sin(2.0 * TIME_s), 0.4 * np.sin(3.0 * TIME_s + 1.0)])
VELOCITY_rad_s = np.gradient(POSITION_rad, TIME_s, axis=0)
COMMAND_rad = np.column_stack([0.5 * np.sin(2.0 * TIME_s + 0.1), 0.4 * np.sin(3.0 * TIME_s + 1.15)])
JOINTS = ("shoulder", "elbow")


def of_joints(signals, names=JOINTS):
    """Return a column for each joint, (n, 2), under its name in the place of {}."""
    return {key.format(name): one[:, k] for key, one in signals.items() for k, name in enumerate(names)}


def columns_of(names=JOINTS):
    """Return times, positions and commands of both joints."""
    return {"t": TIME_s} | of_joints({"q_{}": POSITION_rad, "cmd_{}": COMMAND_rad}, names)


def write_csv(folder, columns, separator=","):
    (folder / "model.xml").write_text(MODEL)
    table = [separator.join(columns)]
    table += [separator.join(f"{one:.8g}" for one in row) for row in zip(*columns.values(), strict=True)]
    path = folder / "log.csv"
    path.write_text("\n".join(table) + "\n")
    return path


def start(folder, log="log.csv", *options):
    """Run `init`; return the robot file and the JSON document. The check reads the file and its log."""
    done = run_simgap(folder, "init", "model.xml", log, "--json", *options)
    assert done.returncode == 0, done.stdout
    document = json.loads(done.stdout)
    path = folder / document["robot_file"]
    Robot.from_toml(path)
    checked = run_simgap(folder, "check", path.name, log, "--json")
    file = tomllib.loads(path.read_text())
    can_be_diagnosed = any(one.keys() & {"command", "torque"} for one in file["joints"].values())
    assert checked.returncode == (0 if can_be_diagnosed else 3), checked.stdout
    return file, document


def refusal(folder, *words):
    """Run `init`, which refuses; return what it says."""
    done = run_simgap(folder, "init", *(words or ("model.xml", "log.csv")))
    assert done.returncode == 2, words
    return " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("name", "joint", "key", "unit"),
    [
        ("act_pos_se_deg_a1", "a1", "secondary", "deg"),
        ("act_vel_mot_deg_per_s_a1", "a1", "velocity", "deg/s"),
        ("act_torque_abs_nm_a2", "a2", "torque", "N m"),
        ("ref_pos_deg_a2", "a2", "command", "deg"),
        ("torque_enable", "", "enabled", ""),
        ("temperature_degC", "", "temperature", "degC"),
        ("gain_kp", "", "gain", ""),
        ("current_raw_a1", "a1", "", ""),
        ("length_m", "", "", ""),
        ("observation.state[a1.pos]", "a1", "position", ""),
        ("/joint_command.position[a2]", "a2", "command", ""),
        ("dof_pos_target[3]", "", "command", ""),
        ("dq_a2", "a2", "velocity", ""),
        ("motor_current_mA_a1", "a1", "current", "mA"),
        ("target_acceleration_a1", "a1", "", ""),
        ("current_position_a1", "a1", "position", ""),
        ("actual_current_a1", "a1", "current", ""),
        ("velocity_a1_deg", "a1", "velocity", "deg/s"),
        ("velocity_a1_counts_per_s", "a1", "velocity", ""),
        ("position_a1_turns", "a1", "position", "turn"),
    ],
)
def test_a_name_says_joint_signal_and_unit(name, joint, key, unit):
    found = parse_name(name, ["a1", "a2"])
    assert (found.joint, found.key, found.unit) == (joint, key, unit)


def test_units_come_from_names_and_velocities_from_the_change_of_positions(tmp_path):
    shown = {"{}_deg_actual": np.degrees(POSITION_rad), "{}_target": np.degrees(COMMAND_rad)}
    shown["{}_speed"] = VELOCITY_rad_s * 30.0 / np.pi
    write_csv(tmp_path, {"time_ms": 1e3 * TIME_s} | of_joints(shown), ";")
    file, document = start(tmp_path)
    assert file["time"] == {"column": "time_ms", "unit": "ms"}
    assert file["control_rate_Hz"] == pytest.approx(100.0)
    assert file["tool_site"] == "tcp"
    elbow = file["joints"]["elbow"]
    assert elbow["position"] == {"column": "elbow_deg_actual", "unit": "deg"}
    assert elbow["command"] == {"column": "elbow_target", "unit": "deg"}
    assert elbow["velocity"]["unit"] == "rpm"
    assert any("kp_Nm_rad" in one for one in document["questions"])
    assert any("Write that rate, below 10000" in one for one in document["questions"])


def test_degrees_and_percent_are_a_question(tmp_path):
    shown = {"state_{}": np.degrees(POSITION_rad), "action_{}": np.degrees(COMMAND_rad)}
    write_csv(tmp_path, {"t": TIME_s} | of_joints(shown))
    file, document = start(tmp_path)
    assert file["joints"]["elbow"]["position"]["unit"] == "deg"
    assert any("with --unit percent" in one for one in document["questions"])
    file, document = start(tmp_path, "log.csv", "--out", "percent.toml", "--unit", "percent")
    percent = {"unit": "percent", "at_0_rad": 0.0, "at_1_rad": 2.5}
    assert file["joints"]["elbow"]["position"] == {"column": "state_elbow"} | percent
    assert any("is -100..100 % the range of the model?" in one for one in document["questions"])


def test_messages_are_matched_by_the_names_in_them(tmp_path):
    (tmp_path / "model.xml").write_text(MODEL)
    messages = [
        (topic, time_ns, content | {"position": [0.01 * one for one in content["position"]]})
        for topic, time_ns, content in rows(60)
    ]
    write_mcap(tmp_path / "log.mcap", messages)
    file, _ = start(tmp_path, "log.mcap")
    assert file["joints"]["elbow"]["position"]["column"] == "/joint_states.position[elbow]"
    assert file["joints"]["elbow"]["command"]["column"] == "/joint_command.position[elbow]"
    assert "time" not in file


def test_a_gain_is_estimated_by_the_sag_under_gravity(tmp_path):
    kp_Nm_rad = (60.0, 25.0)
    time_s = np.arange(0.0, 60.0, 0.1)
    command = np.column_stack([np.sin(0.2 * time_s), 1.2 * np.sin(0.3 * time_s + 1.0)])
    # at rest the loop holds gravity: kp (command - position) = torque, solved by iteration
    model = mujoco.MjModel.from_xml_string(MODEL)
    data, position = mujoco.MjData(model), command.copy()
    for _ in range(20):
        for row, q in enumerate(position):
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            position[row] = command[row] - data.qfrc_bias / kp_Nm_rad
    write_csv(tmp_path, {"t": time_s} | of_joints({"position_{}": position, "command_{}": command}))
    file, _ = start(tmp_path)
    for name, kp in zip(JOINTS, kp_Nm_rad, strict=True):
        assert file["joints"][name]["kp_Nm_rad"] == pytest.approx(kp, rel=0.05)


def test_a_velocity_that_fits_no_unit_is_left_away_and_asked(tmp_path):
    shown = {"position_{}": np.add(POSITION_rad, (0.0, 0.5)), "command_{}": np.add(COMMAND_rad, (0.0, 0.5))}
    shown["velocity_{}"] = VELOCITY_rad_s * (1.0, 3.0)
    write_csv(tmp_path, {"t": TIME_s} | of_joints(shown))
    file, document = start(tmp_path)
    assert "velocity" in file["joints"]["shoulder"]
    assert "velocity" not in file["joints"]["elbow"]
    (asked,) = [one for one in document["questions"] if "velocity_elbow is " in one]
    assert "times the change of the position" in asked


def test_motions_begin_where_the_time_begins_anew(tmp_path):
    columns = {"trial": np.repeat([0, 1, 2], 600), "repeat": np.repeat([1, 0, 1], 600)}
    columns["t"] = np.tile(TIME_s[:600], 3)
    rows = np.r_[0:1200, 0:600]
    columns |= of_joints({"q_{}": POSITION_rad[rows], "q_des_{}": COMMAND_rad[rows]})
    write_csv(tmp_path, columns)
    file, _ = start(tmp_path)
    assert file["motion"] == {"columns": ["trial"], "repeat_column": "repeat"}
    del columns["trial"], columns["repeat"]
    write_csv(tmp_path, columns)
    os.remove(tmp_path / "robot.toml")
    assert "does not increase at row 601" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ({"t": np.repeat(TIME_s[::3], 3)[: TIME_s.size]}, "the time 't' stands still in most rows"),
        ({"t": np.maximum(TIME_s, 0.1), "motion": TIME_s > 3.0}, "the time 't' repeats: 10 rows have the"),
        ({"stamp.sec": np.floor(TIME_s), "stamp.nanosec": 1e9 * (TIME_s % 1.0)}, "the time is in two"),
    ],
    ids=["twice", "repeated", "nanoseconds"],
)
def test_times_that_are_none_are_told(tmp_path, times, said):
    write_csv(tmp_path, times | of_joints({"q_{}": POSITION_rad}))
    assert said in refusal(tmp_path)


def test_words_among_times_and_files_without_names_are_told(tmp_path):
    path = write_csv(tmp_path, {"t": TIME_s[:9], "q_elbow": TIME_s[:9]})
    text = path.read_text()
    for other, said in {
        f"{text}end,0.0\n": "the time 't' holds texts",
        text.partition("\n")[2]: "its columns have no names",
    }.items():
        path.write_text(other)
        assert said in refusal(tmp_path)


def test_bad_input_writes_nothing(tmp_path):
    write_csv(tmp_path, {"t": TIME_s, "temperature": TIME_s, "x": TIME_s})
    (tmp_path / "bad.xml").write_text("no model")
    before = snapshot(tmp_path)
    for words, said in {
        ("model.xml", "log.csv"): "no column is a position of shoulder, elbow by its name",
        ("model.xml",): "none is given",
        ("bad.xml", "log.csv"): "is not XML",
        ("model.xml", "none.csv"): "there is no such log",
        ("model.xml", "log.csv", "--out", "robot.txt"): "must end in .toml",
    }.items():
        assert said in refusal(tmp_path, *words)
    assert snapshot(tmp_path) == before
    (tmp_path / "robot.toml").write_text("mine")
    assert "is there already" in refusal(tmp_path)
    assert (tmp_path / "robot.toml").read_text() == "mine"


def start_with(folder, columns, *changes):
    """Run `init` with a changed model; return the robot file and the questions."""
    path = write_csv(folder, columns)
    (folder / "model.xml").write_text(changed(MODEL, *changes))
    file, document = start(folder, path.name)
    return file, document["questions"]


@pytest.mark.parametrize("names", [("肩", "肘"), ("arm/j.1", "arm/j.2"), ("j1", "j10"), ("a\\b", "it's")])
def test_joints_may_have_any_names(tmp_path, names):
    changes = zip(('"shoulder"', '"elbow"'), (f'"{name}"' for name in names), strict=True)
    file, _ = start_with(tmp_path, columns_of(names), *changes)
    for name in names:
        table = file["joints"][name]
        assert [table[key]["column"] for key in ("position", "command")] == [f"q_{name}", f"cmd_{name}"]


def test_a_column_that_never_has_a_number_is_not_taken(tmp_path):
    nothing = np.full(TIME_s.size, np.nan)
    file, _ = start_with(tmp_path, columns_of() | {"effort_shoulder": nothing, "effort_elbow": nothing})
    assert "torque" not in file["joints"]["elbow"]
    assert file["joints"]["elbow"]["kp_Nm_rad"] > 0.0  # positions are compared, not torques


def test_one_of_two_actuators_is_taken_and_asked(tmp_path):
    two = '<velocity name="v" joint="elbow" kv="1"/><position name="p" joint="elbow" kp="9"/>'
    file, questions = start_with(tmp_path, columns_of(), ('<motor joint="elbow"/>', two))
    assert file["joints"]["elbow"]["actuator"] == "p"
    assert "joints.elbow.actuator: which actuator has the command: p, v?" in questions


@pytest.mark.slow
def test_a_gripper_that_no_column_shows_is_left_out_and_a_joint_that_follows_has_no_table(tmp_path):
    finger = '<body><joint name="{}" type="slide"/><geom size="0.01" mass="0.1"/></body>'
    fingers = finger.format("left") + finger.format("right")
    tendon = "".join(f'<joint joint="{one}" coef="0.5"/>' for one in ("left", "right"))
    file, _ = start_with(
        tmp_path,
        columns_of(),
        ('<site name="tcp"/>', fingers),
        ('<motor joint="elbow"/>', '<position tendon="grip"/>'),
        ("</actuator>", f'</actuator><tendon><fixed name="grip">{tendon}</fixed></tendon>'),
    )
    assert file["left_out"] == ["left", "right"]
    os.remove(tmp_path / "robot.toml")
    del (columns := columns_of())["cmd_elbow"]
    tie = '</actuator><equality><joint joint1="elbow" joint2="shoulder"/></equality>'
    file, _ = start_with(tmp_path, columns, ('<motor joint="elbow"/>', ""), ("</actuator>", tie))
    assert [*file["joints"]] == ["shoulder"]


def test_a_voltage_below_0_is_asked_and_a_command_that_the_model_cannot_take_writes_nothing(tmp_path):
    columns = {key.replace("cmd_", "voltage_"): one for key, one in columns_of().items()}
    _, questions = start_with(tmp_path, columns)
    assert any("voltage_elbow goes below 0" in one for one in questions)
    os.remove(tmp_path / "robot.toml")
    write_csv(tmp_path, {key.replace("cmd_", "voltage_cmd_"): one for key, one in columns_of().items()})
    said = refusal(tmp_path)
    assert "has no <dcmotor> at this joint" in said
    assert "So no robot file was written" in said


def test_a_log_with_one_row_or_too_many_columns_says_so(tmp_path):
    path = write_csv(tmp_path, columns_of())
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    assert "has 1 value; a log needs several" in refusal(tmp_path)
    write_csv(tmp_path, {"t": TIME_s, **{f"q{k}": np.sin(TIME_s + k) for k in range(3)}})
    assert "q has 3 numbers, the model has the joints shoulder, elbow" in refusal(tmp_path)


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.parametrize(
    ("model", "log", "n_questions"),
    [
        ("so101/so101.xml", "so101/so101.parquet", 5),
        ("kr300/kr300.xml", "kr300/kr300_A.parquet", 1),
        ("models/robots/pendulum/model.xml", "xl330/xl330.parquet", 3),
    ],
)
def test_first_files_of_measured_robots_pass_the_check(real_data, tmp_path, model, log, n_questions):
    path = repository_file(model) if model.startswith("models") else real_data / model
    done = run_simgap(tmp_path, "init", str(path), str(real_data / log), "--json")
    assert len(json.loads(done.stdout)["questions"]) <= n_questions
    report = check_robot(CheckRequest(tmp_path / "robot.toml", (real_data / log,)))
    assert not report.refusal
