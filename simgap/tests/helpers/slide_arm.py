"""A slide that lifts a hinged arm, as a folder of a user, and logs of it by a loop of MuJoCo."""

import mujoco
import numpy as np

from helpers.robot_folder import write_robot

MODEL = """<mujoco model="lift">
  <!-- a user's own words -->
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage" pos="0 0 0.5">
      <joint name="lift" type="slide" axis="0 0 1" damping="20" frictionloss="4" armature="1"
             range="-0.3 0.3"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
      <body name="arm" pos="0.05 0 0">
        <joint name="swing" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02" range="-2 2"/>
        <inertial pos="0.12 0 0" mass="0.5" diaginertia="0.002 0.002 0.002"/>
        {more}
      </body>
    </body>
  </worldbody>
  {ties}
  <actuator>
    <position name="lift" joint="lift" kp="3000" kv="100" forcerange="-120 120"/>
    <position name="swing" joint="swing" kp="20" kv="1" forcerange="-20 20"/>
    {drives}
  </actuator>
</mujoco>
"""
FINGERS = """
        <body name="left" pos="0.2 0 0">
          <joint name="left" type="slide" axis="0 1 0" range="0 0.04"/>
          <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
        </body>
        <body name="right" pos="0.2 0 0">
          <joint name="right" type="slide" axis="0 -1 0" range="0 0.04"/>
          <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
        </body>
"""
TIES = '<equality><joint joint1="left" joint2="right"/></equality>'
DRIVES = '<position name="grip" joint="left" kp="100"/>'
FILE = """name = "lift"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 500.0
time = { column = "t", unit = "s" }
motion = { columns = ["motion"], repeat_column = "repeat" }

[joints.lift]
mode = "position"
command = { column = "c_lift", unit = "mm" }
position = { column = "p_lift", unit = "mm" }

[joints.swing]
mode = "position"
command = { column = "c_swing", unit = "rad" }
position = { column = "p_swing", unit = "rad" }
"""
STEP_S = 0.002
EVERY = 5
"""Steps of a sample of the logs."""
PARTS = 4
"""Parts of a step: the true arm has none."""
NOISE = (2e-4, 1e-3)
"""Of the encoders [m, rad]."""


def model_text(has_gripper=False):
    """Return the model, with a gripper of two tied fingers."""
    more, ties, drives = (FINGERS, TIES, DRIVES) if has_gripper else ("", "", "")
    return MODEL.format(more=more, ties=ties, drives=drives)


def write_folder(folder, *changes, has_gripper=False):
    """Write model and robot file, with changes of the text of the latter; return the path of the file."""
    return write_robot(folder, *changes, model=model_text(has_gripper), text=FILE)


def command_of(seed, time_s):
    """Return smooth commands of both joints, (n, 2) [m, rad], that begin at rest."""
    rng = np.random.default_rng(seed)
    speeds = rng.uniform(1.0, 5.0, (2, 3))
    parts = np.sum(1 - np.cos(np.einsum("jk,n->njk", speeds, time_s)), axis=2)
    return np.asarray(parts * (0.03, 0.15))


def record(seed, noise_seed, delay_s, friction_N, duration_s=2.5):
    """Return the columns of a motion of the real lift: late commands, and a slide with more friction."""
    model = mujoco.MjModel.from_xml_string(model_text())
    model.dof_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
    model.opt.timestep = STEP_S / PARTS
    model.dof_solref[:] = (2 * model.opt.timestep, 1.0)
    model.dof_frictionloss[0] += friction_N
    data = mujoco.MjData(model)
    before_s = 1.0  # in which it sags
    late = round(delay_s / STEP_S)
    n = round(duration_s / STEP_S)
    time_s = STEP_S * np.arange(n)
    sent = np.repeat(command_of(seed, time_s[::EVERY]), EVERY, axis=0)  # held, as the log has it
    shown = np.zeros((n, 2))
    for k in range(-round(before_s / STEP_S), n):
        if k >= 0:
            shown[k] = data.qpos
        data.ctrl[:] = sent[max(k - late, 0), 0], sent[max(k, 0), 1]
        mujoco.mj_step(model, data, PARTS)
    shown += np.random.default_rng(noise_seed).standard_normal(shown.shape) * NOISE
    kept = slice(None, None, EVERY)
    return {
        "t": time_s[kept],
        "c_lift": 1e3 * sent[kept, 0],
        "c_swing": sent[kept, 1],
        "p_lift": 1e3 * shown[kept, 0],
        "p_swing": shown[kept, 1],
    }


def write_logs(folder, delay_s=0.03, friction_N=6.0, count=5):
    """Write motions as a CSV file; the last two repeat the two before them."""
    seeds = [*range(count - 2), count - 4, count - 3]
    lines = []
    for k, seed in enumerate(seeds):
        columns = record(seed, 100 + k, delay_s, friction_N)
        if not lines:
            lines.append(",".join(["motion", "repeat", *columns]))
        rows = zip(*columns.values(), strict=True)
        lines += [f"m{k},s{seed}," + ",".join(f"{value:.9g}" for value in row) for row in rows]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"
