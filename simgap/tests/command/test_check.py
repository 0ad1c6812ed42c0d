"""`simgap check` on the screen, in JSON and on its page."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from helpers.arm_folder import columns_of, write_arm, write_logs
from helpers.command import run_simgap
from helpers.message_logs import BY_TOPIC, rows, write_bag, write_mcap
from helpers.planar_arm import TABLE_M, planar_arm, slow_logs
from helpers.robot_folder import write_robot
from simgap.command.check import check_parts, check_robot, drawn_motions, summarize_joints
from simgap.command.first_file import list_logs
from simgap.command.request import CheckRequest
from simgap.common.files import file_sha256
from simgap.common.report import ReportTable, print_parts
from simgap.logs import Logs, Signal

SCREEN_LINES = 24


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    write_arm(folder)
    return folder


@pytest.fixture(scope="module")
def report(folder):
    return check_robot(CheckRequest(folder / "robot.toml", (folder / "log.parquet",)))


@pytest.fixture(scope="module")
def written(folder):
    """Return the document and the page that the command writes."""
    done = run_simgap(folder, "check", "robot.toml", "log.parquet", "--report", "check.html", "--json")
    assert done.returncode == 0
    return json.loads(done.stdout), (folder / "check.html").read_text()


def test_the_screen_has_a_line_for_each_joint_and_the_remarks(report, capsys):
    print_parts(check_parts(report))
    printed = capsys.readouterr().out
    lines = printed.splitlines()
    assert len(lines) <= SCREEN_LINES
    assert len([line for line in lines if re.match(r"│ (shoulder|elbow) +│ +50 ", line)]) == 2
    words = " ".join(printed.split())
    assert "contact with a plane: tip stops at z = -100 mm" in words
    assert "A diagnosis will leave out" in words


def test_a_column_of_numbers_is_not_wrapped(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "24")
    row = ("a joint with a long name", "12.3 mrad", "4.5 to 6.7 mrad")
    print_parts([ReportTable(("joint", "error", "90 %"), [row])])
    shown = capsys.readouterr().out
    assert row[1] in shown
    assert row[2] in shown


def test_the_document_has_what_the_screen_has(written):
    document, _ = written
    (remark,) = document["remarks"]
    assert remark["kind"] == "contact with a plane"
    assert remark["value"] == pytest.approx(TABLE_M, abs=0.005)
    assert {one["reason"] for one in document["refused"]} == {"contact with a plane"}
    assert [one["name"] for one in document["joints"]] == ["shoulder", "elbow"]
    assert document["motions"] == [f"motion {k}" for k in range(4)]


def test_a_check_says_that_a_diagnosis_will_refuse_the_logs(folder):
    logs = slow_logs(planar_arm(), count=2)
    write_logs(folder / "degrees.parquet", logs, command_elbow=np.degrees(columns_of(logs)["command_elbow"]))
    done = run_simgap(folder, "check", "robot.toml", "degrees.parquet")
    assert done.returncode == 3
    words = " ".join(done.stdout.split())
    said = "A diagnosis will refuse these logs: joint elbow: unit looks wrong; the position is 0.0173 times"
    assert said in words


def test_radians_that_are_read_as_degrees_at_every_joint_are_a_question(folder):
    text = (folder / "robot.toml").read_text()
    assert text.count('unit = "rad"') == 4
    (folder / "wrong.toml").write_text(text.replace('unit = "rad"', 'unit = "deg"'))
    done = run_simgap(folder, "check", "wrong.toml", "log.parquet")
    words = " ".join(done.stdout.split())
    assert "degrees in a motion: are the positions in radians?" in words
    assert "in radians?" not in run_simgap(folder, "check", "robot.toml", "log.parquet").stdout


def test_a_model_in_place_of_the_robot_file_is_refused_with_the_command_that_makes_one(folder):
    done = run_simgap(folder, "check", "model.xml", "log.parquet")
    assert done.returncode == 2
    assert done.stderr.endswith("give a robot file, which `simgap init model.xml LOGS` writes\n")


@pytest.mark.parametrize("name", ["set", "bag"])
def test_a_folder_is_a_log_whose_files_have_one_digest(tmp_path, name):
    robot = write_robot(tmp_path, text=BY_TOPIC)
    if name == "bag":
        write_bag(tmp_path / name, rows())
    else:
        (tmp_path / name).mkdir()
        write_mcap(tmp_path / name / "log.mcap", rows())
    log = tmp_path / name
    digest = check_robot(CheckRequest(robot, (log,))).digests[f"log {log}"]
    assert digest == file_sha256(log)
    (log / "notes.txt").write_text("other")
    assert digest != file_sha256(log)


def test_a_check_of_logs_without_commands_says_what_a_diagnosis_lacks(folder, tmp_path):
    logs = slow_logs(planar_arm(), count=2)
    write_arm(tmp_path)
    text = re.sub("command = .*", "", (tmp_path / "robot.toml").read_text())
    (tmp_path / "robot.toml").write_text(text)
    write_logs(tmp_path / "log.parquet", logs)
    report = check_robot(CheckRequest(tmp_path / "robot.toml", (tmp_path / "log.parquet",)))
    said = "the logs have no command, torque or second encoder; a diagnosis needs one of them"
    assert report.refusal == said


def test_the_nominal_model_differs_from_the_logs_only_at_the_table(report):
    usable = report.audit.is_usable("motion 0", "elbow")
    nominal, motion = report.nominal[0], report.logs.motions[0]
    error = np.abs(nominal.position["elbow"] - motion.joints["elbow"].position.value)
    first = int(np.flatnonzero(~usable)[0])
    assert error[:first].max() < 0.02 < error[~usable].max()
    shoulder, _ = summarize_joints(report)
    errors = [one.mean_abs_rad["shoulder"] for one in report.nominal]
    assert shoulder.nominal_mean_abs_rad == pytest.approx(np.mean(errors))


def test_a_motion_that_is_too_short_to_be_simulated_does_not_hide_the_error_of_the_others(tmp_path):
    whole, other = slow_logs(planar_arm(), count=2).motions
    joints = {
        name: replace(
            log,
            position=Signal(log.position.time_s[:3], log.position.value[:3]),
            command=Signal(log.command.time_s[:3], log.command.value[:3]),
        )
        for name, log in other.joints.items()
    }
    write_arm(tmp_path)
    write_logs(tmp_path / "log.parquet", Logs((whole, replace(other, joints=joints))))
    report = check_robot(CheckRequest(tmp_path / "robot.toml", (tmp_path / "log.parquet",)))
    assert [one.is_simulated for one in report.nominal] == [True, False]
    for joint in summarize_joints(report):
        assert joint.nominal_mean_abs_rad == report.nominal[0].mean_abs_rad[joint.name]


def test_motions_of_remarks_are_drawn_first(report):
    worst = max(report.audit.refused, key=lambda one: one.n_samples)
    first = drawn_motions(report)[0]
    assert report.logs.motions[first].name == worst.motion


def test_the_page_draws_each_joint_and_asks_for_nothing(written):
    _, text = written
    assert text.count('<figure class="traces"') == 2
    assert not re.search(r"<img|<image|data:image|<link|url\(['\"]?http|src=", text)
    assert text.index("Remarks, the worst first") < text.index("<figure ") < text.index("Rates</h2>")
    (motions, _) = map(json.loads, re.findall(r'<script type="application/json">(.*?)</script>', text))
    assert len(motions) == 4
    position, error = motions[0]["panels"]
    assert list(position["series"]) == ["refused", "measured", "nominal", "command"]
    assert list(error["series"]) == ["nominal"]
    assert error["unit"] == "mrad"
    assert "simgap check robot.toml log.parquet" in text


def test_a_list_has_the_rate_of_each_column_of_a_table_or_says_why_not(tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{20 * k},{k},{k if k % 5 == 0 else ''}" for k in range(20)]
    path.write_text("\n".join(["t_ms,q,q_cmd", *rows]))
    (log,) = list_logs(CheckRequest(path))
    assert [one.rate_Hz for one in log.columns] == pytest.approx([50.0, 50.0, 10.0])
    path.write_text("\n".join(["t_ms,q,q_cmd", *rows, *rows[-2:]]))
    (log,) = list_logs(CheckRequest(path))
    assert [one.rate_Hz for one in log.columns] == [None] * 3
    assert log.losses[0].startswith("the time 't_ms' does not increase at row 21")


def test_the_help_shows_an_example(tmp_path):
    done = run_simgap(tmp_path, "check", "--help")
    assert "Example: simgap check" in " ".join(done.stdout.split())
