"""Tool error from the error of the turret pose."""

import numpy as np
import pytest

from fsw.config import configure
from marsarm.diagnosis.arm.case import compute_tool_error
from sim.arms import nominal_params
from sim.plant import SCREW_AXES

DRAWING = nominal_params()
KEYS = [f"poses/rest 0/{axis}" for axis in reversed(SCREW_AXES)] + ["poses/rest 1/rx", "poses/rest 0/elbow"]


def off(**screw: float) -> np.ndarray:
    return np.array([screw.get(key.rpartition("/")[2], 0.0) for key in KEYS])


def test_a_shift_moves_every_tool_by_as_much() -> None:
    found = compute_tool_error(
        KEYS, [off(tx=3e-3, ty=4e-3), off(tx=3e-3), off(tz=1e-3)], off(tx=2e-3), DRAWING
    )
    assert found is not None
    assert (found.nominal, found.base, found.explained) == pytest.approx((5e-3, 3e-3, 1e-3))
    assert found.noise_floor == pytest.approx(2e-3)
    assert compute_tool_error(KEYS[1:], np.zeros((3, len(KEYS) - 1)), off(), DRAWING) is None


def test_a_turn_moves_a_tool_by_its_way_from_the_axis() -> None:
    found = compute_tool_error(KEYS, [off(rz=1e-3), off(rz=1e-3, tx=1e-3), off()], off(rz=1e-3), DRAWING)
    assert found is not None
    p = np.array([X.p for X in configure(DRAWING).arm.X_FT.values()])
    away = 1e-3 * np.sqrt(np.mean(p[:, 0] ** 2 + p[:, 1] ** 2))
    with_shift = 1e-3 * np.sqrt(np.mean((1.0 - p[:, 1]) ** 2 + p[:, 0] ** 2))
    assert (found.nominal, found.base, found.noise_floor) == pytest.approx((away, with_shift, away))
