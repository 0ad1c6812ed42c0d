"""A small edition of the kinematics campaign: 100,000 targets, half of them made from joint vectors.

`make campaign NAME=kinematics` runs twenty million. What fails here has examples, enough to run each again.
"""

import json
from functools import lru_cache

import numpy as np
import pytest

from fsw.kinematics.arm import limit_excess
from helpers.marks import slow_but
from tests.tools import TOOLS
from validation.campaigns import Context
from validation.kinematics import Chunk, Tally, campaign, plan_chunks, run_chunk
from validation.kinematics_samples import FARTHEST, NEAREST, Near, draw_vectors, log_distances
from validation.kinematics_trials import CASES, Trial, arm_of, smallest_singular_value, task_jacobian, trials

EACH = 50_000
SEED = 2024
by_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name.replace(" ", "-"))


@lru_cache
def tally_of(case) -> Tally:
    tally = Tally()
    for chunk in plan_chunks(EACH, EACH, SEED, case):
        tally.add(run_chunk(chunk))
    return tally


@pytest.mark.slow
@by_case
def test_every_root_meets_its_target_and_no_root_is_missed_or_called_by_another_name(case):
    tally = tally_of(case)
    assert tally.failures == 0, tally.examples
    assert tally.roots > tally.targets
    assert tally.worst_error <= case.tolerance_m
    assert tally.workspace_at_most_four > 0.98 * tally.workspace


@pytest.mark.slow
def test_two_roots_meet_at_hundreds_of_vectors_of_the_campaign():
    """All cases together: the skew tool has none or two in 2,500 vectors, as the processor rounds."""
    assert sum(tally_of(case).indistinct for case in CASES) > 200


def test_the_small_campaign_is_of_200_000_targets():
    chunks = plan_chunks(EACH, EACH, SEED)
    assert sum(chunk.targets for chunk in chunks) == sum(chunk.vectors for chunk in chunks) == EACH
    assert {chunk.case for chunk in chunks} == set(CASES)


@pytest.mark.slow
@by_case
def test_vectors_of_the_campaign_are_inside_their_limits_and_many_are_near_double_roots(case):
    rng = np.random.default_rng(1)
    for trial in trials(case, rng):
        q, near = draw_vectors(trial, rng, 2000)
        assert (limit_excess(trial.arm, q) <= 0).all()
        for flag in (Near.ELBOW, Near.WRIST, Near.SHOULDER):
            there = (near & flag) > 0
            assert there.sum() > 100
            assert np.median(smallest_singular_value(trial, q[:, there])) < 0.01


@pytest.mark.parametrize("case", slow_but(CASES, CASES[0], CASES[-1]), ids=[case.name for case in CASES])
def test_some_vectors_are_measured_from_the_double_roots_of_the_arm_as_it_is(case):
    trial = next(trials(case, np.random.default_rng(2)))
    q, near = draw_vectors(trial, np.random.default_rng(3), 3000)
    assert (smallest_singular_value(trial, q[:, near > 0]) < 1e-4).sum() > 10


def test_distances_come_in_every_size():
    sizes = np.abs(log_distances(np.random.default_rng(4), 10_000))
    assert sizes.min() >= NEAREST
    assert sizes.max() <= FARTHEST
    decades = np.histogram(np.log10(sizes), bins=[-6, -5, -4, -3, -2, -1])[0]
    assert decades.min() > 0.8 * decades.max()


def test_the_jacobian_of_a_deflected_tool_counts_the_load_s_response():
    """The Jacobian differs from the rigid one by a few parts in a thousand."""
    q = np.array([[0.1, -1.0, 1.2, 1.0, 1.0]]).T
    rigid, deflected = (
        task_jacobian(Trial("nominal", arm_of("nominal"), "drill", pull), q)
        for pull in (None, np.array([0.0, 0.0, 3.711]))
    )
    change = np.abs(deflected - rigid).max()
    assert 1e-3 < change < 0.1


def test_a_chunk_comes_again_with_its_seed():
    case = CASES[0]
    twice = [run_chunk(Chunk(0, case, 300, 300, np.random.SeedSequence(7))).as_json() for _ in range(2)]
    assert twice[0] == twice[1]


@pytest.mark.slow
def test_the_result_of_a_campaign_is_json_by_case_and_adds_up():
    result = json.loads(json.dumps(campaign(Context(3), 100, 100)))
    assert list(result["cases"]) == [case.name for case in CASES]
    for name in ("targets", "vectors", "failures"):
        assert result[name] == sum(tally[name] for tally in result["cases"].values())


def test_an_exception_is_counted_and_reported_but_does_not_end_the_campaign(monkeypatch):
    def breaks(*_):
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr("validation.kinematics.inverse_kinematics", breaks)
    tally = run_chunk(Chunk(0, CASES[0], 50, 50, np.random.SeedSequence(7)))
    assert tally.exceptions == len(TOOLS)
    assert "on purpose" in tally.examples[0]["trace"]
    assert tally.failures == len(TOOLS)


def test_a_lost_root_is_a_miss_with_the_means_to_run_it_again(monkeypatch):
    """Without the roots near it, the vector is missed; its example holds arm, tool, gravity and vector."""
    monkeypatch.setattr(
        "validation.kinematics.root_distances", lambda result, q: np.full(result.verdict.shape, np.inf)
    )
    tally = run_chunk(Chunk(0, CASES[0], 50, 50, np.random.SeedSequence(7)))
    assert tally.missed.total() + tally.indistinct == tally.vectors
    example = next(one for one in tally.examples if one["what"] == "missed")
    again = Trial(example["arm"], arm_of(example["arm"]), example["tool"], None)
    q = np.array(example["vector_rad"])[:, None]
    assert smallest_singular_value(again, q)[0] == pytest.approx(example["sigma"], rel=1e-6)
