"""An arm is its arm.toml: plant and flight parameters agree with it, and what is wrong in it is named."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.arm_model.description import BadArm
from sim.arm_model.load import ARMS, arm_names, default_arm, load_arm
from sim.arm_model.mismatch import find_mismatches
from sim.arms import UnknownArm, arm_named
from sim.effects.effect import params_with_effects
from sim.params import nominal_params, params_over_nominal
from sim.plant import Plant
from sim.world import World, build

NAMES = arm_names()


@pytest.mark.parametrize("name", NAMES)
def test_the_plant_has_the_tools_switches_and_gears_of_the_flight_parameters(name: str) -> None:
    arm = load_arm(name)
    plant = Plant(build(World(), arm).compile())
    assert plant.tools == arm.params.tool_names
    assert plant.switches == tuple(switch.name for switch in arm.params.switches)
    joints = arm.params.joints.in_order()
    assert plant.half_backlash_rad == pytest.approx([0.5 * joint.backlash_rad for joint in joints], abs=1e-15)
    assert plant.stop_rad().tolist() == [joint.hardstop_rad for joint in joints]


@pytest.mark.parametrize("name", NAMES)
def test_an_arm_opens_by_itself_in_mujoco(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(ARMS / name / "arm.xml"))
    assert model.njnt == 6 * 5 + 2 * len(Joint)


@pytest.mark.parametrize("name", NAMES)
def test_the_written_flight_parameters_read_back_exactly(name: str) -> None:
    if load_arm(name) is default_arm():
        assert params_over_nominal(ARMS / name / "flight.toml") == load_arm(name).params


def test_an_arm_without_looks_shows_its_shapes(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text((ARMS / default_arm().name / "arm.toml").read_text())
    arm = load_arm(str(tmp_path))
    shown = build(World(), arm, for_pictures=True).compile()
    assert shown.ngeom > build(World(), arm).compile().ngeom
    assert arm.params == default_arm().params


def test_the_same_description_makes_the_same_plant_and_another_one_does_not(tmp_path: Path) -> None:
    text = (ARMS / default_arm().name / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text(text.replace("a_m = 0.827", "a_m = 0.9"))
    longer = load_arm(str(tmp_path))
    assert longer.params.links.arm3.transform.a_m == 0.9
    assert longer.params.model.sha256 != default_arm().params.model.sha256
    here, there = (build(World(), arm).compile() for arm in (default_arm(), longer))
    tool = here.site("drill").id
    assert abs(np.linalg.norm(_reach(there, tool)) - np.linalg.norm(_reach(here, tool))) > 0.05


def _reach(model: mujoco.MjModel, site: int) -> np.ndarray:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.asarray(data.site_xpos[site] - data.body("link1").xpos)


WRONG = {
    "a missing field": ("gear_ratio = 7520.0\n", "", "actuators.lphta.gear_ratio: is missing"),
    "an unknown field": ("resistance_Ohm = 2.0", "ohm = 2.0", "actuators.lphta.ohm: is not a parameter"),
    "an unknown actuator": (
        'actuator = "water"',
        'actuator = "air"',
        "joints.wrist.actuator: 'air' is not known",
    ),
    "an unknown tool": (
        'tool = "apxs", p_m',
        'tool = "apx", p_m',
        "switches.apxs_1.tool: 'apx' is not known",
    ),
    "a tool without a switch": (
        'instrument = "apxs"',
        'instrument = "portion"',
        "portion has no contact switch",
    ),
    "a shape that is none": ("radius_m = 0.056", "turn_rad = 0.1", "shapes.link3.0: is no shape"),
    "a pose beyond a limit": (
        "ready_rad = [0.0,",
        "ready_rad = [3.0,",
        "poses.ready_rad: joint azimuth: 3.0 is outside",
    ),
    "a short link": ("a_m = 0.785", "a_m = 0.1", "links.arm4.transform.a_m: 0.1 is below"),
    "no TOML": ("[actuators.lphta]", "[actuators.lphta", "is not TOML"),
}


@pytest.mark.parametrize(("old", "new", "text"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_in_a_description_is_named(tmp_path: Path, old: str, new: str, text: str) -> None:
    right = (ARMS / default_arm().name / "arm.toml").read_text()
    assert old in right
    (tmp_path / "arm.toml").write_text(right.replace(old, new))
    with pytest.raises(UnknownArm, match=text.replace("(", r"\(")):
        arm_named(str(tmp_path))


def test_an_arm_that_is_not_there_is_named_with_those_that_are(tmp_path: Path) -> None:
    with pytest.raises(BadArm, match=f"there are {', '.join(NAMES)}"):
        load_arm(str(tmp_path))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("kind", ["as-built", "calibrated"])
def test_the_parameters_of_a_built_arm_fit_its_drawing(kind: str, seed: int) -> None:
    arm = arm_named(f"{kind}:{seed}")
    assert not list(find_mismatches(arm.params, arm.model))
    assert not list(find_mismatches(params_with_effects(arm.effects, nominal_params()), arm.model))


def _with_link(params: Params, a_m: float) -> Params:
    link = params.links.arm3
    return replace(
        params, links=replace(params.links, arm3=replace(link, transform=replace(link.transform, a_m=a_m)))
    )


def test_a_link_beyond_five_sigma_is_a_mismatch_and_one_within_is_none() -> None:
    params, sigma_m = nominal_params(), default_arm().description.tolerances.built.frame_m
    assert not list(find_mismatches(_with_link(params, 0.827 + 4.9 * sigma_m), default_arm()))
    (found,) = find_mismatches(_with_link(params, 0.827 + 5.1 * sigma_m), default_arm())
    assert found.startswith("links.arm3.transform: differs from that of the arm by 0.00765 m")


def test_parameters_of_another_arm_are_a_mismatch_whatever_their_values() -> None:
    params = nominal_params()
    foreign = replace(params, model=replace(params.model, name="other"))
    assert list(find_mismatches(foreign, default_arm())) == ["model: these are of the arm other, not of msl"]
