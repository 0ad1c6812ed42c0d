"""`simgap diagnose`: its page, its files, an interrupted command that goes on, and poses of a tracker."""

import json
import re
import signal
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from helpers import verdicts
from helpers.arm_folder import ROBOT, write_arm
from helpers.command import run_python, run_simgap
from helpers.pendulum import at_swing, motion, pendulum, simulated, waves
from helpers.serial_synthetic import MAPPING, POSITION_M, write
from simgap.command import diagnosis
from simgap.command.request import DiagnoseRequest
from simgap.common.errors import BadRequest, RobotError
from simgap.common.report import print_parts
from simgap.effects.actuation import GainError
from simgap.loading import load
from simgap.report.traces import choose_traces, make_traces
from simgap.selection.checkpoint import GOES_ON
from simgap.serial_arm.files import read_arm
from simgap.serial_arm.model import TERMS


def made(tmp_path, result=verdicts.FOUND, traces=True):
    request = DiagnoseRequest(tmp_path / "robot.toml", (tmp_path / "log.parquet",))
    shown = make_traces(verdicts.Drawn(), result) if traces else ()
    return diagnosis.RobotDiagnosis(request, result, shown, None, {"robot": "0" * 64})


def text_of(tmp_path, **changes):
    diagnosis.save_page_of(made(tmp_path, **changes), tmp_path / "page.html")
    return (tmp_path / "page.html").read_text()


def test_the_page_opens_with_the_four_lines_then_the_origin(tmp_path):
    text = text_of(tmp_path)
    verdict = re.search(r'<dl class="verdict">(.*?)</dl>', text, re.S)[1]
    assert re.findall("<dt>(.*?)</dt>", verdict) == ["Where", "What", "How far", "Next"]
    assert "<dd>lift.</dd>" in verdict
    assert text.index(verdict) < text.index('<dl class="origin">') < text.index("<h2>Which effects</h2>")
    assert "simgap diagnose" in text


def test_the_page_asks_for_nothing(tmp_path):
    assert not re.search(r"<img|<link|url\(|\ssrc=|https?://(?!www\.w3\.org/2000/svg)", text_of(tmp_path))


def test_each_joint_has_a_figure_with_the_worst_the_middle_and_the_best_motion(tmp_path):
    chosen = choose_traces(make_traces(verdicts.Drawn(), verdicts.FOUND))
    assert [*chosen] == [("pan", "simulation"), ("lift", "simulation")]
    assert {"".join(one.motion for one in own) for own in chosen.values()} == {"ged"}
    text = text_of(tmp_path)
    assert text.count('<figure class="traces"') == 2
    motions = json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.S)[1])
    assert len(motions) == 3
    panels = motions[0]["panels"]
    assert list(panels[0]["series"]) == ["measured", "nominal", "explained"]
    assert list(panels[1]["series"]) == ["nominal", "explained"]


