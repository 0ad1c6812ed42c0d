"""The JSON document of a diagnosis: it holds every number."""

import json
from math import inf

from helpers.verdicts import (
    ARMATURE,
    GAIN,
    LIFT,
    REFUSED,
    REST,
    diagnosis,
    finding,
    without_floor,
)
from simgap.report.sentences import to_document

FULL = diagnosis(
    findings=(finding(next_motion="slow sweeps"), finding(place="pan", interval=((0.0, inf),))),
    base=(GAIN, ARMATURE),
    remaining=(REST,),
    refused=REFUSED,
)


def written(one):
    """Return the document as a program reads it from a file."""
    return json.loads(json.dumps(to_document(one), allow_nan=False))


def test_a_document_holds_every_number_of_a_finding():
    (first, second) = written(FULL)["findings"]
    assert first["sizes"] == [{"name": "coulomb_Nm", "value": 0.44, "low_90": 0.41, "high_90": 0.47}]
    assert (first["place"], first["family"], first["effect"]) == ("lift", "friction", "Coulomb friction")
    assert second["sizes"][0]["high_90"] == "inf"


def test_an_unknown_floor_is_null_and_stays_unknown():
    document = written(diagnosis(errors=(without_floor(LIFT),)))
    assert document["errors"][0]["noise_floor"] is None
    assert document["closure_share"] is None


def test_a_document_opens_with_the_verdict_in_a_word_and_in_lines():
    document = written(FULL)
    assert document["verdict"] == "named"
    assert [line.partition(":")[0] for line in document["lines"]] == ["Where", "What", "How far", "Next"]
