"""Logs of an arm with two servos, as other programs write them, for first robot files."""

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from simgap.arrays import Array

MODEL = """<mujoco model="two servos">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 0.6">
      <joint name="lift" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02" range="-2 1.5"/>
      <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      <body name="lower" pos="0.25 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02" range="-2.5 2.5"/>
        <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift" joint="lift" kp="20" kv="1" forcerange="-20 20"/>
    <position name="elbow" joint="elbow" kp="20" kv="1" forcerange="-20 20"/>
  </actuator>
</mujoco>
"""
MOTORS = MODEL.replace(' kp="20" kv="1"', "").replace("<position ", "<motor ")
JOINTS = ("lift", "elbow")
RATE_HZ = 100.0


@dataclass(frozen=True)
class Run:
    """Rows of two motions; each array has a row a sample and a column a joint."""

    time_s: Array
    """Time since the start of the motion."""
    motion: Array
    command: Array
    position: Array
    velocity: Array
    torque: Array

    @property
    def clock_s(self):
        """Time that does not restart."""
        return np.arange(self.time_s.size) / RATE_HZ


@cache
def run():
    """Simulate two motions of four seconds."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    rows: list[tuple[float, ...]] = []
    for motion, speeds in enumerate(((2.0, 3.1), (4.3, 1.7))):
        data = mujoco.MjData(model)
        for k in range(2000):
            data.ctrl[:] = 0.6 * np.sin(np.multiply(speeds, k // 5 / RATE_HZ)) * (1.0, -0.8)
            mujoco.mj_step1(model, data)
            if k % 5 == 0:
                torque = 20.0 * (data.ctrl - data.qpos) - data.qvel
                rows.append((k // 5 / RATE_HZ, motion, *data.ctrl, *data.qpos, *data.qvel, *torque))
            mujoco.mj_step2(model, data)
    table = np.array(rows)
    return Run(table[:, 0], table[:, 1], *(table[:, k : k + 2] for k in (2, 4, 6, 8)))


def write_model(folder, text=MODEL):
    """Write the model."""
    (folder / "model.xml").write_text(text)
    return folder / "model.xml"


def write_columns(path, **columns):
    """Write columns as CSV; arrays of two joints are columns with the number of the joint at `{}`."""
    flat: dict[str, Array] = {}
    for name, values in columns.items():
        flat |= {name: values} if values.ndim == 1 else {name.format(j): values[:, j] for j in (0, 1)}
    rows = (",".join(f"{one:.6f}" for one in row) for row in zip(*flat.values(), strict=True))
    lines = [",".join(flat), *rows]
    path.write_text("\n".join(lines) + "\n")
    return path
