"""Result document: its keys, its verdicts and levels, and only values that JSON can hold."""

import json
from dataclasses import replace

import numpy as np
import pytest

from marsarm.diagnosis.result import to_json

KEYS = frozenset((
    *("verdict", "effects", "residual_map", "closure", "next_motion", "unexplained", "tool_mm", "notes"),
    "noise_floor",
))  # fmt: skip
EFFECT = frozenset((
    *("name", "place", "family", "level", "places", "families", "effects", "parameters", "share"),
    *("alternatives", "aliases"),
))  # fmt: skip


def test_every_case_has_its_verdict_and_level(results):
    said = {name: to_json(result) for name, result in results.items()}
    found = dict.fromkeys(("named", "alike", "undecided", "beside"), "found")
    assert {name: one["verdict"] for name, one in said.items()} == {
        **found, "nothing": "none", "unknown": "unknown"
    }  # fmt: skip
    levels = {name: {effect["level"] for effect in one["effects"]} for name, one in said.items()}
    assert [levels[name] for name in ("named", "undecided", "beside")] == [{"size"}, {"effect"}, {"place"}]
    assert said["nothing"]["effects"] == []


def test_every_document_has_the_same_keys_and_comes_back_from_json(results):
    for result in results.values():
        document = to_json(result)
        assert set(document) == KEYS
        assert all(set(effect) == EFFECT for effect in document["effects"])
        assert json.loads(json.dumps(document, allow_nan=False)) == document


def test_an_effect_has_its_interval_its_limits_and_its_sets(results):
    (effect,) = to_json(results["named"])["effects"]
    (parameter,) = effect["parameters"]
    assert parameter["least"] < parameter["value"] < parameter["most"]
    assert 0.0 < parameter["seen_from"] < parameter["named_from"] < parameter["value"]
    assert effect["share"] == pytest.approx(1.0)
    assert effect["alternatives"] == effect["aliases"] == []
    assert effect["places"] == [effect["place"]]
    assert effect["families"] == [effect["family"]]
    assert effect["effects"] == [{key: effect[key] for key in ("name", "place")}]


def test_aliased_effects_have_a_motion_that_separates_them(results):
    document = to_json(results["alike"])
    (effect,) = document["effects"]
    assert len(effect["aliases"]) == 1
    best, same = document["next_motion"]
    assert [best["name"], same["name"]] == ["another", "the same"]
    assert best["separation"] > 3.0 * best["separation_now"]
    assert same["separation"] >= same["separation_now"]


def test_a_set_holds_others_with_their_probability(results):
    (effect,) = to_json(results["undecided"])["effects"]
    assert effect["alternatives"]
    assert all(0.05 < one["p"] <= 1.0 for one in effect["alternatives"])
    assert len(effect["effects"]) == 1 + len(effect["alternatives"])


def test_structure_is_reported_where_it_is(results, made):
    for name, expected in (("unknown", True), ("beside", True), ("named", False), ("nothing", False)):
        assert to_json(results[name])["unexplained"]["has_remainder"] is expected
    assert to_json(results["unknown"])["unexplained"]["groups"][0]["channel"] == made.layout.channels[6]


def test_what_is_not_finite_is_null(results):
    result = results["named"]
    nothing = replace(result.closure, share=np.nan, least=-np.inf, most=np.inf)
    document = to_json(replace(result, closure=nothing, tool=None))
    assert [document["closure"][key] for key in ("share", "least", "most")] == [None] * 3
    assert document["tool_mm"] is None
    assert to_json(replace(result, closure=None))["closure"] is None
