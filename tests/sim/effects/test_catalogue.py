"""Catalogue: every effect has a summary, places and parameters; effects as text, read and refused."""

import re
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

import sim.effects.gears
from fsw.dictionary.enums import Frame, Joint
from marsarm.runs.place import prepare_placement
from marsarm.runs.request import PlaceRequest
from sim.arms import arm_named
from sim.effects.catalogue import (
    all_places,
    catalogue,
    effect_classes_in,
    effect_place_text,
    hypotheses,
    parameters_of,
    scaled_value,
)
from sim.effects.effect import Effect, EffectMisfit, check_effects
from sim.effects.faults import SensorFault
from sim.effects.gears import CoulombFriction, StribeckFriction
from sim.effects.geometry import FrameError, FramePlay, LinkAngle, LinkWarming, ToolOffset
from sim.effects.sensors import EncoderZero
from sim.effects.structure import LinkBending, LinkMass
from sim.loop import ClosedLoop, Setup
from sim.scenario.effects import BadEffect, effect_text, parse_effect_text
from sim.scenario.file import BadScenario, parse_scenario
from sim.scenario.run import scenario_setup
from sim.setting import World
from simgap.common.errors import BadRequest
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import SWITCHES, TOOLS

KINDS = pytest.mark.parametrize("kind", catalogue().values(), ids=catalogue())
HYPOTHESES = tuple(hypotheses())
ASKED_FOR = (
    *("coulomb-friction", "viscous-friction", "stribeck-friction", "load-friction", "cold-friction"),
    *("gear-stiffness", "gear-hysteresis", "backlash-width", "gear-efficiency", "transmission-error"),
    *("motor-constant", "current-gain", "current-bias", "encoder-zero", "resolver-bias"),
    *("resolver-eccentricity", "command-delay", "servo-gain", "bus-sag", "link-bending", "link-torsion"),
    *("link-length", "link-angle", "warming", "thermal-gradient", "rover-compliance", "gravity-direction"),
    *("turret-mass", "turret-centre", "tool-offset", "flex-cable", "contact-stiffness", "surface-position"),
    *("asymmetric-friction", "counterbalance", "joint-coupling", "encoder-scale", "resolver-scale"),
    *("current-crosstalk", "link-creep"),
)


def test_all_that_was_asked_for_is_there_and_can_be_raced():
    hypothesised = {hypothesis.kind for hypothesis in HYPOTHESES}
    assert [name for name in ASKED_FOR if catalogue().get(name) not in hypothesised] == []


def test_every_effect_of_a_file_is_in_the_catalogue_by_its_name():
    names = [kind.__name__ for kind in effect_classes_in(sim.effects.gears)]
    assert names[:2] == ["CoulombFriction", "AsymmetricFriction"]
    assert set(effect_classes_in(sim.effects.gears)) <= set(catalogue().values())
    assert not [name for name in catalogue() if name.startswith("-") or name != name.lower()]


@KINDS
def test_the_typical_size_of_a_parameter_twice_over_is_within_its_bounds(kind):
    for parameter in parameters_of(kind):
        size = parameter.spec
        if size is not None and parameter.is_amplitude:
            assert size.low <= size.neutral <= size.high
            assert size.low <= scaled_value(parameter, 2.0) <= size.high or kind.__name__ == "WeakMotor"
        elif size is not None:
            assert size.low <= size.typical <= size.high


@KINDS
def test_every_effect_comes_back_from_what_is_written_of_it(kind):
    places = list(all_places(kind))
    assert places
    for place in (places[0], places[-1]):
        effect = kind(**place, **{p.field: value_of(p) for p in parameters_of(kind)})
        assert parse_effect_text(effect_text(effect), TOOLS) == effect


def value_of(parameter) -> object:
    """Return a value that is neither neutral nor round."""
    size = parameter.spec
    if size is None or isinstance(parameter.default, int):
        return parameter.default
    if size.unit == "cycle":
        return 3
    value = (size.neutral or 0.0) + size.typical / 3
    if size.unit == "of the sensor":
        return parameter.default
    return value if parameter.count == 1 else (value,) * parameter.count


def test_hypotheses_are_all_different_and_have_names_of_their_own():
    names = [str(hypothesis) for hypothesis in HYPOTHESES]
    assert len(set(names)) == len(names)
    assert "coulomb-friction:elbow" in names
    assert "link-bending:arm3.z" in names
    assert "warming" in names


