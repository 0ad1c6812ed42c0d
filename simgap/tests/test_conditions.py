"""Conditions: logs of several masses and lengths form one diagnosis, and an effect may follow a number."""

import math
import re

import mujoco
import numpy as np
import pytest

from helpers.robot_folder import write_robot
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.command.check import check_robot, simulate_nominal
from simgap.command.request import CheckRequest
from simgap.common.errors import RobotError
from simgap.compare import compare
from simgap.diagnosis import diagnose, list_variations
from simgap.effects.variation import Variation
from simgap.loading import Member, find_members, load
from simgap.residuals.simulation_residuals import list_kinds
from simgap.robot import Robot
from simgap.simulation.compiled import Models

MODEL = """<mujoco model="pendulum">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" range="-3 3"/>
      <inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
      <body name="weight" pos="0 0 -0.3">
        <inertial pos="0 0 0" mass="0.5" diaginertia="1e-5 1e-5 1e-5"/>
      </body>
    </body>
  </worldbody>
  <option timestep="0.001"/><actuator><position joint="hinge" kp="9"/></actuator>
</mujoco>
"""
ROBOT = """name = "pendulum"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 500.0
time = { column = "t" }
motion = { columns = ["motion"] }

[conditions.mass_kg]
column = "mass_g"
sets = [{ element = "body", name = "weight", attribute = "inertial/mass", factor = 0.001 }]

[conditions.length_m]
column = "length"
sets = [{ element = "body", name = "weight", attribute = "pos", index = 2, factor = -1.0 }]

[joints.hinge]
mode = "position"
position = { column = "q", unit = "rad" }
torque = { column = "tau", unit = "N m" }
kp_Nm_rad = 20.0
"""
SETS_MASS = '"body", name = "weight", attribute = "inertial/mass"'
SETUPS = [(200.0, 0.2), (200.0, 0.3), (500.0, 0.2), (500.0, 0.3), (800.0, 0.2), (800.0, 0.3)]
FRICTION_Nm = 0.2
ADDED_Nm_kg = 1.0


def needed_Nm(mass_g, length_m, q, v, a):
    mass_kg = 1e-3 * mass_g
    inertia = 0.2 * 0.1**2 + 1e-4 + mass_kg * length_m**2 + 1e-5
    lever = 0.2 * 0.1 + mass_kg * length_m
    return np.asarray(inertia * a + 9.81 * lever * np.sin(q) + FRICTION_Nm * np.tanh(v / 0.01))


def read(folder, *changes, **options):
    """Write a pendulum and its logs; return the robot, and the path of the logs."""
    path = write_robot(folder, *changes, model=MODEL, text=ROBOT)
    return Robot.from_toml(path), write_log(folder / "log.csv", **options)


def write_log(path, added_Nm_kg=0.0, seed=1):
    """Write logs in which a constant torque may be in proportion to the mass."""
    t = np.arange(0.0, 4.0, 0.01)
    rng = np.random.default_rng(seed)
    lines = ["t,motion,mass_g,length,q,tau"]
    for k, (mass_g, length_m) in enumerate(SETUPS):
        w = 2.0 + 0.3 * k
        q, v, a = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
        tau = needed_Nm(mass_g, length_m, q, v, a) - added_Nm_kg * 1e-3 * mass_g
        shown = q + rng.normal(0.0, 1e-5, t.size), tau + rng.normal(0.0, 2e-3, t.size)
        rows = zip(t, *shown, strict=True)
        lines += [f"{one:.9g},{k},{mass_g},{length_m},{x:.9g},{y:.9g}" for one, x, y in rows]
    path.write_text("\n".join(lines))
    return path


def residual_model(robot, log):
    motions = load(robot, log).motions
    (kind,) = list_kinds(robot, motions, None)
    return kind.make(motions, False)


def test_each_motion_is_predicted_by_the_model_of_its_set_up(tmp_path):
    robot, log = read(tmp_path)
    model = residual_model(robot, log)
    assert model.motions == tuple(map(str, range(len(SETUPS))))
    logs = load(robot, log)
    friction = next(one for one in base_effects(robot, logs) if one.name == "Coulomb friction")
    (left,) = model.residuals([friction], np.array([[FRICTION_Nm]]))
    by_motion = [float(np.std(left[model.motion_of == k])) for k in range(len(SETUPS))]
    assert max(by_motion) < 5e-3
    some = model.select(["4", "1"])
    assert some.motions == ("1", "4")
    (kept,) = some.residuals([friction], np.array([[FRICTION_Nm]]))
    assert np.array_equal(np.sort(kept), np.sort(left[np.isin(model.motion_of, [1, 4])]))


