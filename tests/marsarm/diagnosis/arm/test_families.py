"""Families: every effect that a diagnosis of this arm can name has one."""

from collections import Counter

from marsarm.diagnosis.arm.arm_effects import FAMILIES, family_of
from marsarm.diagnosis.arm.simulator import list_candidates


def test_every_candidate_has_one_family() -> None:
    count = Counter(kind for kinds in FAMILIES.values() for kind in kinds)
    assert set(count.values()) == {1}
    assert {one.kind for one in list_candidates(None)} == set(count)
    assert {family_of(one.kind) for one in list_candidates(None)} == set(FAMILIES)