def test_a_hypothesis_has_one_place_and_its_sizes_open():
    (one,) = (hypothesis for hypothesis in HYPOTHESES if str(hypothesis) == "flex-cable:wrist")
    assert [p.field for p in one.amplitudes] == ["stiffness_Nm_rad", "drag_Nm"]
    effect = one.effect(drag_Nm=2.0)
    assert (effect.joint, effect.stiffness_Nm_rad, effect.drag_Nm) == (Joint.WRIST, 0.0, 2.0)


def test_places_that_a_class_refuses_are_none():
    bending = {place["frame"] for place in all_places(LinkBending)}
    assert bending == {*Frame} - {Frame.ARM1, Frame.ARM6, Frame.TOOL}
    of_tools = [place["tool"] for place in all_places(FrameError) if place["frame"] is Frame.TOOL]
    assert of_tools == list(TOOLS)
    assert effect_place_text(FrameError, {"frame": Frame.TOOL, "tool": "mahli"}) == "tool.mahli"


RIGHT = {
    "coulomb-friction:elbow:torque_Nm=25": CoulombFriction(Joint.ELBOW, 25.0),
    "coulomb-friction:joint=elbow,torque_Nm=25": CoulombFriction(Joint.ELBOW, 25.0),
    " stribeck-friction : elbow : torque_Nm = 3 ": StribeckFriction(Joint.ELBOW, 3.0),
    "link-angle:arm3.x:angle_deg=90e-3": LinkAngle(Frame.ARM3, "x", 0.09 * (pi / 180)),
    "tool-offset:drill.y:offset_mm=2": ToolOffset("drill", "y", 0.002),
    "frame-error:tool.drt:screw=[0,0,1e-3,0,0,0]": FrameError(Frame.TOOL, (0, 0, 1e-3, 0, 0, 0), "drt"),
    "link-mass:arm3:factor=1.1,shift_mm=[1, 2, 3]": LinkMass(Frame.ARM3, 1.1, (0.001, 0.002, 0.003)),
}
WRONG = {
    "coulomb-frction:elbow:torque_Nm=3": r"'coulomb-frction' is not known; did you mean coulomb-friction\?",
    "coulomb-friction:elbo:torque_Nm=3": r"place: joint 'elbo' is not known; did you mean elbow\?",
    "coulomb-friction:torque_Nm=3": "effect coulomb-friction: place: joint is missing; there are azimuth",
    "coulomb-friction:elbow": "effect coulomb-friction:elbow: torque_Nm: is missing",
    "coulomb-friction:elbow:torque=3": "effect coulomb-friction:elbow: torque: has no unit; write torque_Nm",
    "coulomb-friction:elbow:torqe_Nm=3": r"torqe_Nm: is not known here; did you mean torque_Nm\?",
    "coulomb-friction:elbow:torque_Nm=3000": "coulomb-friction:elbow: torque_Nm: 3000 is outside -100 .. 400",
    "coulomb-friction:elbow:torque_Nm=nan": "torque_Nm: should be a finite number, not nan",
    "coulomb-friction:elbow:torque_Nm=much": "torque_Nm: should be a valid number, not 'much'",
    "coulomb-friction:elbow:torque_Nm": "is no parameter and its value; write coulomb-friction:PLACE",
    "coulomb-friction:elbow:torque_Nm=1,torque_Nm=2": "torque_Nm is given twice",
    "coulomb-friction:elbow.x:torque_Nm=1": "place 'elbow.x' has too many words; it sits at a joint",
    "coulomb-friction:elbow:a:b": "has too many colons",
    "warming:elbow:warming_K=1": "place 'elbow' has too many words; it has no place",
    "tool-offset:drill.y:offset_mm=200": "offset_mm: 200 is outside -100 .. 100",
    "tool-offset:drill.w:offset_mm=2": "place: axis 'w' is not known; there are x, y, z",
    "link-stiffness:arm6:factor=1.1": "frame: arm6 has no spring; there are arm1, arm2, arm3, arm4, arm5",
    "link-torsion:arm1:compliance_rad_Nm=1e-6": "the spring of arm1 is the rover's; take rover-compliance",
    "link-length:tool.x:length_m=0.001": "tool is no link; take tool-offset",
    "frame-error:tool:screw=[0,0,0,0,0,0]": "tool: an effect at frame tool names its tool; write tool.NAME",
    "frame-error:arm3:screw=[0,0,0]": "screw[4]: is missing",
    "frame-error:arm3:screw=[0,0,0,0,0,9]": "screw: 9 is outside -0.1 .. 0.1",
    "transmission-error:elbow:cosine_rad=0,sine_rad=0,turns=1.5": "turns: should be a valid integer, not 1.5",
    "": "effect '' is not known",
}


@pytest.mark.parametrize("text", RIGHT)
def test_what_is_written_rightly_is_read(text):
    assert parse_effect_text(text, TOOLS) == RIGHT[text]


