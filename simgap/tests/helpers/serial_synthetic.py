"""Synthetic serial arm with known errors, measurements of its poses, and both as files with a mapping."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from simgap.serial_arm import model
from simgap.serial_arm.chain import Pose, PoseSeries, move_directions
from simgap.serial_arm.files import arm_to_toml
from simgap.serial_arm.model import GEOMETRY_FIELDS, Link, SerialArm, TrackerSetup

POSITION_M, ROTATION_RAD = 5e-5, 2e-4
ORDERS = 6


def drawn_arm(joints=4):
    """Return the arm of the file."""
    turns, lengths = (np.pi / 2, -np.pi / 2, 0.0), (0.05, 0.05, 0.25)
    shape = [{"alpha_rad": turns[k % 3], "a_m": lengths[k % 3], "d_m": 0.1 + 0.02 * k} for k in range(joints)]
    mass = [{"mass_kg": 3.0 - 0.3 * k, "mass_centre_m": (-0.05, 0.01, 0.02)} for k in range(joints)]
    links = tuple(Link(f"joint{k}", **shape[k], **mass[k]) for k in range(joints))
    uncertainty = model.Uncertainty(compliance_rad_per_Nm=1e-4, periodic_rad=2e-4, orders=ORDERS)
    of_arm = model.Repeatability(POSITION_M, ROTATION_RAD)
    return SerialArm("made up", links, uncertainty=uncertainty, repeatability=of_arm)


def built_arm(arm, seed):
    """Return a built arm, with random errors of the size that the file states."""
    rng, sure = np.random.default_rng(seed), arm.uncertainty

    def off(one):
        angle, length = (sigma * rng.standard_normal(3) for sigma in (sure.angle_rad, sure.length_m))
        waves = sure.periodic_rad * rng.standard_normal((2, sure.orders))
        errors = np.column_stack([angle, length]).ravel()
        own = {name: getattr(one, name) + off for name, off in zip(GEOMETRY_FIELDS, errors, strict=True)}
        own["compliance_rad_per_Nm"] = 5e-5 * abs(rng.standard_normal())
        own["hysteresis_rad"] = 1e-4 * rng.standard_normal()
        return replace(one, **own, cos_rad=tuple(waves[0].tolist()), sin_rad=tuple(waves[1].tolist()))

    return replace(arm, links=tuple(off(one) for one in arm.links))


def setup(seed):
    """Return random base and target frames."""
    rng = np.random.default_rng(seed)
    R = np.moveaxis(Rotation.random(2, rng=rng).as_matrix(), 0, -1)
    p = rng.uniform(-1, 1, (3, 2))
    return TrackerSetup(Pose(R[:, :, 0], 3 * p[:, 0]), Pose(R[:, :, 1], 0.1 * p[:, 1]))


def series(arm, stands, count, seed, noise=1.0, air=None):
    """Simulate measured poses of this arm."""
    rng = np.random.default_rng([seed, 1])
    q = rng.uniform(-2.5, 2.5, (len(arm.links), count))
    blank = Pose(np.repeat(np.eye(3)[:, :, None], count, 2), np.zeros((3, count)))
    unmeasured = PoseSeries("made", q, move_directions(q), blank, air, np.arange(1, count + 1))
    X = model.serial_model(arm, stands, unmeasured, ()).poses(np.zeros(12))
    turn = Rotation.from_rotvec(noise * ROTATION_RAD * rng.standard_normal((count, 3))).as_matrix()
    R = np.einsum("nij,jkn->ikn", turn, X.R)
    return replace(unmeasured, X_TM=Pose(R, X.p + noise * POSITION_M * rng.standard_normal((3, count))))


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
