"""Catalogue: every effect has a summary, places and parameter specifications."""

import pytest

import sim.effects.gears
from fsw.dictionary.enums import Frame, Joint
from sim.effects.catalogue import (
    all_places,
    catalogue,
    effect_classes_in,
    effect_place_text,
    hypotheses,
    parameters_of,
    scaled_value,
)
from sim.effects.effect import Effect
from sim.effects.geometry import FrameError
from sim.effects.structure import LinkBending
from sim.scenario.effects import effect_text, parse_effect_text
from tests.tools import TOOLS

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


def test_all_that_was_asked_for_is_there_and_can_be_raced() -> None:
    hypothesised = {hypothesis.kind for hypothesis in HYPOTHESES}
    assert [name for name in ASKED_FOR if catalogue().get(name) not in hypothesised] == []


def test_every_effect_of_a_file_is_in_the_catalogue_by_its_name() -> None:
    names = [kind.__name__ for kind in effect_classes_in(sim.effects.gears)]
    assert names[:2] == ["CoulombFriction", "AsymmetricFriction"]
    assert set(effect_classes_in(sim.effects.gears)) <= set(catalogue().values())
    assert not [name for name in catalogue() if name.startswith("-") or name != name.lower()]


@KINDS
def test_the_typical_size_of_a_parameter_twice_over_is_within_its_bounds(kind: type[Effect]) -> None:
    for parameter in parameters_of(kind):
        size = parameter.spec
        if size is not None and parameter.is_amplitude:
            assert size.low <= size.neutral <= size.high
            assert size.low <= scaled_value(parameter, 2.0) <= size.high or kind.__name__ == "WeakMotor"
        elif size is not None:
            assert size.low <= size.typical <= size.high


@KINDS
def test_every_effect_comes_back_from_what_is_written_of_it(kind: type[Effect]) -> None:
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


def test_hypotheses_are_all_different_and_have_names_of_their_own() -> None:
    names = [str(hypothesis) for hypothesis in HYPOTHESES]
    assert len(set(names)) == len(names)
    assert "coulomb-friction:elbow" in names
    assert "link-bending:arm3.z" in names
    assert "warming" in names


def test_a_hypothesis_has_one_place_and_its_sizes_open() -> None:
    (one,) = (hypothesis for hypothesis in HYPOTHESES if str(hypothesis) == "flex-cable:wrist")
    assert [p.field for p in one.amplitudes] == ["stiffness_Nm_rad", "drag_Nm"]
    effect = one.effect(drag_Nm=2.0)
    assert (effect.joint, effect.stiffness_Nm_rad, effect.drag_Nm) == (Joint.WRIST, 0.0, 2.0)


def test_places_that_a_class_refuses_are_none() -> None:
    assert {place["frame"] for place in all_places(LinkBending)} == {*Frame} - {
        Frame.ARM1,
        Frame.ARM6,
        Frame.TOOL,
    }
    of_tools = [place["tool"] for place in all_places(FrameError) if place["frame"] is Frame.TOOL]
    assert of_tools == list(TOOLS)
    assert effect_place_text(FrameError, {"frame": Frame.TOOL, "tool": "mahli"}) == "tool.mahli"
