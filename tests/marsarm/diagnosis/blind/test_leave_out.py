"""Leave-one-effect-out: solved cases again, with a catalogue that lacks their effect."""

from pathlib import Path
from typing import Any

import pytest

from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from validation.campaigns import Context
from validation.cases.arm import NoDiagnosis, leave_out, list_clear_cases
from validation.cases.arm_features import load_classes
from validation.cases.sealed import solve_cases


@pytest.mark.slow
def test_an_effect_that_the_catalogue_lacks_is_not_named(folder) -> None:
    context = Context(out=folder.path)
    solve_cases(folder.path, folder.maker, context.run, no_progress)
    found = leave_out(context, folder.maker, 5)
    single = [case for case in folder.truth.cases if case.kind == "single"]
    assert 0 < found["named"]["of"] <= min(5, len(single))
    assert len(found["wrong"]) == found["named"]["hits"] <= found["reported"]["hits"]
    effects = {case.name: case.effects[0] for case in single}
    for text in found["wrong"]:
        name, _, rest = text.partition(": ")
        assert rest.startswith(f"{effects[name].name} at {effects[name].place}: ")
        assert f", {effects[name].name} at" not in rest


def test_a_case_that_cannot_be_diagnosed_without_its_effect_names_nothing(
    folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(_: object, folder: Path, case: Path, without: str = "") -> Any:
        raise NoDiagnosis(f"{case.name} without {without}")

    names = [case.name for case in folder.truth.cases]
    monkeypatch.setattr("validation.cases.sealed.load_results", lambda *_: {name: {} for name in names})
    monkeypatch.setattr(type(folder.maker), "diagnose", refused)
    found = leave_out(Context(out=folder.path), folder.maker, 60)
    assert (found["named"]["hits"], found["reported"]["hits"]) == (0, found["reported"]["of"])
    assert found["right_place"]["of"] == 0


def test_what_is_not_solved_is_refused(folder) -> None:
    with pytest.raises(BadRequest, match=r"no solved case .*solve all cases"):
        leave_out(Context(out=folder.path), folder.maker, 5)


def test_results_in_any_order_belong_to_their_cases(folder, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [case.name for case in folder.truth.cases]
    single = [case for case in folder.truth.cases if case.kind == "single"]
    monkeypatch.setattr("validation.cases.sealed.load_results", lambda *_: {name: {} for name in names})
    monkeypatch.setattr("validation.cases.arm.list_clear_cases", lambda *_: single)

    def named(_: object, folder: Path, case: Path, without: str = "") -> Any:
        sets = {"places": ["x"], "effects": [f"x: {case.name}"]}
        finding = {"effect": case.name, "place": "x", "level": "effect", "not_excluded": sets}
        return {"verdict": "named", "findings": [finding]}

    monkeypatch.setattr(type(folder.maker), "diagnose", named)
    context = Context(run=lambda work, jobs: map(work, reversed(jobs)), out=folder.path)
    found = leave_out(context, folder.maker, 60)
    assert found["named"]["hits"] == found["named"]["of"] == len(found["wrong"]) > 1
    for text in found["wrong"]:
        name, _, others = text.partition(": ")
        assert others.endswith(f": {name} at x")


def test_only_single_effects_from_the_limit_on_are_taken_largest_first(folder) -> None:
    classes = load_classes(folder.path / "campaign")
    chosen = list_clear_cases(folder.truth.cases, classes)
    sizes = [
        one.times_limit / classes.family_wise_share(one.name, one.place)
        for case in chosen
        for one in case.effects
    ]
    assert {case.kind for case in chosen} == {"single"}
    assert sizes == sorted(sizes, reverse=True)
    assert min(sizes) >= 1.0