def test_logs_of_all_set_ups_form_one_diagnosis_and_a_held_out_condition_judges_it(tmp_path):
    robot, log = read(tmp_path)
    logs = load(robot, log, held_out=["mass_kg=800"])
    assert {motion.name for motion in logs.judged} == {"4", "5"}
    found = diagnose(robot, logs.fit, held_out=logs.judged, base_only=True)
    (error,) = found.errors
    assert error.nominal > 0.1
    assert error.explained < 5e-3
    (coulomb,) = (one for one in found.base if one.name == "coulomb_Nm")
    assert coulomb.value == pytest.approx(FRICTION_Nm, rel=0.02)


@pytest.mark.slow
def test_an_effect_may_follow_a_condition(tmp_path):
    change = ('column = "mass_g"', 'column = "mass_g"\neffects = ["constant torque"]')
    robot, log = read(tmp_path, change, added_Nm_kg=ADDED_Nm_kg)
    found = diagnose(robot, load(robot, log).motions)
    (finding,) = found.findings
    assert (finding.place, finding.effect) == ("hinge", "constant torque by mass_kg")
    sized = zip(found.sizes, found.effects, strict=True)
    (size,) = (one for one, effect in sized if isinstance(effect, Variation))
    assert 1e3 * size[0] == pytest.approx(ADDED_Nm_kg, rel=0.03)
    assert not any(isinstance(effect, Variation) for effect in found.of_model()[0])


@pytest.mark.slow
def test_what_follows_a_condition_in_two_sets_is_no_change(tmp_path):
    change = ('column = "mass_g"', 'column = "mass_g"\neffects = ["constant torque"]')
    robot, log = read(tmp_path, change, added_Nm_kg=ADDED_Nm_kg)
    other = write_log(tmp_path / "after.csv", added_Nm_kg=ADDED_Nm_kg, seed=2)
    found = compare(robot, load(robot, log).motions, load(robot, other).motions).found
    assert found.findings == ()
    assert [effect.name for effect in found.effects if isinstance(effect, Variation)] == [
        "constant torque by mass_kg"
    ]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('name = "weight"', 'name = "load"'), "sets[1]: the model has no <body> 'load'; it has"),
        (("index = 2", "index = 3"), "pos of 'weight' has 3 numbers in the model"),
        (('column = "length"', "values = { 0 = 0.2 }"), "motion '1' has no value; add it, or its log file"),
        (('column = "length"', "values = { 9 = 0.2 }"), "'9' is no motion"),
        (("inertial/mass", "inertial/diaginertia"), "robot.toml: sets of conditions: "),
        (('"inertial/mass"', '"pos", index = 2'), "conditions.mass_kg.sets[1] sets this number too"),
        ((SETS_MASS, '"option", attribute = "timestep"'), "time_step_s sets this number too; keep one"),
        ((SETS_MASS, '"position", attribute = "kp"'), "joints.hinge.kp_Nm_rad sets this number too"),
        (('column = "length"', 'column = "length"\neffects = ["a", "A"]'), "effects: 'a' stands there twice"),
        (('column = "length"', ""), "column and values: give one of the two"),
        (
            ("factor = 0.001 }]", "factor = 0.001 }]\npossible = [-1.0]"),
            "with mass_kg = -1, mass is -0.001",
        ),
        (("[joints", "[conditions.day]\ncolumn = 't'\npossible = [2.0]\n[joints"), "give sets or effects"),
        (('"position"', '"position"\npossible_rad = [-4.0, 1.0]'), "leaves the range -3 to 3 of the model"),
        (('"position"', '"position"\npossible_rad = [1.0, 1.0]'), "write two positions, the lower one first"),
        (('"position"', '"position"\npossible_rad = [1.0]'), "write two positions, the lower one first"),
    ],
)
def test_a_condition_that_cannot_be_is_refused(tmp_path, change, said):
    with pytest.raises(RobotError, match=re.escape(said)):
        residual_model(*read(tmp_path, change))


def test_a_check_simulates_each_motion_with_the_model_of_its_set_up(tmp_path):
    robot, log = read(tmp_path, ("torque = {", "command = {"), ('"position"', '"torque"'))
    report = check_robot(CheckRequest(robot.path, (log,)))
    for motion, nominal in zip(report.logs.motions, report.nominal, strict=True):
        expected = simulate_nominal(Models(robot.under(motion.conditions)), motion)
        assert nominal.mean_abs_rad == expected.mean_abs_rad


def test_a_check_tells_that_a_diagnosis_refuses_a_model_under_a_condition(tmp_path):
    robot, log = read(tmp_path, ("inertial/mass", "inertial/diaginertia"))
    assert "with mass_kg = 200" in check_robot(CheckRequest(robot.path, (log,))).refusal


