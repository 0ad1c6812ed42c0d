"""Request of a diagnosis, its logs and tables; findings as a patch and as parameters; the demonstration."""

import json
import re
from collections import Counter, deque, namedtuple
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import IDENTITY, stack_poses
from marsarm.common.requests import parse_effects
from marsarm.diagnosis.arm import demo, diagnose_logs, record
from marsarm.diagnosis.arm import logs as load_logs
from marsarm.diagnosis.arm.arm_effects import FAMILIES, effects_of_params, list_hypotheses
from marsarm.diagnosis.arm.audit import load_checked_recordings
from marsarm.diagnosis.arm.campaign_sensitivities import campaign_digest
from marsarm.diagnosis.arm.demo import SIZES, DemoTruth, draw_truth, judge
from marsarm.diagnosis.arm.diagnose_logs import diagnose, effects_of_findings, params_text, patch_text
from marsarm.diagnosis.arm.logs import NotForDiagnosis, TrackerPoses, read_tracker_poses, write_tracker_poses
from marsarm.diagnosis.arm.request import DemoRequest, DiagnoseRequest, RecordRequest
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.problem import Hypothesis
from sim.arm_model.load import default_arm
from sim.arms import arm_named, nominal_params, params_over_nominal
from sim.diagnosis_campaign import (
    DiagnosisSession,
    SessionFailed,
    campaign_sessions,
    run_session,
    start_session,
)
from sim.effects.effect import params_with_effects
from sim.effects.joints import GearStiffness
from sim.initialisation import true_reference
from sim.params import params_table
from simgap.common.errors import BadRequest, RobotError
from simgap.common.progress import no_progress
from simgap.report.sentences import level
from tests.marsarm.command import marsarm
from tests.marsarm.diagnosis.worlds import indices
from tests.tools import TOOLS


@pytest.fixture
def folder(tmp_path):
    """Create two empty logs, and one elsewhere."""
    for name in ("logs", "empty"):
        (tmp_path / name).mkdir()
    for name in ("logs/b.mcap", "logs/a.mcap", "logs/a.tracker.csv", "other.mcap"):
        (tmp_path / name).write_text(name)
    return tmp_path


def test_a_folder_is_all_logs_in_it(folder):
    logs = diagnose_logs.expand_logs((folder / "logs", folder / "other.mcap"), "log")
    assert [path.name for path in logs] == ["a.mcap", "b.mcap", "other.mcap"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"held_out": (Path("n" * 300),)}, "held-out log n*: no such log or folder"),
        ({"held_out": (Path("/dev/null"),)}, "held-out log /dev/null: is not a regular file; give a log or"),
        ({"campaign": Path("none")}, "campaign none: there is no such folder"),
        ({"patch": Path("logs/flight-params.toml")}, "is the file of flight parameters of these logs"),
    ],
)
def test_what_is_wrong_is_refused(folder, monkeypatch, options, said):
    """The tests of bad input have what is wrong with logs and with names of effects."""
    monkeypatch.chdir(folder)
    with pytest.raises(BadRequest, match=said):
        diagnose(DiagnoseRequest((Path("logs"),), **options))


def diagnosed(results, key, value):
    """Return a diagnosis of the effect of this key, whose first parameter has this value."""
    (one,) = (one for one in list_hypotheses() if one.key == key)
    first = one.parameters[0]
    return replace(results["alike"], effects=(one,), sizes=(((value - first.neutral) / first.typical,),))


def test_a_finding_of_its_size_is_switched_on_by_the_patch_and_known_to_flight_parameters(results, tmp_path):
    softer = diagnosed(results, "elbow: gear-stiffness", float(np.log(0.8)))
    assert effects_of_findings(softer) == (GearStiffness(Joint.ELBOW, pytest.approx(0.8)),)
    (tmp_path / "found.toml").write_text(patch_text(softer))
    assert parse_effects((str(tmp_path / "found.toml"),), TOOLS) == effects_of_findings(softer)
    (tmp_path / "new.toml").write_text(params_text(softer, nominal_params(), nominal_params()))
    read = params_over_nominal(tmp_path / "new.toml")
    softened = nominal_params().joints.elbow.gear_stiffness_Nm_rad * 0.8
    assert read.joints.elbow.gear_stiffness_Nm_rad == pytest.approx(softened)


