"""Test that the campaign of faults draws every possible kind of fault."""

import numpy as np

from sim.effects.faults import SensorFault
from sim.scenario.tables import FAULT_CLASSES
from validation.faults import random_fault


def test_every_kind_of_fault_is_drawn():
    rng = np.random.default_rng(0)
    drawn = [random_fault(rng, 1.0, has_rock=True) for _ in range(500)]
    assert {type(fault).__name__ for fault in drawn} == {kind.__name__ for kind in FAULT_CLASSES}
    kinds = {fault.kind for fault in drawn if isinstance(fault, SensorFault)}
    assert kinds == {"frozen", "biased", "noisy", "nan"}