def test_an_effect_cannot_follow_a_condition_that_is_neutral_in_all_fitted_motions(tmp_path):
    heavy = 'column = "mass_g"\neffects = ["constant torque"]\nneutral = 200.0'
    robot, log = read(tmp_path, ('column = "mass_g"', heavy))
    motions = [one for one in load(robot, log).motions if one.conditions["mass_kg"] == 200.0]
    found = diagnose(robot, motions)
    (rejected,) = (one for one in found.rejected if one.effect == "constant torque by mass_kg")
    assert rejected.reason == "mass_kg is 200 in all fitted motions"


def test_a_condition_is_held_out_by_its_number_however_it_is_written(tmp_path):
    robot, log = read(tmp_path)
    judged = [load(robot, log, held_out=[f"length_m={text}"]).judged for text in ("0.20", "0.2")]
    assert [one.name for one in judged[0]] == [one.name for one in judged[1]] != []
    members = [Member("v=1", ("", "", "m=2.5")), Member("v=1.00", ("", "", "m=3"))]
    assert find_members(["v=1.00", " m = 2.50"], members, "here") == {"v=1.00", "v=1"}
    with pytest.raises(RobotError, match=r"here: 'm=4\.0' is no motion"):
        find_members(["m=4.0"], members, "here")


def test_an_effect_that_no_joint_can_have_is_refused(tmp_path):
    robot, log = read(tmp_path, ('column = "mass_g"', 'column = "mass_g"\neffects = ["payloud"]'))
    logs = load(robot, log)
    with pytest.raises(RobotError, match="the effect 'payloud'; did you mean 'payload'"):
        list_variations(robot, logs, catalogue(robot, logs))
    report = check_robot(CheckRequest(tmp_path / "robot.toml", (log,)))
    assert "the effect 'payloud'; did you mean 'payload'" in report.refusal


def test_sizes_of_a_variation_have_the_bounds_of_the_effect_at_the_largest_number(tmp_path):
    robot, log = read(tmp_path, ('column = "mass_g"', 'column = "mass_g"\neffects = ["payload"]'))
    logs = load(robot, log)
    known = catalogue(robot, logs)
    (varied,) = list_variations(robot, logs, known)
    (effect,) = (one for one in known if one.name == "payload")
    assert varied.sizes[0].high == pytest.approx(effect.sizes[0].high / 800.0)
    assert math.isinf(varied.sizes[0].prior_std)


TWIN = """<mujoco model="twin"><compiler angle="radian" autolimits="true"/><worldbody>
<body name="shoulder" pos="0 0 0.181"><joint name="pan" axis="0 0 1" range="-6.28 6.28"/>
 <inertial pos="0 0 0" mass="7.369" diaginertia="0.0315 0.0315 0.0219"/>
 <body name="upper" pos="0 0.176 0" quat="0.7071068 0 0.7071068 0">
  <joint name="lift" axis="0 1 0" range="-6.28 6.28"/>
  <inertial pos="0 0 0.3062" mass="13.051" diaginertia="0.4218 0.4218 0.0363"/>
  <body name="forearm" pos="0 -0.137 0.6127"><joint name="elbow" axis="0 1 0" range="-3.14 3.14"/>
   <inertial pos="0 0 0.2859" mass="3.989" diaginertia="0.1111 0.1111 0.0109"/>
   <body name="first" pos="0 0 0.5716" quat="0.7071068 0 0.7071068 0">
    <joint name="wrist 1" axis="0 1 0" range="-6.28 6.28"/>
    <inertial pos="0 0.135 0" mass="2.1" diaginertia="0.0051 0.0051 0.0051"/>
    <body name="second" pos="0 0.135 0"><joint name="wrist 2" axis="0 0 1" range="-6.28 6.28"/>
     <inertial pos="0 0 0.12" mass="1.98" diaginertia="0.0051 0.0051 0.0051"/>
     <body name="third" pos="0 0 0.12"><joint name="wrist 3" axis="0 1 0" range="-6.28 6.28"/>
      <inertial pos="0 0.092 0" mass="0.615" diaginertia="0.0005 0.0005 0.0002"/>
      <site name="flange" pos="0 0.1168 0"/>
</body></body></body></body></body></body></worldbody></mujoco>"""
JOINTS = ("pan", "lift", "elbow", "wrist 1", "wrist 2", "wrist 3")
GIVEN_Nm_A = np.array([12.0, 12.0, 10.0, 9.0, 9.0, 9.0])
SCALE = 1.08
COULOMB_Nm = np.array([15.0, 15.0, 10.0, 3.0, 3.0, 3.0])
VISCOUS_Nms_rad = np.array([10.0, 10.0, 8.0, 2.0, 2.0, 2.0])
ROTOR_kgm2 = np.array([6.0, 6.0, 4.0, 1.0, 1.0, 1.0])
PAYLOAD_kg, CENTRE_M = 2.8, (0.03, 0.05, 0.015)
"""The centre is 6 cm from the flange."""
MIDDLE_RAD = np.array([0.0, -1.2, 0.0, 0.0, 0.0, 0.0])


