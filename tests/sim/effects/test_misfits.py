"""Effects and faults at tools or contact switches that an arm does not have are refused before a run."""

from dataclasses import replace

import pytest

from fsw.dictionary.enums import Frame
from marsarm.runs.place import prepare_placement
from marsarm.runs.request import PlaceRequest
from sim.arms import arm_named
from sim.effects.effect import Effect, EffectMisfit, check_effects
from sim.effects.faults import SensorFault
from sim.effects.geometry import FrameError, FramePlay, LinkWarming, ToolOffset
from sim.loop import ClosedLoop, Setup
from sim.scenario.file import BadScenario, parse_scenario
from sim.setting import World
from simgap.common.errors import BadRequest
from tests.tools import SWITCHES, TOOLS

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


def test_a_scenario_names_its_fault() -> None:
    text = """title = "T"
summary = "S."
start = "ready"
[[command]]
type = "STOW"
[[fault]]
type = "SENSOR_FAULT"
at_s = 1.0
sensor = "switch_closed"
kind = "biased"
index = 12
size = -1.0
[[check]]
type = "faulted"
"""
    with pytest.raises(BadScenario, match=r"a\.toml: fault\[1\]: index: 12 is outside 0 \.\. 9"):
        parse_scenario(text, "a", "a.toml")
