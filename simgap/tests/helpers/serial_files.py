"""Synthetic arm, mapping and table as files."""

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.serial_synthetic import built_arm, drawn_arm, series, setup
from simgap.serial_arm.files import arm_to_toml

JOINTS = ("joint0", "joint1", "joint2")
MAPPING = """arm = "made up"

[csv]
separator = ";"
decimal = ","

[joints]
columns = ["joint0", "joint1", "joint2"]
unit = "deg"

[position]
columns = ["x", "y", "z"]
unit = "mm"

[rotation]
columns = ["rx", "ry", "rz"]
unit = "deg"
order = "XYZ"

[air]
columns = ["air"]
unit = "degC"
"""


def rows(count=300, seed=3):
    """Return the table, shape (count, 10): joints, x, y, z, rx, ry, rz, air; degrees and millimetres."""
    poses = series(built_arm(drawn_arm(3), 1), setup(2), count, seed)
    angles = Rotation.from_matrix(np.moveaxis(poses.X_TM.R, -1, 0)).as_euler("XYZ", degrees=True)
    air = 22 + 0.1 * np.sin(np.arange(count))
    return np.column_stack([np.degrees(poses.joint_rad.T), poses.X_TM.p.T * 1e3, angles, air])


def text(numbers, rotation=("rx", "ry", "rz")):
    """Format the table with semicolons and decimal commas."""
    head = ";".join((*JOINTS, "x", "y", "z", *rotation, "air"))
    lines = [";".join(f"{value:.9g}".replace(".", ",") for value in row) for row in numbers]
    return "\n".join([head, *lines, ""])


def write(folder, numbers=None):
    """Write arm.toml, poses.csv and mapping.toml."""
    (folder / "arm.toml").write_text(arm_to_toml(drawn_arm(3), ["Made up."]))
    (folder / "poses.csv").write_text(text(rows() if numbers is None else numbers))
    (folder / "mapping.toml").write_text(MAPPING)