def test_without_a_name_or_a_flight_parameter_there_is_no_file(results):
    with pytest.raises(diagnose_logs.NothingToWrite, match="no effect was found"):
        patch_text(results["unknown"])
    with pytest.raises(diagnose_logs.NothingToWrite, match="no flight parameter for coulomb-friction:elbow"):
        params_text(diagnosed(results, "elbow: coulomb-friction", 5.0), nominal_params(), nominal_params())


def numbers(table: object) -> list[float]:
    if isinstance(table, dict):
        return [x for value in table.values() for x in numbers(value)]
    if isinstance(table, list | tuple):
        return [x for value in table for x in numbers(value)]
    return [float(table)] if isinstance(table, int | float) else []


@pytest.mark.parametrize("seed", [1, 2, 7])
def test_the_parameters_of_a_calibrated_arm_come_back_from_its_effects(seed):
    params = arm_named(f"calibrated:{seed}").params
    found = params_with_effects(effects_of_params(params, nominal_params()), nominal_params())
    for one, other in zip(found.links.in_order(), params.links.in_order(), strict=True):
        X, Y = transform6_to_pose(one.transform), transform6_to_pose(other.transform)
        np.testing.assert_allclose(X.R, Y.R, atol=1e-12)
        np.testing.assert_allclose(X.p, Y.p, atol=1e-12)
        atol = 1e-6 * np.max(np.abs(other.compliance))
        np.testing.assert_allclose(one.compliance, other.compliance, atol=atol)
        np.testing.assert_allclose(one.far.com_m, other.far.com_m, atol=1e-9)
        np.testing.assert_allclose(one.near.com_m, other.near.com_m, atol=1e-6)
        masses = [(link.near.mass_kg, link.far.mass_kg) for link in (one, other)]
        np.testing.assert_allclose(*masses, rtol=1e-12)
    ours, theirs = (numbers(params_table(one)["joints"]) for one in (found, params))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    assert [*effects_of_params(nominal_params(), nominal_params())] == []
    rigid = replace(
        params, joints=replace(params.joints, elbow=replace(params.joints.elbow, backlash_rad=0.0))
    )
    assert [*effects_of_params(rigid, rigid)] == []


def test_logs_of_a_calibrated_arm_are_diagnosed_with_the_parameters_beside_them(tmp_path):
    words = ("--out", "logs", "--arm", "calibrated:7", "--sessions", "poses-level-[15]", "--json")
    named = json.loads(marsarm(tmp_path, "gap", "record", *words).stdout)["logs"]
    assert named == ["logs/poses-level-1.mcap", "logs/held-out/poses-level-5.mcap"]
    logs = [tmp_path / path for path in named]
    known = arm_named("calibrated:7").params
    assert params_over_nominal(tmp_path / "logs" / record.PARAMS_FILE) == known
    request = DiagnoseRequest((tmp_path / "logs",))
    assert diagnose_logs._read_params(request, tmp_path / "logs", default_arm()) == known
    assert load_checked_recordings(logs, known)[0].params == known
    with pytest.raises(NotForDiagnosis, match=r"^2 of 2 logs were made with other flight parameters[^\n]*$"):
        load_checked_recordings(logs, nominal_params())


def test_every_candidate_has_one_family():
    count = Counter(kind for kinds in FAMILIES.values() for kind in kinds)
    assert set(count.values()) == {1}
    every = [*list_hypotheses()]
    assert {one.entry.kind for one in every if one.entry is not None} == set(count)
    assert {one.family for one in every} == set(FAMILIES)


def truth(kind: str, model: DiagnosisModel, h: int) -> DemoTruth:
    one = model.sensitivities.hypotheses[h]
    return DemoTruth("00", kind, one.name, one.place, "", 2.0, ())  # type: ignore[arg-type]


@pytest.fixture
def locations(campaign):
    """List the locations of all hypotheses."""
    return [one.location for one in campaign.sensitivities.hypotheses]


