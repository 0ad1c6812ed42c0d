"""A payload between two conditions: a twin of a UR10e with exact masses and a wrong scale of currents."""

import mujoco
import numpy as np
import pytest

from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.robot import Robot

MODEL = """<mujoco model="twin"><compiler angle="radian" autolimits="true"/><worldbody>
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


def write_log(path, payload_kg, seed):
    """Write motions of two waves a joint, with the currents that inverse dynamics needs."""
    spec = mujoco.MjSpec.from_string(MODEL)
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
    (folder / "model.xml").write_text(MODEL)
    (folder / "robot.toml").write_text(
        """name = "twin"
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
        + joints
    )
    return Robot.from_toml(folder / "robot.toml")


@pytest.mark.slow
def test_mass_and_centre_of_a_payload_are_found_with_the_scale_of_the_currents(tmp_path):
    robot = write_twin(tmp_path)
    write_log(tmp_path / "unloaded.csv", 0.0, 1)
    write_log(tmp_path / "loaded.csv", PAYLOAD_kg, 2)
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
