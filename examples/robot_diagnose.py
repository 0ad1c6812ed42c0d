"""Simulate a servo arm with an effect that its model lacks, and find that out from its logs."""

from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from simgap import Robot, audit, diagnose, load, verdict_lines
from simgap.simulation.compiled import HARD_IMPEDANCE

MODEL = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 0.5">
      <joint name="shoulder" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02"/>
      <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      <body pos="0.25 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02"/>
        <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="20" kv="1" forcerange="-20 20"/>
    <position name="elbow" joint="elbow" kp="20" kv="1" forcerange="-20 20"/>
  </actuator>
</mujoco>
"""
ROBOT = """
name = "servo arm"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 500.0
time = { column = "t", unit = "s" }
motion = { columns = ["motion"], repeat_column = "repeat" }
"""
JOINT = """
[joints.NAME]
mode = "position"
command = { column = "command_NAME", unit = "rad" }
position = { column = "position_NAME", unit = "rad" }
"""
NAMES = ("shoulder", "elbow")
DELAY_SAMPLES = 3
"""30 ms."""


def record_logs(path: Path) -> None:
    """Stand in for the real arm, whose elbow gets its commands late: the model does not say so."""
    model, random = mujoco.MjModel.from_xml_string(MODEL), np.random.default_rng(1)
    model.opt.timestep = 0.0001  # a real arm has no time step
    model.dof_solimp[:] = HARD_IMPEDANCE  # and its friction holds: that of MuJoCo creeps
    model.dof_solref[:, 0] = 2.0 * model.opt.timestep
    time_s = 0.01 * np.arange(400)
    rows = []
    for motion in range(8):
        if motion % 2 == 0:  # each command is sent twice
            steps = random.uniform(-0.5, 0.5, (8, 2))
            command = np.where(time_s[:, None] < 0.5, 0.0, steps[(2.0 * time_s).astype(int)])
        arrived = np.column_stack([command[:, 0], np.roll(command[:, 1], DELAY_SAMPLES)])
        arrived[:DELAY_SAMPLES] = 0.0
        data = mujoco.MjData(model)
        for t, sent, received in zip(time_s, command, arrived, strict=True):
            shown = data.qpos + 1.5e-3 * random.standard_normal(2)  # a count of a 12-bit encoder
            rows.append((motion, motion // 2, t, *sent, *shown))
            data.ctrl[:] = received
            mujoco.mj_step(model, data, 100)
    head = ",".join(
        ("motion", "repeat", "t", *(f"{what}_{one}" for what in ("command", "position") for one in NAMES))
    )
    np.savetxt(path, rows, "%.6g", ",", header=head, comments="")


def main() -> None:
    """Write model, robot file and logs; diagnose them."""
    Path("model.xml").write_text(MODEL)
    Path("robot.toml").write_text(ROBOT + "".join(JOINT.replace("NAME", name) for name in NAMES))
    record_logs(Path("log.csv"))

    robot = Robot.from_toml("robot.toml")
    logs = load(robot, "log.csv", held_out=["6", "7"])
    result = diagnose(robot, logs.fit, held_out=logs.judged, audit=audit(robot, logs), seed=1)
    print(*verdict_lines(result), sep="\n")
    for finding in result.findings:
        print(f"{finding.effect} at {finding.place}: {finding.text}")
    result.patch(robot, "patch")
    result.report("report.html", robot, logs.judged)

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    place = np.arange(len(result.errors))
    for k, kind in enumerate(("nominal", "base", "explained")):
        axes.bar(place + 0.25 * k, [1e3 * getattr(one, kind) for one in result.errors], 0.25, label=kind)
    axes.set_xticks(place + 0.25, [one.joint for one in result.errors])
    axes.set(title="Error on motions that took no part", ylabel="mean absolute error [mrad]")
    axes.legend()
    figure.savefig("robot_diagnose.png", dpi=100)


if __name__ == "__main__":
    main()
