"""Leave-one-effect-out: the effect is not in the catalogue, and nothing may be named in its place."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from marsarm.common.pool import local_runner
from simgap.common.errors import BadRequest
from validation.blind.classes import load_classes
from validation.blind.leave_out import list_clear_cases, score_left_out
from validation.blind.solve import NoDiagnosis, Solver, solve_cases

RUN = local_runner(1)


def quiet(*_: object) -> None:
    """No progress."""


@pytest.mark.slow
def test_an_effect_that_the_catalogue_lacks_is_not_named(folder) -> None:
    solve_cases(folder.path, folder.solver, RUN, quiet)
    found = score_left_out(folder.path, folder.solver, 5, RUN, quiet)
    single = [case for case in folder.truth.cases if case.kind == "single"]
    assert 0 < found.named.of <= min(5, len(single))
    assert len(found.wrong) == found.named.hits <= found.reported.hits
    effects = {case.name: case.effects[0] for case in single}
    for text in found.wrong:
        name, _, rest = text.partition(": ")
        assert rest.startswith(f"{effects[name].name} at {effects[name].place}: ")
        assert f", {effects[name].name} at" not in rest


def test_a_case_that_cannot_be_diagnosed_without_its_effect_names_nothing(
    folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(case: Path, campaign: Path, without: str) -> Any:
        raise NoDiagnosis(f"{case.name} without {without}")

    monkeypatch.setattr("validation.blind.leave_out.load_results", lambda _: {name: {} for name in names})
    names = [case.name for case in folder.truth.cases]
    solver = Solver(folder.solver.prepare_campaign, folder.solver.load_sensitivities, refused)
    found = score_left_out(folder.path, solver, 60, RUN, quiet)
    assert (found.named.hits, found.reported.hits) == (0, found.reported.of)
    assert found.right_place.of == 0


def test_what_is_not_solved_is_refused(folder) -> None:
    with pytest.raises(BadRequest, match=r"no solved case .* `python -m validation\.blind solve`"):
        score_left_out(folder.path, folder.solver, 5, RUN, quiet)


@pytest.mark.parametrize("cases", [0, -1])
def test_a_number_below_one_is_refused(folder, cases: int) -> None:
    with pytest.raises(BadRequest, match=rf"cases: {cases} is not 1 or more"):
        score_left_out(folder.path, folder.solver, cases, RUN, quiet)


def test_results_in_any_order_belong_to_their_cases(folder, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [case.name for case in folder.truth.cases]
    single = [case for case in folder.truth.cases if case.kind == "single"]
    monkeypatch.setattr("validation.blind.leave_out.load_results", lambda _: {name: {} for name in names})
    monkeypatch.setattr("validation.blind.leave_out.list_clear_cases", lambda *_: single)

    def named(case: Path, campaign: Path, without: str) -> Any:
        effect = {"name": case.name, "place": "x", "level": "size", "places": [], "effects": []}
        return {"verdict": "found", "effects": [effect]}, None

    def backwards(work: Any, jobs: Any) -> Iterator[Any]:
        return (work(job) for job in reversed(jobs))

    solver = Solver(folder.solver.prepare_campaign, folder.solver.load_sensitivities, named)
    found = score_left_out(folder.path, solver, 60, backwards, quiet)
    assert found.named.hits == found.named.of == len(found.wrong) > 1
    for text in found.wrong:
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
