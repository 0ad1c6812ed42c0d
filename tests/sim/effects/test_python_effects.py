"""Effects from files outside of the project: the example of the documentation, and refused files."""

import re
from pathlib import Path

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from sim.scenario.effects import BadEffect, effect_text, parse_effect_text
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import TOOLS

ROOT = Path(__file__).parents[3]


@pytest.fixture
def dent(tmp_path: Path) -> Path:
    """Copy the example of the documentation."""
    file = tmp_path / "dent.py"
    file.write_text((ROOT / "examples" / "own_effect.py").read_text())
    return file


def test_the_example_of_the_documentation_holds_a_joint_as_it_says(dent: Path) -> None:
    option = re.search(r"own_effect\.py:(Dent\S*)", (ROOT / "docs" / "effects.md").read_text())[1]
    effect = parse_effect_text(f"{dent}:{option}", TOOLS)
    assert isinstance(effect, Effect)
    assert (effect.joint, effect.torque_Nm, effect.width_rad) == (Joint.ELBOW, 10.0, 0.02)
    start = np.where(np.arange(5) == Joint.ELBOW, effect.angle_rad - 0.02, lab.READY_RAD)
    drawn, held = (bench.turn_joint(Joint.ELBOW, *e, seconds=3.5, start_rad=start) for e in ((), (effect,)))
    beside = (held.output_rad - effect.angle_rad) / effect.width_rad
    expected = 10.0 * beside * np.exp(0.5 - 0.5 * beside**2)
    more = (held.current_A - drawn.current_A) * bench.TORQUE_CONSTANT_NM_A[Joint.ELBOW]
    assert expected[-64:].mean() > 7.0
    assert more[-64:].mean() == pytest.approx(expected[-64:].mean(), rel=0.05)


def test_it_comes_back_from_what_is_written_of_it_and_is_read_anew_when_its_file_is_written_anew(dent):
    written = f"{dent}:Dent:elbow:torque_Nm=15.0,angle_rad=0.5"
    effect = parse_effect_text(written, TOOLS)
    assert "dent" not in catalogue()
    assert effect_text(effect).startswith(written)
    assert parse_effect_text(effect_text(effect), TOOLS) == effect
    assert effect.width_rad == 0.02
    dent.write_text(dent.read_text().replace("= 0.02", "= 0.03"))
    assert parse_effect_text(written, TOOLS).width_rad == 0.03


@pytest.mark.parametrize(
    ("rest", "expected"),
    [
        ("Dnt:elbow:torque_Nm=1", r"Dnt: there is no such class; did you mean Dent\? there are Dent"),
        ("Dent:elbow:torque_Nm=1000", "torque_Nm: 1000 is outside 0 .. 100"),
        ("Joint:elbow", "Joint: is no effect; derive it from Effect, EachCycle, EachMove or Timed"),
        ("", "names no class"),
    ],
)
def test_what_is_wrong_with_it_is_said(dent: Path, rest: str, expected: str) -> None:
    with pytest.raises(BadEffect, match=expected):
        parse_effect_text(f"{dent}:{rest}", TOOLS)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("import nothing_of_this_name", "cannot be run: ModuleNotFoundError: No module named"),
        ("class Dent(", "cannot be run: SyntaxError"),
        ("from sim.effects.effect import Effect\nclass Dent(Effect):\n    pass", r"is no dataclass; write"),
        (None, r"dent\.py: no such file; give the path"),
    ],
)
def test_a_file_that_is_no_effect_is_refused(tmp_path, text, expected):
    file = tmp_path / "dent.py"
    if text is not None:
        file.write_text(text)
    with pytest.raises(BadEffect, match=expected):
        parse_effect_text(f"{file}:Dent:elbow", TOOLS)
