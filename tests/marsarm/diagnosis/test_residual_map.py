"""Residual map: place, channel and interval of a residual."""

from dataclasses import replace

import numpy as np
import pytest

from marsarm.diagnosis.diagnose import map_residual


def test_a_channel_that_several_places_have_is_mapped_place_by_place(made, rng):
    """All places share one kind of channel; the residual is at one place."""
    kinds = ("a", "b", "c")
    layout = replace(made.layout, channel=made.layout.channel % 3, channels=kinds, units=("u",) * 3)
    here = (layout.place == 2) & (layout.channel == 1)
    cells = map_residual(layout, rng.standard_normal(layout.size) * np.where(here, 5.0, 1.0), seed=1)
    assert {(cell.channel, cell.place) for cell in cells[:3]} == {("b", "place 2")}
    assert all(cell.ratio == pytest.approx(5.0, rel=0.4) for cell in cells[:3])
    assert all(cell.ratio < 2.0 for cell in cells[3:])
    assert sum(cell.features for cell in cells) == layout.size


def test_one_motion_tells_no_interval(made, rng):
    alone = replace(made.layout, place=np.where(made.layout.block == 3, 4, made.layout.place % 4))
    cells = map_residual(alone, rng.standard_normal(alone.size), seed=1)
    assert all(np.isnan(cell.least) and np.isnan(cell.most) for cell in cells if cell.place == "place 4")
    assert all(cell.least <= cell.most for cell in cells if cell.place != "place 4")


def test_an_interval_holds_what_it_is_of(made, rng):
    for cell in map_residual(made.layout, rng.standard_normal(made.layout.size), seed=1):
        assert cell.least <= cell.ratio <= cell.most