def write_twin_log(path, payload_kg, seed):
    """Write motions of two waves a joint, with the currents that inverse dynamics needs."""
    spec = mujoco.MjSpec.from_string(TWIN)
    if payload_kg:
        load = spec.body("third").add_body(name="load", pos=np.array([0.0, 0.1168, 0.0]) + CENTRE_M)
        load.mass, load.inertia, load.explicitinertial = payload_kg, (0.002, 0.002, 0.002), True
        load.ipos = (0.0, 0.0, 0.0)  # not set, it would be the position of the body
    model = spec.compile()
    data, rng, t, rows = mujoco.MjData(model), np.random.default_rng(seed), np.arange(0.0, 8.0, 0.008), []
    for motion in range(4):
        middle = MIDDLE_RAD + rng.uniform(-1.5, 1.5, 6)
        size, rate = rng.uniform(0.2, 0.6, (2, 6)), rng.uniform(0.5, 2.5, (2, 6))
        phase = rng.uniform(0.0, 6.28, (2, 6))
        angle = t[:, None, None] * rate + phase
        q = middle + (size * np.sin(angle)).sum(axis=1)
        v, a = (size * rate * np.cos(angle)).sum(axis=1), -(size * rate**2 * np.sin(angle)).sum(axis=1)
        torque = np.empty_like(q)
        for k in range(t.size):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            torque[k] = data.qfrc_inverse
        torque += COULOMB_Nm * np.tanh(v / 0.01) + VISCOUS_Nms_rad * v + ROTOR_kgm2 * a
        current = torque / (GIVEN_Nm_A * SCALE) + rng.normal(0.0, 0.02, q.shape)
        shown = q + rng.normal(0.0, 2e-5, q.shape)
        rows.append(np.column_stack([t, np.full(t.size, motion), shown, current]))
    names = ["t", "motion", *(f"q {one}" for one in JOINTS), *(f"i {one}" for one in JOINTS)]
    np.savetxt(path, np.concatenate(rows), delimiter=",", header=",".join(names), comments="", fmt="%.9g")


TWIN_FILE = """name = "twin"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 125
tool_site = "flange"
time = { column = "t" }
motion = { columns = ["motion"] }

[conditions.loaded]
values = { unloaded = 0.0, loaded = 1.0 }
effects = ["payload"]
"""


def write_twin(folder):
    joints = "".join(
        f"""
[joints."{name}"]
mode = "position"
position = {{ column = "q {name}", unit = "rad" }}
current = {{ column = "i {name}", unit = "A" }}
torque_constant_Nm_A = {given}
torque_constant_is_known = false
"""
        for name, given in zip(JOINTS, GIVEN_Nm_A, strict=True)
    )
    return Robot.from_toml(write_robot(folder, model=TWIN, text=TWIN_FILE + joints))


@pytest.mark.slow
def test_mass_and_centre_of_a_payload_are_found_with_the_scale_of_the_currents(tmp_path):
    robot = write_twin(tmp_path)
    write_twin_log(tmp_path / "unloaded.csv", 0.0, 1)
    assert {one.conditions["loaded"] for one in load(robot, [tmp_path / "unloaded.csv"]).motions} == {0.0}
    write_twin_log(tmp_path / "loaded.csv", PAYLOAD_kg, 2)
    logs = load(robot, [tmp_path / "unloaded.csv", tmp_path / "loaded.csv"])
    found = diagnose(robot, logs.fit)
    (finding,) = found.findings
    assert (finding.place, finding.effect) == ("wrist 3", "payload by loaded")
    sizes = {effect.key: size for effect, size in zip(found.effects, found.sizes, strict=True)}
    mass_kg, *centre_m = sizes["wrist 3: payload by loaded"]
    assert mass_kg == pytest.approx(PAYLOAD_kg, rel=0.05)
    assert np.linalg.norm(np.subtract(centre_m, CENTRE_M)) < 0.01
    for joint, given in zip(JOINTS, GIVEN_Nm_A, strict=True):
        scale = 1.0 + sizes[f"{joint}: scale of the current"][0] / given
        assert scale == pytest.approx(SCALE, rel=0.02)