def test_the_same_seed_draws_the_same(campaign, monkeypatch):
    monkeypatch.setattr(Hypothesis, "switch_on", lambda *_: GearStiffness(Joint.ELBOW, 0.9))
    draws = [draw_truth(campaign, np.random.default_rng(k)) for k in range(16)]
    again = [draw_truth(campaign, np.random.default_rng(k))[0] for k in range(16)]
    assert [one for one, _ in draws] == again
    assert {one.kind for one in again} == {"none", "known", "left out"}
    for one, effects in draws:
        assert len(effects) == len(one.background) + (one.kind != "none")
        assert one.kind == "none" or 0.9 * SIZES[0] <= one.times_limit <= SIZES[1]
    assert len({one.digest() for one in again}) == 16


@pytest.mark.parametrize("is_late", [False, True])
def test_a_demonstration_fills_an_empty_cache_or_takes_what_another_has_recorded(
    tmp_path, monkeypatch, is_late
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "marsarm" / "gap-demo" / campaign_digest((), (), "nominal")[:16]
    folder.mkdir(parents=True)

    def record_logs(request: RecordRequest, progress: object) -> None:
        (request.out / "cold.mcap").touch()
        if is_late:
            raise BadRequest("is there and is no empty folder")

    monkeypatch.setattr(demo, "record_logs", record_logs)
    monkeypatch.setattr(demo, "load_campaign_model", lambda logs, *_: logs)
    found = demo.load_demo_campaign(DemoRequest(), no_progress)
    assert found == [folder / "cold.mcap"]


def test_a_diagnosis_is_right_where_its_set_holds_what_was_on(results, campaign, locations):
    """Another name beside the right one is wrong, and another place is not."""
    nothing, named = DemoTruth("00", "none", "", "", "", 0.0, ()), results["named"]
    right = [judge(nothing, campaign, results[name])[0] for name in ("nothing", "unknown", "named")]
    assert right == [True, False, False]
    (finding,), (true,) = named.findings, indices(campaign, named)
    h = next(h for h in range(40) if locations[h] not in finding.places)
    place, key = campaign.sensitivities.hypotheses[h].place, campaign.sensitivities.hypotheses[h].key
    placed = replace(finding, effects=(), families=())
    near = locations.index(finding.place)
    for on, is_right, *findings in (
        (true, True, finding),
        (h, False, finding),
        (true, False),
        (near, True, placed),
        (true, True, finding, replace(placed, place=place, places=(place,))),
        (true, False, finding, replace(placed, place=place, places=(place,), effects=(key,))),
    ):
        said = replace(named, findings=tuple(findings))
        assert judge(truth("known", campaign, on), campaign, said)[0] is is_right


def test_where_the_catalogue_lacks_the_effect_its_place_must_be_seen_and_no_name_given(
    results, campaign, locations
):
    for kind, is_right in (("named", False), ("unknown", True), ("nothing", False)):
        assert judge(truth("left out", campaign, 0), campaign, results[kind])[0] == is_right
    places = [one.places for one in results["beside"].findings if level(one) != "none"]
    right = [all(location in of for of in places) for location in locations[:40]]
    assert any(right)
    judged = [judge(truth("left out", campaign, h), campaign, results["beside"])[0] for h in range(40)]
    assert right == judged


SEEN = TrackerPoses(np.array([7, 90]), stack_poses([IDENTITY, IDENTITY]), np.full((6, 2), 1e-5))


def test_poses_of_a_tracker_come_back(tmp_path):
    write_tracker_poses(tmp_path / "t.csv", SEEN)
    again = read_tracker_poses(tmp_path / "t.csv")
    assert again.tick.tolist() == SEEN.tick.tolist()
    np.testing.assert_array_equal(again.sigma, SEEN.sigma)


@pytest.mark.parametrize(
    ("pattern", "by", "said"),
    [
        (r",z_sigma_m", "", "z_sigma_m"),
        (r"\n7,", "\nseven,", "'seven'"),
        (r"\n7,", "\n7.5,", "ticks must be whole numbers"),
        (r"(\n7,.*\n)", r"\1\1", "each there once"),
    ],
)
def test_a_table_that_is_none_of_poses_is_refused(tmp_path, pattern, by, said):
    path = tmp_path / "t.csv"
    write_tracker_poses(path, SEEN)
    path.write_text(re.sub(pattern, by, path.read_text(), count=1))
    with pytest.raises(RobotError, match=said):
        read_tracker_poses(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"name": "cold"', "EOF|JSON"),
        ('{"temperature_C": NaN}', "temperature_C: .*finite"),
        ('{"world": {"tilt_pitch_rad": 2.9}}', "tilts the rover by 2.9 rad"),
    ],
)
def test_a_session_that_a_header_cannot_mean_is_refused(text, said):
    with pytest.raises(NotForDiagnosis, match=f"log a.mcap: session in its header: .*({said})"):
        load_logs._read_session(text, Path("a.mcap"))


