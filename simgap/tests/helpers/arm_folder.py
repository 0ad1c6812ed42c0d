"""A folder with the planar arm as a user has it: model, robot file, and logs as Parquet."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from helpers.planar_arm import MODEL, planar_arm, slow_logs
from helpers.robot_folder import write_robot

ROBOT = """name = "planar arm"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 500.0
tool_site = "tip"
time = { column = "t", unit = "s" }
motion = { columns = ["motion"] }
"""
JOINT = """
[joints.{name}]
mode = "position"
kp_Nm_rad = 20.0
kd_Nms_rad = 1.0
torque_limit_Nm = 8.0
command = {{ column = "command_{name}", unit = "rad" }}
position = {{ column = "position_{name}", unit = "rad" }}
"""


def write_arm(folder):
    """Write the model without a table, the robot file, and logs of an arm that meets a table."""
    joints = "".join(JOINT.format(name=name) for name in ("shoulder", "elbow"))
    write_robot(folder, model=MODEL.format(table="", ball=""), text=ROBOT + joints)
    write_logs(folder / "log.parquet", slow_logs(planar_arm(table=True), low=-0.5, high=1.0))


def columns_of(logs):
    """Return the columns of a table of all motions."""
    table: dict[str, list] = {"t": [], "motion": []}
    for one in logs.motions:
        time_s = one.joints["shoulder"].position.time_s
        table["t"].append(time_s)
        table["motion"].append(np.full(time_s.size, one.name))
        for name, log in one.joints.items():
            table.setdefault(f"command_{name}", []).append(log.command.value)
            table.setdefault(f"position_{name}", []).append(log.position.value)
    return {name: np.concatenate(parts) for name, parts in table.items()}


def write_logs(path, logs, **changes):
    """Write motions as one table, with other values in some columns; None leaves a column out."""
    columns = columns_of(logs) | changes
    kept = {name: value.tolist() for name, value in columns.items() if value is not None}
    pq.write_table(pa.table(kept), path)