@pytest.mark.parametrize("text", WRONG)
def test_what_is_written_wrongly_is_refused_with_what_would_be_right(text):
    with pytest.raises(BadEffect, match=WRONG[text].replace("[", r"\[")):
        parse_effect_text(text, TOOLS)


SCENARIO = """
title = "Still"
summary = "Nothing to do."
[[command]]
type = "UNSTOW"
[[effect]]
type = "coulomb-friction"
joint = "elbow"
torque_Nm = 25
[[effect]]
type = "encoder-zero"
joint = "wrist"
offset_deg = 0.1
[[check]]
type = "done"
"""


def test_a_scenario_switches_effects_on_from_the_beginning_or_once_the_run_begins():
    scenario = parse_scenario(SCENARIO, "still", "still.toml")
    nominal = arm_named("nominal")
    arm = scenario.fit_arm(nominal)
    assert arm.effects == (CoulombFriction(Joint.ELBOW, 25.0),)
    setup = scenario_setup(scenario, arm, lab.true_reference(nominal), 0)
    assert [type(effect) for effect in setup.effects if effect in scenario.effects] == [EncoderZero]


@pytest.mark.parametrize(
    ("right", "wrong", "expected"),
    [
        ('"encoder-zero"', '"encoder-zeros"', r"type: effect 'encoder-zeros' is not known; did you mean"),
        ('"encoder-zero"', '"joint-seized"', r"type: joint-seized comes at a moment; write it as"),
        ('type = "encoder-zero"', "", "type: is missing; write the name of an effect"),
    ],
)
def test_an_effect_in_a_scenario_is_refused_with_its_key(right, wrong, expected):
    with pytest.raises(BadScenario, match=rf"effect\[2\]\.{expected}"):
        parse_scenario(SCENARIO.lstrip().replace(right, wrong), "still", "still.toml")


ARM = arm_named("nominal")
LAST = len(SWITCHES) - 1
NO_SCREW = (0.0,) * 6
NO_SUCH_TOOL = "tool: scoop is not a tool of this arm; there are drill, drt, mahli, apxs, portion"
NO_SUCH_SWITCH = f"index: {LAST + 1} is outside 0 .. {LAST}, the range of switch_closed of this arm"
DEAD = SensorFault(1.0, "switch_closed", "biased", LAST + 1, -1.0)
MISFITS = {
    "fault of a switch": (DEAD, NO_SUCH_SWITCH),
    "offset": (ToolOffset("scoop", "x", 1e-3), NO_SUCH_TOOL),
    "frame error": (FrameError(Frame.TOOL, NO_SCREW, "scoop"), NO_SUCH_TOOL),
    "warming": (LinkWarming(Frame.TOOL, 10.0, "scoop"), NO_SUCH_TOOL),
    "play": (FramePlay(Frame.TOOL, NO_SCREW, "scoop"), NO_SUCH_TOOL),
}


@pytest.mark.parametrize(("effect", "problem"), MISFITS.values(), ids=MISFITS)
def test_what_the_arm_lacks_is_refused_in_one_sentence(effect, problem):
    for refuse in (
        lambda: ARM.with_effects((effect,)),
        lambda: ClosedLoop(Setup(ARM, World(), ARM.params.poses.ready_rad, effects=(effect,))),
    ):
        with pytest.raises(EffectMisfit) as refused:
            refuse()
        assert str(refused.value) == f"effect {type(effect).__name__}: {problem}"


def test_what_the_arm_has_is_allowed():
    check_effects((replace(DEAD, index=LAST), replace(DEAD, index=None)), ARM.params)
    check_effects((ToolOffset(tool, "x", 1e-3) for tool in TOOLS), ARM.params)
    with pytest.raises(EffectMisfit, match="index: this arm has no contact switch"):
        check_effects((replace(DEAD, index=0),), replace(ARM.params, switches=()))


def test_a_request_is_refused_before_anything_moves():
    text = f"sensor-fault:switch_closed.biased:at_s=1,index={LAST + 1},size=-1"
    with pytest.raises(BadRequest, match=r"effect SensorFault: index: 10 is outside 0 \.\. 9"):
        prepare_placement(PlaceRequest(effects=(text,)))


ROOT = Path(__file__).parents[3]


@pytest.fixture
def dent(tmp_path: Path) -> Path:
    """Copy the example of the documentation."""
    file = tmp_path / "dent.py"
    file.write_text((ROOT / "examples" / "own_effect.py").read_text())
    return file


def test_the_example_of_the_documentation_holds_a_joint_as_it_says(dent):
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
def test_what_is_wrong_with_it_is_said(dent, rest, expected):
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