Named = namedtuple("Named", "name block")
"""A recording with name and block only."""


def test_a_session_is_given_once_and_a_repeat_of_what_is_fitted_is_not_held_out():
    first, again, other = Named("cold", "cold"), Named("cold-again", "cold"), Named("warm", "warm")

    def check(fitted: list[Named], *held_out: Named) -> None:
        paths = [Path(f"{letter}.mcap") for letter in "abc"[: len(fitted) + len(held_out)]]
        diagnose_logs._check_sessions(paths, fitted, held_out)  # type: ignore[arg-type]

    check([first], other)
    with pytest.raises(NotForDiagnosis, match="cold-again repeats the motion of cold, which is not held out"):
        check([first], other, again)
    with pytest.raises(NotForDiagnosis, match=r"b\.mcap: is session cold, and so is a\.mcap"):
        check([first], first)


def test_a_part_of_a_campaign_is_beside_all_of_it_on_the_sides_that_its_logs_have(tmp_path):
    held_out = tmp_path / record.HELD_OUT_FOLDER
    held_out.mkdir()
    (held_out / "cold.mcap").touch()
    (tmp_path / "warm.mcap").touch()
    (tmp_path / "tour.mcap").touch()

    def sides(fitted: str, *apart: str) -> list[list[str]]:
        cases = [[Named(name, name) for name in names] for names in ((fitted,), apart)]
        found = diagnose_logs._campaign_logs(tmp_path, *cases)  # type: ignore[arg-type]
        return [[path.stem for path in side] for side in found]

    assert sides("warm", "cold") == [["tour", "warm"], ["cold"]]
    assert sides("warm") == [["tour", "warm"], []]
    for case, said in ((("placed",), "session placed"), (("warm", "tour"), "session that is held out tour")):
        with pytest.raises(NotForDiagnosis, match=f"has no {said}"):
            sides(*case)


def test_logs_of_other_seeds_and_sessions_share_no_noise():
    names, others = ["poses-level-1", "poses-level-1-again"], ["next-1", "next-2"]
    drawn = [record.draw_seed(seed, one, names) for seed in (0, 1, 2) for one in (*names, *others)]
    assert len({*drawn}) == len(drawn)


def test_a_session_that_does_not_complete_has_no_log_and_is_said(tmp_path, monkeypatch):
    """Without a log of any session there is no folder, and the error says what stopped the arm."""

    def stopped(path: Path, session: DiagnosisSession, *_: object) -> None:
        path.touch()
        if session.name not in completed:
            raise SessionFailed(session.name)

    completed = {"poses-level-2", "poses-level-5"}
    monkeypatch.setattr(record, "_write_session", stopped)
    request = RecordRequest(tmp_path / "logs", sessions="poses-level-[235]")
    found = record.record_logs(request, no_progress)
    assert [path.name for path in found.logs] == ["poses-level-2.mcap", "poses-level-5.mcap"]
    assert all(path.exists() for path in found.logs)
    assert found.left_out == ("poses-level-3",)
    completed.clear()
    with pytest.raises(BadRequest, match=r"completes no session; with smaller effects.*poses-level-5"):
        record.record_logs(replace(request, out=tmp_path / "none"), no_progress)
    assert [path.name for path in tmp_path.iterdir()] == ["logs"]


def test_a_session_that_fails_says_in_words_which_command_and_why():
    arm = arm_named("nominal")
    (one,) = (one for one in campaign_sessions(arm.params) if one.name == "warm")
    beyond = replace(one, commands=(MoveJoint(Joint.ELBOW, 9.0, "off"),))
    loop = start_session(beyond, arm, true_reference(arm), 1)
    with pytest.raises(
        SessionFailed, match=r"^session warm: command 1 of 1 was not completed: MoveJoint refu"
    ):
        deque(run_session(loop, beyond), 0)
