"""Conditions: logs of several masses and lengths form one diagnosis, and an effect may follow a number."""

import math

import numpy as np
import pytest

from helpers.robot_folder import changed
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.common.errors import RobotError
from simgap.diagnosis import diagnose, list_variations
from simgap.effects.variation import Variation
from simgap.loading import load
from simgap.residuals.simulation_residuals import list_kinds
from simgap.robot import Robot

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
</mujoco>
"""
ROBOT = """name = "pendulum"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 500.0

[time]
column = "t"

[motion]
columns = ["motion"]

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
"""
SETUPS = [(200.0, 0.2), (200.0, 0.3), (500.0, 0.2), (500.0, 0.3), (800.0, 0.2), (800.0, 0.3)]
FRICTION_Nm = 0.2
ADDED_Nm_kg = 1.0


def needed_Nm(mass_g, length_m, q, v, a):
    mass_kg = 1e-3 * mass_g
    inertia = 0.2 * 0.1**2 + 1e-4 + mass_kg * length_m**2 + 1e-5
    lever = 0.2 * 0.1 + mass_kg * length_m
    return np.asarray(inertia * a + 9.81 * lever * np.sin(q) + FRICTION_Nm * np.tanh(v / 0.01))


def write_folder(folder, *changes, added_Nm_kg=0.0):
    """Write a pendulum and its logs, in which a constant torque may be in proportion to the mass."""
    (folder / "model.xml").write_text(MODEL)
    (folder / "robot.toml").write_text(changed(ROBOT, *changes))
    t = np.arange(0.0, 4.0, 0.01)
    rng = np.random.default_rng(1)
    lines = ["t,motion,mass_g,length,q,tau"]
    for k, (mass_g, length_m) in enumerate(SETUPS):
        w = 2.0 + 0.3 * k
        q, v, a = np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)
        tau = needed_Nm(mass_g, length_m, q, v, a) - added_Nm_kg * 1e-3 * mass_g
        shown = q + rng.normal(0.0, 1e-5, t.size), tau + rng.normal(0.0, 2e-3, t.size)
        rows = zip(t, *shown, strict=True)
        lines += [f"{one:.9g},{k},{mass_g},{length_m},{x:.9g},{y:.9g}" for one, x, y in rows]
    (folder / "log.csv").write_text("\n".join(lines))
    return folder / "robot.toml", folder / "log.csv"


def residual_model(robot, log):
    motions = load(robot, log).motions
    (kind,) = list_kinds(robot, motions, None)
    return kind.make(motions, False)


def test_each_motion_is_predicted_by_the_model_of_its_set_up(tmp_path):
    path, log = write_folder(tmp_path)
    robot = Robot.from_toml(path)
    model = residual_model(robot, log)
    assert model.motions == tuple(map(str, range(len(SETUPS))))
    logs = load(robot, log)
    friction = next(one for one in base_effects(robot, logs) if one.name == "Coulomb friction")
    (left,) = model.residuals([friction], np.array([[FRICTION_Nm]]))
    by_motion = [float(np.std(left[model.motion_of == k])) for k in range(len(SETUPS))]
    assert max(by_motion) < 5e-3
    some = model.select(["4", "1"])
    assert some.motions == ("1", "4")
    assert np.array_equal(
        np.sort(some.residuals([friction], np.array([[FRICTION_Nm]]))[0]),
        np.sort(left[np.isin(model.motion_of, [1, 4])]),
    )


def test_logs_of_all_set_ups_form_one_diagnosis_and_a_held_out_condition_judges_it(tmp_path):
    path, log = write_folder(tmp_path)
    robot = Robot.from_toml(path)
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
    path, log = write_folder(tmp_path, change, added_Nm_kg=ADDED_Nm_kg)
    robot = Robot.from_toml(path)
    found = diagnose(robot, load(robot, log).motions)
    (finding,) = found.findings
    assert (finding.place, finding.effect) == ("hinge", "constant torque by mass_kg")
    sized = zip(found.sizes, found.effects, strict=True)
    (size,) = (one for one, effect in sized if isinstance(effect, Variation))
    assert 1e3 * size[0] == pytest.approx(ADDED_Nm_kg, rel=0.03)
    assert not any(isinstance(effect, Variation) for effect in found.of_model()[0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('name = "weight"', 'name = "load"'), "the model has 0 <body> named 'load'"),
        (("index = 2", "index = 3"), "pos of 'weight' has 3 numbers in the model"),
        (('column = "length"', "values = { 0 = 0.2 }"), "motion '1' has no value; add it, or its log file"),
        (('column = "length"', "values = { 9 = 0.2 }"), "'9' is no motion"),
        (("inertial/mass", "inertial/diaginertia"), "MuJoCo cannot compile it with mass_kg = 200"),
        (('column = "length"', ""), "column and values: give one of the two"),
    ],
)
def test_a_condition_that_cannot_be_is_refused(tmp_path, change, said):
    path, log = write_folder(tmp_path, change)
    with pytest.raises(RobotError) as refusal:
        residual_model(Robot.from_toml(path), log)
    assert said in str(refusal.value)


def test_an_effect_that_no_joint_can_have_is_refused(tmp_path):
    path, log = write_folder(tmp_path, ('column = "mass_g"', 'column = "mass_g"\neffects = ["payloud"]'))
    robot = Robot.from_toml(path)
    logs = load(robot, log)
    with pytest.raises(RobotError, match="the effect 'payloud'; did you mean 'payload'"):
        list_variations(robot, logs, catalogue(robot, logs))


def test_sizes_of_a_variation_have_the_bounds_of_the_effect_at_the_largest_number(tmp_path):
    path, log = write_folder(tmp_path, ('column = "mass_g"', 'column = "mass_g"\neffects = ["payload"]'))
    robot = Robot.from_toml(path)
    logs = load(robot, log)
    known = catalogue(robot, logs)
    (varied,) = list_variations(robot, logs, known)
    (effect,) = (one for one in known if one.name == "payload")
    assert varied.sizes[0].high == pytest.approx(effect.sizes[0].high / 800.0)
    assert math.isinf(varied.sizes[0].prior_std)
