"""Plan of sealed cases of this arm: shares, sizes and classes of effects; seal of the truth."""

from dataclasses import replace

import numpy as np
import pytest

from marsarm.diagnosis.arm.demo import LIMIT_MULTIPLES, DetectableEffect
from marsarm.diagnosis.problem import BOUND_SHARE, Hypothesis, Parameter
from simgap import Family
from simgap.common.errors import BadRequest
from validation.cases import sealed
from validation.cases.arm import ArmCases
from validation.cases.arm_truth import SealedEffect, TrueCase, plan_cases

MAKER = ArmCases()


def seen(effect, place, limit=1.0, label=0, least=-100.0):
    sizes = (Parameter("size", "m", least, 100.0, 2.0, 0.0),)
    return DetectableEffect(Hypothesis(effect, place, sizes, Family.FRICTION, place), limit, label)


CATALOGUE = [seen(f"e{k}", f"p{j}", label=k) for k in range(5) for j in range(1 + k)]
OUTSIDE = [seen("o", "p0", label=None), seen("q", "p1", label=None)]


def drawn(cases=400, seed=1):
    return plan_cases(cases, CATALOGUE, OUTSIDE, np.random.default_rng(seed))


def test_of_four_hundred_cases_so_many_are_of_each_kind():
    kinds = [case.kind for case in drawn()]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {
        "none": 109, "out-of-catalogue": 127, "pair": 55, "single": 109,
    }  # fmt: skip
    assert kinds != sorted(kinds)


def test_a_case_has_the_effects_of_its_kind():
    for case in drawn():
        assert len(case.effects) == {"none": 0, "pair": 2}.get(case.kind, 1)
        assert all((one.source in OUTSIDE) == (case.kind == "out-of-catalogue") for one in case.effects)
        if case.kind == "pair":
            assert case.effects[0].source.label != case.effects[1].source.label


def test_sizes_are_even_in_their_logarithm_and_as_far_from_neutral_as_they_say():
    effects = [one for case in drawn(1000) for one in case.effects]
    times = np.array([one.times_limit for one in effects])
    assert LIMIT_MULTIPLES[0] <= times.min() < times.max() <= LIMIT_MULTIPLES[1]
    least, most = LIMIT_MULTIPLES
    assert np.mean(np.log(times / least) < 0.5 * np.log(most / least)) == pytest.approx(0.5, abs=0.06)
    for one in effects:
        assert abs(one.departures[0]) == pytest.approx(one.times_limit * one.source.limit)
    assert {np.sign(one.departures[0]) for one in effects} == {-1.0, 1.0}


def test_effects_outside_the_catalogue_come_equally_often():
    outside = [seen(f"o{k}", f"p{j}", label=None) for k in range(22) for j in range(2)]
    cases = plan_cases(400, CATALOGUE, outside, np.random.default_rng(1))
    names = [one.source.hypothesis.name for case in cases for one in case.effects if case.kind[0] == "o"]
    assert {names.count(name) for name in set(names)} == {5, 6}
    assert len(names) == 127


def test_a_size_stays_within_its_bounds_and_goes_where_there_is_room():
    tight = seen("e", "p", limit=20.0, least=0.0)
    for case in plan_cases(40, [tight, seen("f", "p", label=1)], OUTSIDE, np.random.default_rng(2)):
        for one in case.effects:
            if one.source is tight:
                assert 0.0 < one.departures[0] <= BOUND_SHARE * 50.0
                assert one.times_limit == pytest.approx(one.departures[0] / 20.0)


def test_what_the_campaign_does_not_see_is_not_drawn():
    assert seen("e", "p").can_sample()
    assert not seen("e", "p", limit=np.inf).can_sample()
    assert not seen("e", "p", limit=200.0).can_sample()


def test_the_same_seed_plans_the_same():
    def planned(seed):
        cases = drawn(seed=seed)
        sizes = [[(one.source, one.departures.tolist()) for one in case.effects] for case in cases]
        return [case.kind for case in cases], sizes

    assert planned(3) == planned(3)
    assert planned(3) != planned(4)


EFFECT = SealedEffect("e", "p", {"size": 1.25}, 2.0, "e:p:size=1.25")
SEALED = sealed.SealedTruth(
    "00ff", (TrueCase("case-000", "single", (EFFECT,), ("b:p",), 5), TrueCase("case-001", "none", (), (), 6))
)


def test_a_truth_comes_back_and_one_that_was_changed_is_refused(tmp_path):
    assert sealed.seal(tmp_path, SEALED) == (tmp_path / sealed.DIGEST).read_text().strip()
    assert sealed.load_truth(tmp_path, MAKER) == SEALED
    path = tmp_path / sealed.SEALED_FOLDER / sealed.TRUTH
    path.write_text(path.read_text().replace("1.25", "1.26"))
    with pytest.raises(BadRequest, match="is not what was sealed"):
        sealed.load_truth(tmp_path, MAKER)


def test_a_folder_of_an_earlier_version_can_be_scored(tmp_path):
    sealed.seal(tmp_path, SEALED)
    (tmp_path / sealed.SEALED_FOLDER / sealed.TRUTH).rename(tmp_path / sealed.TRUTH)
    assert sealed.load_truth(tmp_path, MAKER) == SEALED
    assert SEALED.digest() == "3ffc020780e17eca760d5a8a2f31ef1862882339dc1ea0def711e7d99bef97dd"


def test_cases_of_another_seed_or_number_are_not_gone_on_with(tmp_path):
    assert sealed.load_existing_truth(tmp_path, MAKER, "00ff", 2) is None
    sealed.seal(tmp_path, SEALED)
    assert sealed.load_existing_truth(tmp_path, MAKER, "00ff", 2) == SEALED
    with pytest.raises(BadRequest, match="holds 2 cases; give"):
        sealed.load_existing_truth(tmp_path, MAKER, "00ff", 3)
    with pytest.raises(BadRequest, match="holds 2 cases of another seed"):
        sealed.load_existing_truth(tmp_path, MAKER, "00fe", 2)


def test_a_truth_that_is_thought_of_cannot_be_tried_without_the_salt():
    assert replace(SEALED, salt="00fe").digest() != SEALED.digest()
