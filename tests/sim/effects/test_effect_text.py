"""Effects as text and in scenarios: read, refused, and not for every arm."""

from dataclasses import replace
from math import pi

import pytest

from fsw.dictionary.enums import Frame, Joint
from marsarm.runs.place import prepare_placement
from marsarm.runs.request import PlaceRequest
from sim.arms import arm_named
from sim.effects.effect import Effect, EffectMisfit, check_effects
from sim.effects.faults import SensorFault
from sim.effects.gears import CoulombFriction, StribeckFriction
from sim.effects.geometry import FrameError, FramePlay, LinkAngle, LinkWarming, ToolOffset
from sim.effects.sensors import EncoderZero
from sim.effects.structure import LinkMass
from sim.loop import ClosedLoop, Setup
from sim.scenario.effects import BadEffect, parse_effect_text
from sim.scenario.file import BadScenario, parse_scenario
from sim.scenario.run import scenario_setup
from sim.setting import World
from simgap.common.errors import BadRequest
from tests.sim import lab
from tests.tools import SWITCHES, TOOLS

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
def test_what_is_written_rightly_is_read(text: str) -> None:
    assert parse_effect_text(text, TOOLS) == RIGHT[text]


@pytest.mark.parametrize("text", WRONG)
def test_what_is_written_wrongly_is_refused_with_what_would_be_right(text: str) -> None:
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


def test_a_scenario_switches_effects_on_from_the_beginning_or_once_the_run_begins() -> None:
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
def test_what_the_arm_lacks_is_refused_in_one_sentence(effect: Effect, problem: str) -> None:
    for refuse in (
        lambda: ARM.with_effects((effect,)),
        lambda: ClosedLoop(Setup(ARM, World(), ARM.params.poses.ready_rad, effects=(effect,))),
    ):
        with pytest.raises(EffectMisfit) as refused:
            refuse()
        assert str(refused.value) == f"effect {type(effect).__name__}: {problem}"


def test_what_the_arm_has_is_allowed() -> None:
    check_effects((replace(DEAD, index=LAST), replace(DEAD, index=None)), ARM.params)
    check_effects((ToolOffset(tool, "x", 1e-3) for tool in TOOLS), ARM.params)
    with pytest.raises(EffectMisfit, match="index: this arm has no contact switch"):
        check_effects((replace(DEAD, index=0),), replace(ARM.params, switches=()))


def test_a_request_is_refused_before_anything_moves() -> None:
    text = f"sensor-fault:switch_closed.biased:at_s=1,index={LAST + 1},size=-1"
    with pytest.raises(BadRequest, match=r"effect SensorFault: index: 10 is outside 0 \.\. 9"):
        prepare_placement(PlaceRequest(effects=(text,)))
