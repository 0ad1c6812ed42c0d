"""Simulate a servo arm with an effect that its model lacks, and find that out from its logs."""

from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

from simgap import Robot, Trace, audit, diagnose, load, verdict_lines
from simgap.report.traces import trace_motions
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


def draw(trace: Trace, before_mrad: float, after_mrad: float) -> None:
    """Draw what was measured, beside the model as it is and the model with what was found."""
    shown = (trace.time_s > 0.9) & (trace.time_s < 2.4)
    time_s, measured = trace.time_s[shown], np.asarray(trace.measured)[shown]
    before, after = measured - trace.nominal[shown], measured - trace.explained[shown]
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.6), sharey=True, layout="constrained")
    for axes, model, colour, title in (
        (panels[0], before, "#c1121f", f"Model as it is: error {before_mrad:.1f} mrad"),
        (panels[1], after, "#1769c2", f"With the delay that was found: {after_mrad:.1f} mrad"),
    ):
        axes.fill_between(time_s, measured, model, color=colour, alpha=0.25, linewidth=0)
        axes.plot(time_s, measured, color="0.1", linewidth=3.0, label="robot")
        axes.plot(time_s, model, "--", color=colour, linewidth=2.0, label="model")
        axes.set_title(title, fontsize=12, color=colour)
        axes.set(xlabel="time [s]", xticks=(1.0, 1.5, 2.0))
        axes.legend(loc="upper center", ncols=2, frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set(ylabel="elbow [rad]", ylim=(-0.2, 0.27))
    figure.suptitle("An elbow and its model get the same commands, in a motion that took no part in the fit")
    figure.savefig("robot_diagnose.png", dpi=100)


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

    elbow = next(one for one in result.errors if one.joint == "elbow")
    motions = trace_motions(robot, logs.judged, result)
    draw(next(one for one in motions if one.joint == "elbow"), 1e3 * elbow.nominal, 1e3 * elbow.explained)


if __name__ == "__main__":
    main()
