"""Result document: its keys, its verdicts, and only values that JSON can hold."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ground.diagnosis.result import to_json

KEYS = {
    "verdict",
    "effects",
    "ranking",
    "residual_map",
    "closure",
    "equivalence_classes",
    "next_motion",
    "log_odds",
    "unexplained",
    "tool_mm",
    "notes",
    "noise_floor",
    "thresholds",
}
EFFECT = {
    "name",
    "place",
    "parameters",
    "probability",
    "share",
    "alternatives",
    "aliases",
    "at_bound",
}


def test_every_case_has_its_verdict(results):
    verdicts = {name: to_json(result)["verdict"] for name, result in results.items()}
    assert verdicts == {
        "named": "named",
        "alike": "named",
        "undecided": "set",
        "nothing": "none",
        "unknown": "unknown",
        "beside": "unknown",
    }


def test_every_document_has_the_same_keys_and_comes_back_from_json(results):
    for result in results.values():
        document = to_json(result)
        assert set(document) == KEYS
        assert all(set(effect) == EFFECT for effect in document["effects"])
        assert json.loads(json.dumps(document, allow_nan=False)) == document


def test_none_has_no_effect_but_a_ranking(results):
    document = to_json(results["nothing"])
    assert document["effects"] == []
    assert len(document["ranking"]) == 10


def test_an_effect_has_its_interval_and_its_probability(results):
    (effect,) = to_json(results["named"])["effects"]
    (parameter,) = effect["parameters"]
    assert parameter["least"] < parameter["value"] < parameter["most"]
    assert effect["probability"] >= 0.95
    assert effect["share"] == pytest.approx(1.0)
    assert effect["alternatives"] == effect["aliases"] == []


def test_aliased_effects_are_a_class_with_the_motion_that_separates_them(results):
    document = to_json(results["alike"])
    (effect,) = document["effects"]
    (together,) = document["equivalence_classes"]
    assert [{key: effect[key] for key in ("name", "place")}, *effect["aliases"]] == together
    assert document["next_motion"][0]["name"] == "another"
    assert document["next_motion"][0]["separation"] > document["next_motion"][0]["separation_now"]


def test_a_set_holds_others_and_what_they_are_worth(results):
    (effect,) = to_json(results["undecided"])["effects"]
    assert effect["alternatives"]
    worth = effect["probability"] + sum(one["probability"] for one in effect["alternatives"])
    assert 0.95 <= worth <= 1.0 + 1e-12


def test_structure_is_reported_where_it_is(results, made):
    for name, expected in (("unknown", True), ("beside", True), ("named", False), ("nothing", False)):
        assert to_json(results[name])["unexplained"]["lack_of_fit"] is expected
    assert to_json(results["unknown"])["unexplained"]["groups"][0]["channel"] == made.layout.channels[6]


def test_what_is_not_finite_is_null(results):
    result = results["named"]
    nothing = replace(result.closure, share=np.nan, least=-np.inf, most=np.inf)
    document = to_json(replace(result, closure=nothing, tool=None))
    assert [document["closure"][key] for key in ("share", "least", "most")] == [None] * 3
    assert document["tool_mm"] is None
    assert to_json(replace(result, closure=None))["closure"] is None
