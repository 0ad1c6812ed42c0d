"""Bounded, seeded runs of the importer's fuzz target."""

import numpy as np
import pytest

from validation.fuzz_inputs import BETWEEN, MAPPING, import_once, import_seeds, mutate_import, random_case

TRIES = 1000


@pytest.mark.slow
def test_odd_tables_are_imported_or_refused_and_nothing_else_happens() -> None:
    outcomes = [import_once(random_case(np.random.default_rng(seed))) for seed in range(TRIES)]
    assert 0.02 * TRIES < sum(outcomes) < TRIES


def test_what_is_changed_is_imported_or_refused_and_nothing_else_happens() -> None:
    rng = np.random.default_rng(6)
    seeds = import_seeds()
    assert all(import_once(seed) for seed in seeds)
    outcomes = [import_once(mutate_import(rng, seeds[k % len(seeds)])) for k in range(TRIES // 4)]
    assert 0 < sum(outcomes) < TRIES // 4


@pytest.mark.parametrize(
    "data",
    [b"", BETWEEN, b"\0" * 100, b"[" * 5000 + BETWEEN, MAPPING, MAPPING + BETWEEN, b"a=" + b"[" * 5000],
)
def test_what_is_hardly_a_file_is_refused(data: bytes) -> None:
    assert not import_once(data)
