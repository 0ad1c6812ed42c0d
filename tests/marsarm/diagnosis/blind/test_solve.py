"""Blind cases solved without their truth and scored with it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from marsarm.common.pool import local_runner
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from validation.cases.arm import ArmCases, NoDiagnosis
from validation.cases.arm_features import CLASSES_FILE, load_classes
from validation.cases.sealed import (
    SOLVED_FOLDER,
    load_results,
    result_path,
    score_cases,
    seal,
    solve_cases,
    write_json,
)

pytestmark = pytest.mark.slow

RUN = local_runner(1)


@pytest.fixture
def solved(folder, results: dict[str, bytes]):
    """Return a folder whose cases are solved; all folders are alike, so they are solved once."""
    if not results:
        solve_cases(folder.path, folder.maker, RUN, no_progress)
        results |= {path.name: path.read_bytes() for path in (folder.path / SOLVED_FOLDER).iterdir()}
    (folder.path / SOLVED_FOLDER).mkdir(exist_ok=True)
    for name, content in results.items():
        (folder.path / SOLVED_FOLDER / name).write_bytes(content)
    return folder


@pytest.fixture(scope="module")
def results() -> dict[str, bytes]:
    """Return the files of solved cases by name; empty until a test asks for them."""
    return {}


def test_the_campaign_is_known_once_and_before_any_case(solved, monkeypatch: pytest.MonkeyPatch) -> None:
    result_path(solved.path, "case-009").unlink()
    prepared: list[Path] = []
    monkeypatch.setattr(type(solved.maker), "prepare", lambda _, folder, *more: prepared.append(folder))
    assert solve_cases(solved.path, solved.maker, RUN, no_progress) == (1, 10)
    assert solve_cases(solved.path, solved.maker, RUN, no_progress) == (0, 10)
    assert prepared == [solved.path]


def mute(_: ArmCases, folder: Path, case: Path, without: str = "") -> Any:
    raise NoDiagnosis(f"{case.name} has no logs of {folder.name}")


def test_a_case_that_cannot_be_diagnosed_does_not_stop_the_others(
    folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in (folder.path / SOLVED_FOLDER).glob("*"):
        path.unlink()
    monkeypatch.setattr(type(folder.maker), "diagnose", mute)
    assert solve_cases(folder.path, folder.maker, RUN, no_progress) == (10, 10)
    result = load_results(folder.path, folder.maker)["case-003"]
    said = f"case-003 has no logs of {folder.path.name}"
    assert (result["verdict"], result["refused"]) == ("unknown", said)
    found = score_cases(folder.path, folder.maker, False).document
    assert found["false_alarm"]["share"] == 1.0
    assert found["reported"]["hits"] == 0
    for path in (folder.path / SOLVED_FOLDER).glob("*"):
        path.unlink()


def test_solved_cases_are_scored(solved) -> None:
    score = score_cases(solved.path, solved.maker, False)
    found = score.document
    assert (found["cases"], found["false_alarm"]["of"], found["wrong"]["place"]["of"]) == (10, 2, 4)
    true = [one for case in solved.truth.cases if case.kind in ("single", "pair") for one in case.effects]
    assert found["reported"]["of"] <= sum(one.times_limit >= 1.0 for one in true)
    assert json.loads(json.dumps(found, allow_nan=False))["digest"] == solved.truth.digest()
    assert "| reported, from the limit of the selection on | 85 % |" in score.markdown()


def test_cases_that_are_not_solved_are_counted(solved) -> None:
    for number in (2, 5, 7):
        result_path(solved.path, f"case-00{number}").unlink()
    with pytest.raises(BadRequest, match="3 of 10 cases are not solved, case-002 first"):
        score_cases(solved.path, solved.maker, False)
    assert score_cases(solved.path, solved.maker, True).document["cases"] == 7


GOOD = {
    "verdict": "named",
    "findings": [
        {
            "effect": "link-length",
            "place": "arm3.x",
            "level": "effect",
            "not_excluded": {"places": ["arm3"], "families": ["geometry"], "effects": ["arm3.x: link"]},
            "sizes": [{"name": "length_m", "low_90": 0.001, "high_90": 0.002}],
        }
    ],
    "seconds": 9.5,
}
SIZE = {"name": "length_m", "low_90": None, "high_90": 0.002}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[]", "object"),
        ('{"verdict": "none"', "JSON"),
        ('{"verdict": "none"}', "findings"),
        (json.dumps(GOOD | {"verdict": "sure"}), "verdict"),
        (json.dumps(GOOD | {"findings": [GOOD["findings"][0] | {"sizes": [SIZE]}]}), r"sizes\.0"),
        (json.dumps(GOOD | {"findings": [GOOD["findings"][0] | {"level": "sure"}]}), "level"),
        (json.dumps(GOOD | {"seconds": "nine"}), "seconds"),
        (json.dumps(GOOD | {"seconds": 10**400}), "finite"),
    ],
)
def test_what_is_no_solved_case_is_refused(tmp_path: Path, text: str, why: str) -> None:
    write_json(tmp_path / SOLVED_FOLDER / "case-000.json", GOOD)
    assert load_results(tmp_path, ArmCases()) == {"case-000": GOOD}
    (tmp_path / SOLVED_FOLDER / "case-004.json").write_text(text)
    with pytest.raises(BadRequest, match=rf"case-004\.json: is no solved case \(.*{why}"):
        load_results(tmp_path, ArmCases())


def test_a_size_that_an_effect_has_not_is_refused(solved) -> None:
    case = next(case for case in solved.truth.cases if case.kind == "single")
    path = result_path(solved.path, case.name)
    before = path.read_bytes()
    (one,) = case.effects
    size = {"name": "size_of_another", "low_90": 0.0, "high_90": 1.0}
    finding = GOOD["findings"][0] | {"effect": one.name, "place": one.place, "sizes": [size]}
    path.write_text(json.dumps(json.loads(before) | {"verdict": "named", "findings": [finding]}))
    with pytest.raises(BadRequest, match=f"{case.name}: {one.name} has no size_of_another"):
        score_cases(solved.path, solved.maker, False)
    path.write_bytes(before)


def test_an_effect_of_another_version_is_refused(solved) -> None:
    cases = list(solved.truth.cases)
    at = next(k for k, case in enumerate(cases) if case.kind == "out-of-catalogue")
    cases[at] = replace(cases[at], effects=(replace(cases[at].effects[0], name="old-wobble"),))
    seal(solved.path, replace(solved.truth, cases=tuple(cases)))
    with pytest.raises(BadRequest, match=f"{cases[at].name}: old-wobble is none of today's effects"):
        score_cases(solved.path, solved.maker, False)


@pytest.mark.parametrize("text", ["{}", "[]", '[{"name": 1}]', "[" * 200_000])
def test_classes_that_are_none_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / CLASSES_FILE).write_text(text)
    with pytest.raises(BadRequest, match=r"classes\.json: holds no classes \("):
        load_classes(tmp_path)


def test_a_folder_of_something_else_is_refused(tmp_path: Path, folder) -> None:
    with pytest.raises(BadRequest, match="no folder of cases"):
        solve_cases(tmp_path / "none", folder.maker, RUN, no_progress)