def test_a_long_trace_is_thinned_and_the_page_stays_small(tmp_path):
    long = replace(made(tmp_path), traces=make_traces(verdicts.Drawn(20000), verdicts.FOUND))
    diagnosis.save_page_of(long, tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size < 1_000_000


def test_remarks_on_the_logs_stand_on_the_page(tmp_path):
    text = text_of(tmp_path, result=replace(verdicts.FOUND, remarks=("log.csv: is cut at line 9.",)))
    assert text.index("Remarks on the logs</h2>") < text.index("log.csv: is cut at line 9.")


def test_a_name_from_a_log_cannot_break_out_of_the_page(tmp_path):
    evil = "</script><script>alert(1)</script>"
    refused = (replace(verdicts.REFUSED[0], motion=evil),)
    result = replace(verdicts.FOUND, errors=(replace(verdicts.PAN, joint=evil),), refused=refused)
    assert "<script>alert" not in text_of(tmp_path, result=result)


def test_a_page_without_held_out_motions_or_floor_says_so(tmp_path):
    fitted = replace(verdicts.FOUND, judged_motions=(), errors=(verdicts.without_floor(verdicts.LIFT),))
    text = text_of(tmp_path, result=fitted)
    assert "the fitted motions: none was held out" in text
    assert "No repeated motion shows the noise floor" in text
    assert 'class="floor"' not in text


def test_bars_and_traces_begin_with_the_error_that_is_largest_over_its_noise(tmp_path):
    errors = tuple(replace(one, kind="simulation") for one in (verdicts.PAN, verdicts.LIFT))
    text = text_of(tmp_path, result=replace(verdicts.FOUND, errors=errors))
    assert re.findall("<h3>(.*?)</h3>", text) == ["lift", "pan", "lift", "pan"]
    unknown = tuple(map(verdicts.without_floor, errors))
    text = text_of(tmp_path, result=replace(verdicts.FOUND, errors=unknown))
    assert re.findall("<h3>(.*?)</h3>", text) == ["pan", "lift", "pan", "lift"]


def test_the_screen_has_the_four_lines_then_the_details(tmp_path, capsys):
    print_parts(diagnosis.diagnosis_parts(made(tmp_path)))
    shown = " ".join(capsys.readouterr().out.split())
    assert shown.startswith("Where: lift. What: Coulomb friction at lift")
    assert "Without it, 80 % of the explainable error of its joint comes back." in shown


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("arm")
    write_arm(place)
    return place


def request(folder, **changes):
    return DiagnoseRequest(folder / "robot.toml", (folder / "log.parquet",), **changes)


def test_a_request_is_diagnosed_and_its_files_are_written_last(folder, monkeypatch):
    options_seen = {}

    def find(robot, motions, **options):
        options_seen.update(options, motions=motions)
        options["progress"](0.5, "half")
        return verdicts.diagnosis(effects=(), sizes=(), judged_motions=("motion 3",))

    logs = load(folder / "robot.toml", folder / "log.parquet", held_out=["motion 3"])
    cut = replace(logs, losses=("is cut",))
    monkeypatch.setattr(diagnosis, "load", lambda *_, **__: cut)
    monkeypatch.setattr(diagnosis, "diagnose", find)
    reports = []
    files = {"report": folder / "page.html", "patch": folder / "found"}
    result = diagnosis.diagnose_robot(
        request(folder, held_out=("motion 3",), seed=7, **files), lambda *said: reports.append(said)
    )
    assert [motion.name for motion in options_seen["motions"]] == ["motion 0", "motion 1", "motion 2"]
    assert [motion.name for motion in options_seen["held_out"]] == ["motion 3"]
    assert options_seen["seed"] == 7
    assert any(one.reason == "contact with a plane" for one in options_seen["audit"].refused)
    assert reports[-1][2] == "half"
    assert result.diagnosis.remarks[0] == "is cut."
    assert "is cut." in diagnosis.diagnosis_json(result)["remarks"]
    assert not any(path.exists() for path in files.values())
    written = [f"report    {files['report']}", f"patch     {files['patch']}"]
    assert diagnosis.save_diagnosis_files(result) == written
    assert (folder / "found" / "patched.xml").is_file()
    assert files["report"].read_text().count('<figure class="traces"') == 2


SWING = """
[joints.swing]
mode = "position"
kp_Nm_rad = 4.0
kd_Nms_rad = 0.1
command = { column = "command", unit = "rad" }
position = { column = "position", unit = "rad" }
"""
WORDS = ("diagnose", "robot.toml", "log.parquet", "--json")
WAIT_s = 300.0


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """Return a folder with a pendulum and three short motions of it."""
    place = tmp_path_factory.mktemp("pendulum")
    robot, time_s = pendulum(), 0.02 * np.arange(100)
    (place / "model.xml").write_text(robot.model_xml)
    (place / "robot.toml").write_text(ROBOT.replace('tool_site = "tip"\n', "") + SWING)
    columns: dict[str, list[float | str]] = {"t": [], "motion": [], "command": [], "position": []}
    for k in range(3):
        command = waves(time_s, k)
        position = simulated(robot, motion(time_s, command, command), (at_swing(GainError, robot), [0.2]))
        for name, values in zip(columns, (time_s, [f"motion {k}"] * 100, command, position), strict=True):
            columns[name].extend(values)
    pq.write_table(pa.table(columns), place / "log.parquet")
    return place


def steps(cache):
    return sorted(cache.glob("simgap/steps/*/*.npz"))


ENDING = """
import os, signal, sys
from simgap.selection.checkpoint import Checkpoint
from simgap.__main__ import start

keep = Checkpoint._write

def keep_and_end(*args):
    keep(*args)
    os.kill(os.getpid(), signal.SIGINT)

Checkpoint._write = keep_and_end
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background of a shell ignore it
start()
"""


def run_apart(folder, cache, *start):
    """Run a diagnosis to its end, or as a program says."""
    words = (*(start or ("-m", "simgap")), *WORDS)
    return run_python(folder, *words, timeout_s=WAIT_s, XDG_CACHE_HOME=str(cache))


def test_base_parameters_alone_are_fitted_without_the_catalogue(swinging, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    files = ("--report", str(tmp_path / "page.html"), "--patch", str(tmp_path / "found"))
    done = run_simgap(swinging, *WORDS, "--terms", "none", *files)
    found = json.loads(done.stdout)
    assert (tmp_path / "found" / "patched.xml").is_file()
    assert '<figure class="traces"' in (tmp_path / "page.html").read_text()
    assert (found["findings"], found["verdict"], steps(tmp_path)) == ([], "unknown", [])
    (error,) = found["errors"]
    assert error["base"] < 0.01 * error["nominal"]
    (gain,) = [one["value"] for one in found["base"] if one["name"] == "gain_ratio"]
    assert gain == pytest.approx(0.2, abs=0.01)
    from_there = ("--start", str(tmp_path / "found"), "--report", str(tmp_path / "again.html"))
    again = run_simgap(swinging, *WORDS, "--terms", "none", *from_there)
    pages = [(tmp_path / name).read_text() for name in ("page.html", "again.html")]
    assert [page.count("</i>model as it is<") for page in pages] == [2, 0]
    assert [page.count("</i>earlier result<") for page in pages] == [0, 2]
    assert again.returncode == 0, again.stderr
    (started,) = json.loads(again.stdout)["errors"]
    assert started["nominal"] == pytest.approx(error["base"], rel=0.1)
    back = ("--start", str(tmp_path), "--patch", str(tmp_path))
    assert "this is the file of start too" in run_simgap(swinging, *WORDS, *back).stderr


@pytest.mark.slow
def test_an_interrupted_command_goes_on_and_prints_the_same_document(swinging, tmp_path):
    whole = run_apart(swinging, tmp_path / "other")
    assert whole.returncode == 0, whole.stderr
    ended = run_apart(swinging, tmp_path, "-c", ENDING)
    assert (ended.returncode, ended.stderr.count(GOES_ON)) == (128 + signal.SIGINT, 1)
    assert len(steps(tmp_path)) == 1
    last = run_apart(swinging, tmp_path)
    assert json.loads(last.stdout) == json.loads(whole.stdout)
    assert last.stdout == whole.stdout
    assert steps(tmp_path) == []


TRACKED = 'name = "made up"\nserial_arm = "arm.toml"\n[poses]\n"poses.csv" = "mapping.toml"\n'


def write_robot(folder):
    """Write arm, poses, mapping and robot file."""
    write(folder)
    (folder / "robot.toml").write_text(TRACKED)


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """Run the command with all its files; return its folder and its result."""
    folder = tmp_path_factory.mktemp("tracker")
    write_robot(folder)
    options = ("--patch", "found", "--report", "page.html", "--json")
    return folder, run_simgap(folder, "diagnose", "robot.toml", "poses.csv", *options)


def test_the_document_names_effects_at_joints(ended):
    _, done = ended
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["kind"] == "tracker"
    assert {one["effect"] for one in document["findings"]} >= {"periodic joint error"}


def test_the_patched_arm_has_the_effects_and_says_where_it_is_from(ended):
    folder, _ = ended
    patched = folder / "found" / "arm.toml"
    assert "poses.csv sha256" in patched.read_text()
    before, after = read_arm(folder / "arm.toml"), read_arm(patched)
    assert [one.name for one in after.links] == [one.name for one in before.links]
    assert after.links != before.links


def test_the_terms_and_the_whole_calibration_are_in_the_document(ended):
    folder, done = ended
    found = json.loads(done.stdout)["calibration"]
    assert [one["terms"][-1] for one in found["models"][1:]] == list(TERMS)
    worth = {one["terms"][-1]: one["significant"] for one in found["models"][1:]}
    assert worth["geometry"]
    assert worth["periodic"]
    held_out = [one["held_out_rms_m"] for one in found["models"]]
    assert found["held_out_rms_m"] == held_out[-1] < 0.5 * held_out[1] < 0.5 * held_out[0]
    assert found["temperature"]["explains"] == "nothing"
    assert found["fit"]["converged"]
    links = read_arm(folder / "arm.toml").links
    assert [one["name"] for one in found["joints"]] == [one.name for one in links]


def test_a_calibrated_arm_is_judged_again_without_terms(ended):
    folder, _ = ended
    (folder / "again.toml").write_text(TRACKED.replace("arm.toml", "found/calibrated.toml"))
    done = run_simgap(folder, "diagnose", "again.toml", "poses.csv", "--terms", "none", "--json")
    document = json.loads(done.stdout)
    assert document["findings"] == document["base"] == []
    assert document["calibration"]["held_out_rms_m"] < 1.2 * POSITION_M * 3**0.5


def test_nested_shows_what_each_term_explains(ended):
    words = ("--terms", "geometry,periodic", "--fit-share", "0.4", "--nested")
    done = run_simgap(ended[0], "diagnose", "robot.toml", "poses.csv", *words)
    assert "120 poses fitted, 180 held out" in done.stdout
    assert re.findall(r"^│ \+ (\w+)", done.stdout, re.M) == ["geometry", "periodic"]
    assert "hysteresis" in done.stdout


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"split": "fit_a"}, BadRequest, "split: is for logs"),
        ({"held_out": ("poses.csv",)}, BadRequest, "held-out: is for logs"),
        ({"logs": ("poses.csv", "poses.csv")}, BadRequest, "logs: 2 tables of poses; give one"),
        ({"logs": ("others.csv",)}, RobotError, "poses: has no mapping for others.csv; has poses.csv"),
        ({"terms": "geometri"}, BadRequest, "terms: 'geometri' is not known; there are geometry"),
        ({"terms": "all,periodic"}, BadRequest, "all and none stand alone"),
        ({"fit_share": 0.01}, BadRequest, "fit-share: 0.01 is not within 0.05 .. 0.95"),
        ({"patch": "."}, BadRequest, "this is the file of serial_arm too"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_writes_nothing(tmp_path, changes, error, words):
    write_robot(tmp_path)
    before = {one.name: one.read_bytes() for one in tmp_path.iterdir()}
    logs = tuple(tmp_path / name for name in changes.pop("logs", ("poses.csv",)))
    paths = {key: tmp_path / value if key == "patch" else value for key, value in changes.items()}
    with pytest.raises(error, match=re.escape(words)):
        diagnosis.diagnose_robot(DiagnoseRequest(tmp_path / "robot.toml", logs, **paths))
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('"made up"', '"UR10"'), "its table is of the arm 'UR10'"),
        (('"joint2"]', '"joint2", "air"]'), "joints: 4 columns; the arm made up has 3 joints"),
    ],
)
def test_a_wrong_mapping_is_one_sentence(tmp_path, change, words):
    write_robot(tmp_path)
    (tmp_path / "mapping.toml").write_text(MAPPING.replace(*change))
    with pytest.raises(RobotError, match=re.escape(words)):
        diagnosis.diagnose_robot(DiagnoseRequest(tmp_path / "robot.toml", (tmp_path / "poses.csv",)))
