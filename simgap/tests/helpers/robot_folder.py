"""A small robot in a folder: model, robot file, and logs in every format."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

MODEL = """<mujoco model="two links">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" range="-2 2" frictionloss="0.1"/>
      <inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="lower" pos="0 0 -0.4">
        <joint name="elbow" axis="0 0 1" range="-2 2" frictionloss="0.1"/>
        <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.01 0.01 0.01"/>
        <site name="tip" pos="0 0 -0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="30" kv="2" forcerange="-5 5"/>
    <motor name="elbow" joint="elbow" gear="50" forcerange="-0.1 0.1"/>
  </actuator>
</mujoco>
"""
ROBOT = """name = "two links"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 250.0
tool_site = "tip"

[time]
column = "t"
unit = "ms"

[motion]
columns = ["motion"]

[conditions.gain]
column = "gain"

[joints.shoulder]
mode = "position"
gain_column = "gain"
kp_Nm_rad = 15.0
position = { column = "q1", unit = "deg", factor = -1.0, zero_rad = 0.5 }
command = { column = "c1", unit = "deg" }

[joints.elbow]
mode = "torque"
gear_ratio = 50.0
position = { column = "q2", unit = "count", counts_per_turn = 4096.0, side = "motor" }
torque = { column = "m2", unit = "mN m", side = "motor" }
"""
COLUMNS = {
    "t": [0.0, 10.0, 20.0, 0.0, 10.0, 20.0, 30.0],
    "motion": ["slow", "slow", "slow", "fast", "fast", "fast", "fast"],
    "gain": [2, 2, 2, 3, 3, 3, 3],
    "q1": [0.0, 90.0, 180.0, 1.0, 2.0, 3.0, 4.0],
    "c1": [0.0, 9.0, 18.0, 27.0, 36.0, 45.0, 54.0],
    "q2": [0.0, 4096.0, 8192.0, 0.0, 0.0, 0.0, 0.0],
    "m2": [0.0, 100.0, 200.0, 0.0, 0.0, 0.0, 0.0],
}


def changed(text, *changes):
    """Return a text with changes of parts that are in it."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


def write_robot(folder, *changes, model=MODEL, text=ROBOT):
    """Write a robot with changes of the text of its file; return the path of the file."""
    (folder / "model.xml").write_text(model)
    (folder / "robot.toml").write_text(changed(text, *changes))
    return folder / "robot.toml"


def write_parquet(folder, name="log", **changes):
    """Write the columns, some of them changed, as Parquet."""
    pq.write_table(pa.table(COLUMNS | changes), folder / f"{name}.parquet")
    return folder / f"{name}.parquet"


def write_csv(folder, separator=",", decimal="."):
    """Write the columns as text."""
    rows = [list(COLUMNS), *(map(str, row) for row in zip(*COLUMNS.values(), strict=True))]
    lines = [separator.join(cell.replace(".", decimal) for cell in row) for row in rows]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


def write_npz(folder, **changes):
    """Write the columns as arrays."""
    np.savez(folder / "log.npz", **({name: np.array(one) for name, one in COLUMNS.items()} | changes))
    return folder / "log.npz"


def write_lerobot(folder, names, episodes, rate_Hz=50.0, **info):
    """Write a LeRobot data set with a file for each episode: actions and states, (n, joints) each."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    features = {name: {"names": list(names)} for name in ("action", "observation.state")}
    features["action"]["names"] = {"motors": list(names)}  # as earlier versions write
    total = sum(len(action) for action, _ in episodes)
    text = {"codebase_version": "v2.1", "total_frames": total, "features": features} | info
    (folder / "meta" / "info.json").write_text(json.dumps(text))
    for k, (action, state) in enumerate(episodes):
        table = {
            "action": list(action),
            "observation.state": pa.array(list(state), pa.list_(pa.float32(), len(names))),
            "timestamp": pa.array(np.arange(len(action)) / rate_Hz, pa.float32()),
            "episode_index": [k] * len(action),
        }
        pq.write_table(pa.table(table), folder / "data" / "chunk-000" / f"episode_{k:06d}.parquet")
    return folder
