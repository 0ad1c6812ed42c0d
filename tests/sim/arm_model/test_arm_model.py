"""An arm is its arm.toml: plant and flight parameters agree with it, and what is wrong in it is named."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import row6
from sim.arm_model.description import BadArm
from sim.arm_model.load import ARMS, arm_names, default_arm, load_arm
from sim.arm_model.mismatch import find_mismatches
from sim.arms import UnknownArm, arm_named, nominal_params, own_name, params_over
from sim.effects.effect import params_with_effects
from sim.params import read_params_toml
from sim.plant import Plant
from sim.setting import World
from sim.world import build

NAMES = arm_names()


@pytest.mark.parametrize("name", NAMES)
def test_the_plant_has_the_tools_switches_and_gears_of_the_flight_parameters(name):
    arm = load_arm(name)
    plant = Plant(build(World(), arm).compile())
    assert plant.tools == arm.params.tool_names
    assert plant.switches == tuple(switch.name for switch in arm.params.switches)
    joints = arm.params.joints.in_order()
    assert plant.half_backlash_rad == pytest.approx([0.5 * joint.backlash_rad for joint in joints], abs=1e-15)
    assert plant.stop_rad().tolist() == [joint.hardstop_rad for joint in joints]


@pytest.mark.parametrize("name", NAMES)
def test_an_arm_opens_by_itself_in_mujoco(name):
    model = mujoco.MjModel.from_xml_path(str(ARMS / name / "arm.xml"))
    assert model.njnt == 6 * 5 + 2 * len(Joint)


@pytest.mark.parametrize("name", NAMES)
def test_the_written_flight_parameters_read_back_exactly(name):
    drawing = load_arm(name).params
    assert params_over(drawing, ARMS / name / "flight.toml") == drawing
    assert read_params_toml(ARMS / name / "flight.toml")["model"]["name"] == name


def test_an_arm_without_looks_shows_its_shapes(tmp_path):
    (tmp_path / "arm.toml").write_text((ARMS / default_arm().name / "arm.toml").read_text())
    arm = load_arm(str(tmp_path))
    shown = build(World(), arm, for_pictures=True).compile()
    assert shown.ngeom > build(World(), arm).compile().ngeom
    assert arm.params == default_arm().params


def test_the_same_description_makes_the_same_plant_and_another_one_does_not(tmp_path):
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


TITANIUM = "<asset><material name='arm_titanium'/></asset>"
WRONG = [
    (
        'branch = "shoulder-in elbow-up wrist-up"',
        'branch = "elbow-elbow"',
        "teach.2.branch: 'elbow-elbow' is not known",
    ),
    ('"bit_box_2"', '"bit_box_1"', "teach.1.name: 'bit_box_1' is given twice"),
    ("approach_R = [-1.0, 0.0, 0.0]", "approach_R = [0.0, 0.0, 0.0]", "teach.0.approach_R: (0.0, 0.0, 0.0)"),
    ('of = "plant"', 'of = "moon"', "should be 'both', 'plant' or 'flight', not 'moon'"),
    ("gear_ratio = 7520.0", "gear_ratio = 0.0", "arm.toml: joints.azimuth.gear_ratio: 0.0 is outside"),
    ("gear_ratio = 7520.0\n", "", "actuators.lphta.gear_ratio: is missing"),
    ("resistance_Ohm = 2.0", "ohm = 2.0", "actuators.lphta.ohm: is not known"),
    ('actuator = "water"', 'actuator = "air"', "joints.wrist.actuator: 'air' is not known"),
    ('tool = "apxs", p_m', 'tool = "apx", p_m', "switches.apxs_1.tool: 'apx' is not known"),
    ('instrument = "apxs"', 'instrument = "portion"', "portion has no contact"),
    ("radius_m = 0.056", "turn_rad = 0.1", "shapes.link3.0: is no shape"),
    ("resistance_Ohm = 2.0", "resistance_Ohm = nan", "actuators.lphta.resistance_Ohm: must be finite"),
    ("armature_kg_m2 = 84.82", "armature_kg_m2 = 0.0", "actuators.lphta.armature_kg_m2: 0.0 is outside"),
    (
        "inertia_kg_m2 = [0.0388, 0.044, 0.0466]",
        "inertia_kg_m2 = [0.01, 0.01, 0.0466]",
        "links.arm5.near.inertia_kg_m2: (0.01, 0.01, 0.0466) has a moment above the sum",
    ),
    ("stiffness = [33.3e3, 125e3, 38.6e3", "stiffness = [33.3e3, 125e3, 0.0", "677000.0, 2190000.0) has a"),
    (
        "near = { mass_kg = 1.4, com_m = [0.02, 0.0, -0.245], inertia_kg_m2 = [0.0296, 0.0296, 0.0434] }",
        "",
        "links.arm6.near: is missing",
    ),
    (
        "hardstops_rad = [-2.90074, 2.90074]",
        "hardstops_rad = [-2.90074, 2.8]",
        "joints.elbow.hardstops_rad: 2.8 is not above the upper soft limit",
    ),
    (
        "pad_solref = [-99000.0, -990.0]",
        "pad_solref = [0.02, 1.0]",
        "tools.drill.pad_solref: (0.02, 1.0) has a number that is not negative",
    ),
    ("frame_rad = 2e-3", "frame_rad = 0.0", "tolerances.built.frame_rad: 0.0 is outside"),
    ("[tools.portion]", "[tools.link2]", "tools.link2: is the name of another"),
    ("[tools.portion]", "[tools.Portion]", "tools.Portion: is no name"),
    ("drt_1 = {", "drt = {", "switches.drt: is the name of a tool"),
    ("drt_1 = {", "arm6 = {", "switches.arm6: is the name of another part"),
    ("radius_m = 0.056 }", "radius_m = 0.056, turn_rad = 0.1 }", "shapes.link3.0: turn_rad: turns a box"),
    ("radius_m = 0.056 }", "radius_m = 0.0 }", "shapes.link3.0: radius_m: 0.0 is outside"),
    (
        "bare_hardstop_park_rad = [-3.139847324337799",
        "bare_hardstop_park_rad = [-3.2",
        "poses.bare_hardstop_park_rad: joint azimuth: -3.2 is outside",
    ),
    (
        "[poses]",
        "[flight.links.arm3]\nstiffness = 1.0\n[flight.hardstop]\nstart_rad = [0.0]\n[poses]",
        "arm.toml: flight.links, flight.hardstop.start_rad: other tables set this",
    ),
    ('name = "msl"', 'name = "my/arm"', "name: 'my/arm' is no name of an arm"),
    ("[actuators.lphta]", "[actuators.lphta", "is not TOML"),
]


@pytest.mark.parametrize(("old", "new", "text"), WRONG)
def test_what_is_wrong_in_a_description_is_named(tmp_path, old, new, text):
    right = (ARMS / default_arm().name / "arm.toml").read_text()
    assert old in right
    (tmp_path / "arm.toml").write_text(right.replace(old, new))
    with pytest.raises(UnknownArm, match=re.escape(text)):
        arm_named(str(tmp_path))


WRONG_LOOKS = {
    "no XML": ("<visual>", "is not XML: no element found"),
    "no material": ("<visual/>", "asset: has no material arm_titanium"),
    "an unknown body": (f"<visual>{TITANIUM}<body name='link9'/></visual>", "body 'link9' is not one of"),
    "an unknown geom": (
        f"<visual>{TITANIUM}<body name='link2'><geom type='ring' size='1'/></body></visual>",
        "arm msl: MuJoCo does not accept its plant",
    ),
    "a geom of the scene": (
        f"<visual>{TITANIUM}<body name='link2'><geom name='ground' size='1 1'/></body></visual>",
        "arm msl: MuJoCo does not accept its plant",
    ),
}


@pytest.mark.parametrize(("looks", "text"), WRONG_LOOKS.values(), ids=WRONG_LOOKS)
def test_what_is_wrong_in_the_looks_is_named(tmp_path, looks, text):
    (tmp_path / "arm.toml").write_text((ARMS / default_arm().name / "arm.toml").read_text())
    (tmp_path / "visual.xml").write_text(looks)
    with pytest.raises(UnknownArm, match=re.escape(text)):
        arm_named(str(tmp_path))


def test_flight_parameters_of_an_arm_replace_those_of_all_arms(tmp_path):
    text = (ARMS / default_arm().name / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text(f"{text}\n[flight.motion]\ntool_speed_m_s = 0.04\n")
    assert load_arm(str(tmp_path)).params.motion.tool_speed_m_s == 0.04


def test_an_arm_that_is_not_there_is_named_with_those_that_are(tmp_path):
    with pytest.raises(BadArm, match=f"there are {', '.join(NAMES)}"):
        load_arm("other")
    with pytest.raises(BadArm, match=r"this folder has no arm\.toml"):
        load_arm(str(tmp_path))


@pytest.mark.parametrize("seed", range(1, 4))
@pytest.mark.parametrize("kind", ["as-built", "calibrated"])
@pytest.mark.parametrize("name", NAMES)
def test_the_parameters_of_a_built_arm_fit_its_drawing(name, kind, seed):
    arm = arm_named(f"{name}/{kind}:{seed}")
    assert not list(find_mismatches(arm.params, arm.model))
    assert not list(find_mismatches(params_with_effects(arm.effects, arm.model.params), arm.model))


def _with_link(params: Params, a_m: float) -> Params:
    link = params.links.arm3
    return replace(
        params, links=replace(params.links, arm3=replace(link, transform=replace(link.transform, a_m=a_m)))
    )


def test_a_link_beyond_five_sigma_is_a_mismatch_and_one_within_is_none():
    params, sigma_m = nominal_params(), default_arm().description.tolerances.built.frame_m
    assert not list(find_mismatches(_with_link(params, 0.827 + 4.9 * sigma_m), default_arm()))
    (found,) = find_mismatches(_with_link(params, 0.827 + 5.1 * sigma_m), default_arm())
    assert found.startswith("links.arm3.transform: differs from that of the arm by 0.00765 m")


def test_parameters_of_another_arm_are_a_mismatch_whatever_their_values():
    params = nominal_params()
    foreign = replace(params, model=replace(params.model, name="other"))
    assert list(find_mismatches(foreign, default_arm())) == ["model: these are of the arm other, not of msl"]


FOREIGN = {
    "output_friction_Nm": "[joints.elbow]\noutput_friction_Nm = 30.0",
    "hardstop_stiffness_Nm_rad": "[joints.elbow]\nhardstop_stiffness_Nm_rad = 6e5",
    "torque_constant_Nm_A": "[joints.elbow]\ntorque_constant_Nm_A = 229.0",
    "elastic_centre_m": "[links.arm3]\nelastic_centre_m = [0.45, 0.0, 0.0]",
    "expansion_1_K": "[links.arm3]\nexpansion_1_K = [0.0, 0.0, 0.0, 2e-5, 0.0, 0.0]",
    "geometry": "[tools.apxs.geometry]\nboxes = [{ centre_m = [0.0, 0.0, 0.0], half_m = [0.1, 0.1, 0.1] }]",
    "gear_ratio": "[joints.elbow]\ngear_ratio = 7000.0",
}


@pytest.mark.parametrize("what", FOREIGN)
def test_parameters_of_the_mechanism_beyond_its_tolerances_are_a_mismatch(tmp_path, what):
    (tmp_path / "own.toml").write_text(FOREIGN[what])
    (found,) = find_mismatches(params_over(nominal_params(), tmp_path / "own.toml"), default_arm())
    assert what in found


def test_a_link_whose_springs_are_coupled_is_a_mismatch():
    params = nominal_params()
    rows = [list(row) for row in params.links.arm3.compliance]
    rows[1][5] = rows[5][1] = 0.5 * (rows[1][1] * rows[5][5]) ** 0.5
    a, b, c, d, e, f = (row6(row) for row in rows)
    link = replace(params.links.arm3, compliance=(a, b, c, d, e, f))
    coupled = replace(params, links=replace(params.links, arm3=link))
    (found,) = find_mismatches(coupled, default_arm())
    assert found.startswith("links.arm3.compliance.1.5: 9.556e-07 is not 0")


@pytest.mark.parametrize(
    ("names", "own"),
    [
        (["nominal", "msl", "msl/nominal"], "nominal"),
        (["as-built:7", "as-built:07", "msl/as-built:7"], "as-built:7"),
        (["m2020", "m2020/nominal"], "m2020/nominal"),
        (["m2020/calibrated:3", "m2020/calibrated:003"], "m2020/calibrated:3"),
    ],
)
def test_all_names_of_an_arm_are_one_arm(names, own):
    arms = [arm_named(name) for name in names]
    assert {arm.name for arm in arms} == {own_name(name) for name in names} == {own}
    assert all(arm == arms[0] for arm in arms)


def test_an_arm_in_a_folder_keeps_the_name_that_leads_there_but_its_parameters_do_not(tmp_path, monkeypatch):
    text = (ARMS / default_arm().name / "arm.toml").read_text()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "arm.toml").write_text(text.replace('name = "msl"', 'name = "third"'))
    monkeypatch.chdir(tmp_path)
    arms = [
        arm_named(name) for name in ("mine/as-built:7", "./mine/as-built:07", f"{tmp_path}/mine/as-built:7")
    ]
    assert [arm.name for arm in arms][:2] == ["mine/as-built:7", "./mine/as-built:07"]
    assert {arm.params.arm_name for arm in arms} == {"third/as-built:7"}
