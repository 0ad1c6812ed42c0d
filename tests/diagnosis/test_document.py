"""The JSON document of a diagnosis: it holds every number, and gives the diagnosis back."""

import json
from dataclasses import replace
from math import inf

import pytest

from diagnosis.errors import RobotError
from diagnosis.report.document import from_document, to_document
from tests.diagnosis.verdicts import (
    ARMATURE,
    GAIN,
    LIFT,
    REFUSED,
    REST,
    Rub,
    diagnosis,
    finding,
    without_floor,
)

FULL = diagnosis(
    findings=(finding(next_motion="slow sweeps"), finding(place="pan", interval=((0.0, inf),))),
    base=(GAIN, ARMATURE),
    remaining=(REST,),
    refused=REFUSED,
)


def written(one):
    """Return the document as a program reads it from a file."""
    return json.loads(json.dumps(to_document(one), allow_nan=False))


def test_a_document_gives_the_diagnosis_back():
    assert from_document(written(FULL), [Rub("pan"), Rub("lift")]) == FULL


def test_an_unknown_floor_is_null_and_stays_unknown():
    document = written(diagnosis(errors=(without_floor(LIFT),)))
    assert document["errors"][0]["noise_floor"] is None
    assert document["closure_share"] is None
    (error,) = from_document(document, [Rub("lift")]).errors
    assert error.noise_floor != error.noise_floor
    assert replace(error, noise_floor=LIFT.noise_floor) == LIFT


def test_a_document_opens_with_the_verdict_in_a_word_and_in_lines():
    document = written(FULL)
    assert document["verdict"] == "named"
    assert [line.partition(":")[0] for line in document["lines"]] == ["Where", "What", "How far", "Next"]


def test_an_effect_that_the_catalogue_lacks_is_refused_by_its_key():
    with pytest.raises(RobotError, match="the catalogue has no 'lift: Coulomb friction'"):
        from_document(written(FULL), [Rub("pan")])


def test_a_document_of_another_format_is_refused():
    with pytest.raises(RobotError, match="'diagnosis 1' would be right"):
        from_document({"format": "diagnosis 0"}, [])
