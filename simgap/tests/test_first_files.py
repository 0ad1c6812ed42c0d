"""First robot files of logs that other programs write, and of robots with gears, shares and a free base."""

import json
import tomllib
from functools import cache
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from helpers.robot_folder import write_lerobot
from simgap.arrays import Array
from simgap.checks.audit import audit
from simgap.common.progress import no_progress
from simgap.loading import load
from simgap.robot import Robot
from simgap.setup.compose import draft_robot_file
from simgap.setup.draft import list_questions, robot_file_lines

MODEL = """<mujoco model="two servos">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 0.6">
      <joint name="lift" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02" range="-2 1.5"/>
      <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      <body name="lower" pos="0.25 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02" range="-2.5 2.5"/>
        <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift" joint="lift" kp="20" kv="1" forcerange="-20 20"/>
    <position name="elbow" joint="elbow" kp="20" kv="1" forcerange="-20 20"/>
  </actuator>
</mujoco>
"""
MOTORS = MODEL.replace(' kp="20" kv="1"', "").replace("<position ", "<motor ")
JOINTS = ("lift", "elbow")
RATE_HZ = 100.0


@cache
def run():
    """Simulate two motions of four seconds; arrays have a row a sample, and a column a joint."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    rows: list[tuple[float, ...]] = []
    for motion, speeds in enumerate(((2.0, 3.1), (4.3, 1.7))):
        data = mujoco.MjData(model)
        for k in range(2000):
            data.ctrl[:] = 0.6 * np.sin(np.multiply(speeds, k // 5 / RATE_HZ)) * (1.0, -0.8)
            mujoco.mj_step1(model, data)
            if k % 5 == 0:
                torque = 20.0 * (data.ctrl - data.qpos) - data.qvel
                rows.append((k // 5 / RATE_HZ, motion, *data.ctrl, *data.qpos, *data.qvel, *torque))
            mujoco.mj_step2(model, data)
    table = np.array(rows)
    signals = dict(
        zip(("command", "position", "velocity", "torque"), np.split(table[:, 2:], 4, axis=1), strict=True)
    )
    clock_s = np.arange(len(rows)) / RATE_HZ  # which does not restart
    return SimpleNamespace(time_s=table[:, 0], clock_s=clock_s, motion=table[:, 1], **signals)


def write_columns(path, **columns):
    """Write columns as CSV; arrays of two joints are columns with the number of the joint at `{}`."""
    flat: dict[str, Array] = {}
    for name, values in columns.items():
        flat |= {name: values} if values.ndim == 1 else {name.format(j): values[:, j] for j in (0, 1)}
    rows = (",".join(f"{one:.6f}" for one in row) for row in zip(*flat.values(), strict=True))
    lines = [",".join(flat), *rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def by_name(**changes):
    """Return columns with the names of the joints, some of them changed or, with None, left out."""
    one = run()
    columns = {"t_s": one.time_s, "motion": one.motion}
    for j, joint in enumerate(JOINTS):
        columns |= {f"command_{joint}": one.command[:, j], f"position_{joint}": one.position[:, j]}
        columns |= {f"velocity_{joint}": one.velocity[:, j]}
    return {name: values for name, values in (columns | changes).items() if values is not None}


def make(folder, log, model=MODEL):
    """Write a first robot file; return its joints, its questions, and the remarks of the check."""
    path = folder / "robot.toml"
    (folder / "model.xml").write_text(model)
    draft = draft_robot_file(folder / "model.xml", (log,), path, "", no_progress)
    path.write_text("\n".join(robot_file_lines(draft, "a test")))
    robot = Robot.from_toml(path)
    remarks = audit(robot, load(robot, log)).remarks
    return tomllib.loads(path.read_text())["joints"], " ".join(list_questions(draft)), remarks


def test_a_reversed_joint_is_turned_with_its_velocity(tmp_path):
    turned = {"position_elbow": -run().position[:, 1], "velocity_elbow": -run().velocity[:, 1]}
    joints, asked, remarks = make(tmp_path, write_columns(tmp_path / "log.csv", **by_name(**turned)))
    assert "the position runs against its command, so it is turned here" in asked
    factors = [joints["elbow"][key].get("factor", 1.0) for key in ("position", "velocity", "command")]
    assert factors == [-1.0, -1.0, 1.0]
    assert remarks == ()


@pytest.mark.parametrize("size", [50.0, 1.0])
def test_the_gear_of_the_actuator_is_taken_by_the_size_of_the_torques(tmp_path, size):
    geared = MOTORS.replace("<motor ", '<motor gear="50" ')
    torques = {f"torque_{joint}": run().torque[:, j] / size for j, joint in enumerate(JOINTS)}
    joints, asked, _ = make(tmp_path, write_columns(tmp_path / "log.csv", **by_name(**torques)), geared)
    assert (joints["lift"]["torque"].get("side"), joints["lift"].get("gear_ratio")) == (
        ("motor", 50.0) if size > 1.0 else (None, None)
    )
    assert ("is the torque that of the motor" in asked) == (size == 1.0)
    assert "kp_Nm_rad" not in joints["lift"]


def test_a_gain_of_the_model_is_asked_where_the_logs_contradict_it(tmp_path):
    log = write_columns(tmp_path / "log.csv", **by_name())
    _, asked, _ = make(tmp_path, log)
    assert "gain of the model" not in asked
    _, asked, _ = make(tmp_path, log, MODEL.replace('kp="20"', 'kp="500"'))
    assert "is 500 N m/rad, the gain of the model, that of the robot; the logs look like" in asked


@pytest.mark.parametrize("is_folder", [True, False])
def test_grippers_of_lerobot_are_percent_whatever_the_others_are(tmp_path, is_folder):
    one, scale = run(), (180.0 / np.pi, 20.0)
    halves = [one.motion == motion for motion in (0, 1)]
    episodes = [(scale * one.command[own], scale * one.position[own]) for own in halves]
    folder = write_lerobot(tmp_path / "set", ("lift.pos", "gripper.pos"), episodes, RATE_HZ, fps=RATE_HZ)
    log = folder if is_folder else folder / "data" / "chunk-000" / "episode_000000.parquet"
    joints, asked, _ = make(tmp_path, log, MODEL.replace('"elbow"', '"gripper"'))
    assert joints["lift"]["position"] == {"column": "observation.state[lift.pos]", "unit": "deg"}
    share = {"unit": "percent", "at_0_rad": -2.5, "at_1_rad": 2.5}
    assert joints["gripper"]["command"] == {"column": "action[gripper.pos]"} | share
    assert "joints.gripper.position: is 0..100 % the range of the model?" in asked


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_states_of_mujoco_with_a_free_base_have_commands_in_the_order_of_actuators(tmp_path, order):
    one, n = run(), run().time_s.size
    root = '<body name="root"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    free = MOTORS.replace("<worldbody>", f"<worldbody>{root}").replace("</worldbody>", "</body></worldbody>")
    if order[0]:
        first, second = (line for line in free.splitlines() if "<motor" in line)
        free = free.replace(first, "<!-- -->").replace(second, f"{second}\n{first}")
    qpos, qvel = np.hstack([np.ones((n, 7)), one.position]), np.hstack([np.ones((n, 6)), one.velocity])
    np.savez(tmp_path / "log.npz", time=one.clock_s, ctrl=one.torque[:, order], qpos=qpos, qvel=qvel)
    joints, _, _ = make(tmp_path, tmp_path / "log.npz", free)
    assert joints["lift"]["mode"] == "torque"
    columns = [joints["lift"][key]["column"] for key in ("position", "velocity", "command")]
    assert columns == ["qpos[7]", "qvel[6]", f"ctrl[{order.index(0)}]"]


def test_commanded_currents_without_a_constant_are_asked(tmp_path):
    currents = {f"current_cmd_{joint}": run().torque[:, j] for j, joint in enumerate(JOINTS)}
    columns = by_name(**currents, command_lift=None, command_elbow=None)
    joints, asked, _ = make(tmp_path, write_columns(tmp_path / "log.csv", **columns))
    assert (joints["lift"]["mode"], joints["lift"]["torque_constant_Nm_A"]) == ("current", 1.0)
    assert "what torque at the joint is 1 A?" in asked


def test_what_never_changes_is_no_signal(tmp_path):
    zeros = {f"/joint_states/effort/{j}": np.zeros(800) for j in (0, 1)}
    names = {"/joint_states/position/{}": run().position, "/joint_command/position/{}": run().command}
    log = write_columns(tmp_path / "log.csv", __time=run().clock_s, **names, **zeros)
    joints, asked, _ = make(tmp_path, log)
    assert set(joints["lift"]) == {"mode", "command", "position"}
    assert "is lift, elbow the order of the joints" in asked


def test_a_zero_that_is_off_by_half_a_turn_is_taken_and_asked(tmp_path):
    moved = {f"{key}_lift": by_name()[f"{key}_lift"] + np.pi for key in ("command", "position")}
    joints, asked, remarks = make(tmp_path, write_columns(tmp_path / "log.csv", **by_name(**moved)))
    assert [joints[one]["position"]["unit"] for one in JOINTS] == ["rad", "rad"]
    assert [joints[one]["position"].get("zero_rad", 0.0) for one in JOINTS] == [-3.141593, 0.0]
    assert "is the zero of the log another one" in asked
    assert remarks == ()


def test_records_with_names_give_the_joint_in_any_order(tmp_path):
    one, lines = run(), []
    for k, time_s in enumerate(one.clock_s):
        own = [{"name": JOINTS[j], "pos": one.position[k, j], "target": one.command[k, j]} for j in (1, 0)]
        lines.append(json.dumps({"time": time_s, "joints": own}))
    (tmp_path / "log.jsonl").write_text("\n".join(lines))
    joints, asked, _ = make(tmp_path, tmp_path / "log.jsonl")
    assert [joints[name]["position"]["column"] for name in JOINTS] == ["joints[1].pos", "joints[0].pos"]
    assert "order" not in asked


def test_names_of_another_robot_are_taken_in_order_and_asked(tmp_path):
    others = {name.replace("lift", "hip").replace("elbow", "knee"): one for name, one in by_name().items()}
    joints, asked, _ = make(tmp_path, write_columns(tmp_path / "log.csv", **others))
    assert [joints[name]["command"]["column"] for name in JOINTS] == ["command_hip", "command_knee"]
    assert "is lift, elbow the order of the joints in command_hip, command_knee" in asked


@pytest.mark.parametrize("pause_s", [4.0, 3600.0])
def test_a_log_with_pauses_is_cut_there(tmp_path, pause_s):
    clock_s = run().clock_s + pause_s * run().motion
    _, _, remarks = make(tmp_path, write_columns(tmp_path / "log.csv", **by_name(t_s=clock_s, motion=None)))
    windows_s = tomllib.loads((tmp_path / "robot.toml").read_text())["motion"]["windows_s"]
    assert windows_s == {"part1": [0.0, 3.99], "part2": [4.0 + pause_s, 7.99 + pause_s]}
    assert remarks == ()


def test_a_column_of_repeats_is_found_where_the_time_goes_on(tmp_path):
    again = {"t_s": run().clock_s, "repeat": np.repeat([2.0, 1.0], 400)}
    make(tmp_path, write_columns(tmp_path / "log.csv", **by_name(**again)))
    assert tomllib.loads((tmp_path / "robot.toml").read_text())["motion"]["repeat_column"] == "repeat"


def test_what_cannot_be_simulated_is_asked_or_left_out(tmp_path):
    ball = '<body><joint name="head" type="ball"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    tendon = '<tendon><fixed name="T"><joint joint="lift" coef="1"/></fixed></tendon>'
    model = MODEL.replace("</worldbody>", f"{ball}</worldbody>{tendon}")
    model = model.replace('<position name="lift" joint="lift"', '<position name="pull" tendon="T"')
    _, asked, _ = make(tmp_path, write_columns(tmp_path / "log.csv", **by_name()), model)
    assert "the model drives it by pull through a tendon, which is not simulated" in asked
    assert tomllib.loads((tmp_path / "robot.toml").read_text())["left_out"] == ["head"]


def test_a_joint_that_texts_name_is_asked(tmp_path):
    log = write_columns(tmp_path / "log.csv", **by_name())
    rows = [line.split(",") for line in log.read_text().splitlines()]
    column = rows[0].index("position_elbow")
    for row in rows[1:]:
        row[column] = "is " + row[column]
    log.write_text("\n".join(map(",".join, rows)))
    _, asked, _ = make(tmp_path, log)
    assert "position_elbow holds texts: are they numbers?" in asked


def test_a_turn_has_the_fewest_counts_with_which_positions_lie_within_the_model(tmp_path):
    columns = {name: one for name, one in by_name().items() if name[:3] in ("com", "pos")}
    counts = {name: np.round(one * 2**16 / np.pi) for name, one in columns.items()}
    log = write_columns(tmp_path / "log.csv", **by_name(**counts, velocity_lift=None, velocity_elbow=None))
    joints, asked, _ = make(tmp_path, log)
    ends = {"lift": 2.0, "elbow": 2.5}
    share = max(np.abs(one).max() / ends[name.split("_")[1]] for name, one in counts.items())
    turn = joints["lift"]["position"]["counts_per_turn"]
    assert turn / 2 < 2.0 * np.pi * share <= turn
    assert f"is a turn {turn} counts?" in asked
