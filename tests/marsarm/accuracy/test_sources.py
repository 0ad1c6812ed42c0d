"""Error sources agree with the paper, and each one names the origin of its magnitude."""

import numpy as np
import pytest

from fsw.dictionary.enums import Frame
from marsarm.accuracy.sources import CUMULANTS, load_error_model

MODEL = load_error_model()
TABLE_2 = {
    "assembly": "systematic",
    "backlash": "random",
    "deflection": "systematic",
    "distortion_bulk": "systematic",
    "distortion_gradient": "systematic",
    "encoder": "random",
    "slop": "random",
    "windup": "random",
    "wobble": "random",
    "zero_offset": "random",
}
NOT_ON_THE_SAME_DAY = {"assembly", "backlash", "deflection", "windup", "zero_offset"}


def test_cases_have_the_sources_of_the_papers_tables_and_the_rover_which_the_text_tells_apart():
    before, again, mars = (set(MODEL.case[name].sources) for name in ("accuracy", "repeatability", "mars"))
    kinds = {name: MODEL.source[name].kind for name in before}
    assert kinds == {**TABLE_2, "rover_stiffness": "systematic"}
    assert again == set(TABLE_2) - NOT_ON_THE_SAME_DAY
    assert MODEL.case["repeatability"].sources["distortion_bulk"] < 1
    assert {"tool_orientation", "isolator_hysteresis", "motor_controller"} <= mars - before


def test_backlash_deflection_and_bulk_distortion_lie_at_their_limits():
    at_limit = {name for name, source in MODEL.source.items() if source.at_limit}
    assert at_limit == {"backlash", "deflection", "rover_stiffness", "distortion_bulk"}


@pytest.mark.parametrize("name", MODEL.source)
def test_a_source_has_a_magnitude_a_basis_and_a_spread(name):
    source = MODEL.source[name]
    assert (source.theta.any()) == (source.relative_to == "frames")
    assert (source.share > 0) == (source.relative_to != "frames")
    assert source.basis
    assert source.text
    assert CUMULANTS[source.distribution][0] > 0


@pytest.mark.parametrize("name", MODEL.source)
def test_what_is_drawn_with_every_move_is_random_and_lies_anywhere_within(name):
    source = MODEL.source[name]
    if source.effect in ("frame play", "servo error", "windup"):
        assert (source.kind, source.distribution) == ("random", "uniform")
    if source.kind == "systematic":
        assert source.effect in ("frame error", "stiffness", "warming")


def test_errors_of_joints_are_turns_about_z_of_the_frames_at_the_joints():
    for name in ("backlash", "encoder", "windup", "zero_offset", "motor_controller"):
        theta = MODEL.source[name].theta
        assert np.all(theta[2, : Frame.ARM6] > 0)
        theta[2, : Frame.ARM6] = 0
        assert not theta.any()
