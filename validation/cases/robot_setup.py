"""Robots, motions and noise of a case, with our own numbers, and the detection limit that follows.

The motions last at most 60 s, twelve of varied kind; four are held out, and two repeat each other.

Family-wise detection limit of an effect in a case, from its noise and its number of motions.

The test: in motion m, the score of an effect is the product of its change d_m of the shown positions and the
residual r_m, both whitened. With amplitude a its mean is a I_m and its variance I_m, where I_m = d_m . d_m.
The scatter of the scores between M motions estimates the noise, so their sum over sqrt(sum I_m) has Student's
t-distribution with M - 1 degrees of freedom, and with the effect a noncentral one with noncentrality
a sqrt(sum I_m). With H hypotheses, a two-sided test at 0.05 / H each keeps false alarms of all together below
5 % (Bonferroni). The limit is the noncentrality at which the test has 90 % power.

The strength of an effect is sqrt(sum d_m . d_m) over the fitted motions, without the part that the nuisances
imitate: each of them is a column with a prior as wide as the number. An effect is at its limit when its
strength is that noncentrality. The strength is computed with the effect at its true size, and with the
nuisances where they imitate it, so that nothing is linearised. The first second of a motion does not count,
because its start depends on where friction held the joint.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import mujoco
import numpy as np
from scipy.optimize import brentq
from scipy.stats import nct, t

from simgap.arrays import Array
from simgap.common.toml import toml_text
from simgap.robot import Robot
from validation.cases.robot_truth import Scene
from validation.cases.servo_truth import motion_gains

FOLDER: Final = Path(__file__).parent / "models"
ROBOT_FILE: Final = "robot.toml"
ADDED: Final = "added_kg"
"""Column of a servo with the mass of the weights that were added for a motion."""
POSSIBLE_RAD: Final = (-1.0, 2.0)
"""Positions between which a servo may go, twice as far apart as those of its motions."""


@dataclass(frozen=True, slots=True)
class Arm:
    """Poses and joints of a model."""

    centre_rad: tuple[float, ...]
    """Middle of the motions."""
    known: frozenset[str] = frozenset()
    """Joints with measured friction, damping, armature and gain: they have no nuisances."""
    mass_kg: float = 0.0
    """Mass and length of the weight of a servo; 0 for other robots."""
    length_m: float = 0.0

    @property
    def is_servo(self) -> bool:
        """Return whether its truth is that of a servo and its model a poor one."""
        return self.mass_kg > 0.0


ARMS: Final = {
    "pendulum": Arm((0.5,)),
    "two_joint": Arm((0.2, -0.6), frozenset({"elbow"})),
    "four_joint": Arm((0.0, 0.7, -1.0, -0.3), frozenset({"wrist"})),
}
SERVOS: Final = {
    f"servo_{1000 * kg:.0f}g_{1000 * m:.0f}mm": Arm((0.5,), mass_kg=kg, length_m=m)
    for kg in (0.1, 0.2, 0.3, 0.4)
    for m in (0.1, 0.15)
}
MODELS: Final = {**{name: ARMS[name] for name in sorted(ARMS)}, **SERVOS}


@cache
def load_robot(name: str) -> Robot:
    """Load one of the robots, whose files are gone then: `write_robot` writes those of a case."""
    with TemporaryDirectory() as folder:
        return Robot.from_toml(write_robot(Path(folder), name))


def write_robot(folder: Path, name: str) -> Path:
    """Write robot file, model and split of a robot, and return the path of the first.

    Logs of a servo have its gain and its power.
    """
    arm = MODELS[name]
    xml = (FOLDER / f"{'servo' if arm.is_servo else name}.xml").read_text(encoding="utf-8")
    xml = xml.replace("MASS", f"{arm.mass_kg:g}").replace("LENGTH", f"{arm.length_m:g}")
    spec = mujoco.MjSpec.from_string(xml)
    servo: dict[str, Any] = {}
    conditions: dict[str, Any] = {}
    if arm.is_servo:
        power = {"column": "enabled", "unit": "flag"}
        servo = {"gain_column": "gain", "enabled": power, "possible_rad": list(POSSIBLE_RAD)}
        number = {"element": "body", "name": "added", "attribute": "inertial/mass"}
        conditions = {ADDED: {"column": ADDED, "sets": [number], "possible": [0.1, 0.2]}}
    columns = ("command", "rad"), ("position", "rad"), ("temperature", "degC")
    robot = {
        "name": name,
        "model": "model.xml",
        "split": "split.toml",
        "time_step_s": spec.option.timestep,
        "control_rate_Hz": 1.0 / spec.option.timestep,
        "tool_site": "tool",
        "time": {"column": "t_s", "unit": "s"},
        "motion": {"columns": ["motion"], "repeat_column": "repeat"},
        "conditions": conditions,
        "joints": {
            drive.name: {
                "mode": "position",
                "kp_Nm_rad": float(drive.gainprm[0]),
                "kd_Nms_rad": float(-drive.biasprm[2]),
                "torque_limit_Nm": float(drive.forcerange[1]),
                "is_known": drive.name in arm.known,
                **servo,
                **{one: {"column": f"{one}_{drive.name}", "unit": unit} for one, unit in columns},
            }
            for drive in spec.actuators
        },
    }
    fitted = [motion for motion, _ in PLAN if motion not in HELD_OUT]
    split = {
        "default": "fit",
        "parts": {"fit": fitted, "held_out": sorted(HELD_OUT)},
        "splits": {"fit": {"fit": ["fit"], "held_out": ["held_out"]}},
    }
    folder.mkdir(parents=True, exist_ok=True)
    texts = {ROBOT_FILE: toml_text(robot), "split.toml": toml_text(split), "model.xml": xml.strip() + "\n"}
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return folder / ROBOT_FILE


PERIOD_S: Final = 0.01
SAMPLES: Final = 500
"""Samples of a motion: twelve of them last 59.88 s."""
HALF_RANGE_RAD: Final = 0.75
"""Largest distance from the middle pose."""
PLAN: Final = (
    ("jumps-1", "jumps"), ("chirp-1", "chirp"), ("slow-1", "slow"), ("moves-1", "moves"),
    ("waves-1", "waves"), ("moves-2", "moves"), ("repeat-1", "moves"), ("repeat-2", "moves"),
    ("jumps-2", "jumps"), ("slow-2", "slow"), ("moves-3", "moves"), ("waves-2", "waves"),
)  # fmt: skip
REPEATED: Final = ("repeat-1", "repeat-2")
HELD_OUT: Final = frozenset({"jumps-2", "slow-2", "moves-3", "waves-2"})


@dataclass(frozen=True, slots=True)
class Plan:
    """Commands of all motions of a case."""

    names: tuple[str, ...]
    commands: Array
    """(n_motions, n_joints, n) [rad]."""
    scene: Scene
    gains: Array | None = None
    """(n_motions, n), 0 where the motors have no power; None: the gains are those of the model."""


def draw_plan(robot: Robot, rng: np.random.Generator) -> Plan:
    """Draw the commands of a case."""
    arm = MODELS[robot.name]
    centre = np.array(arm.centre_rad)
    commands: dict[str, Array] = {}
    for name, kind in PLAN:
        if name == REPEATED[1]:
            commands[name] = commands[REPEATED[0]]
        else:
            offsets = [KINDS[kind](rng) for _ in centre]
            commands[name] = centre[:, None] + HALF_RANGE_RAD * np.clip(np.array(offsets), -1.0, 1.0)
    stacked = np.array(list(commands.values()))
    low, high = stacked.min(axis=(0, 2)), stacked.max(axis=(0, 2))
    scene = Scene(robot, tuple(low.tolist()), tuple(high.tolist()), 0.0)
    gains = motion_gains(len(commands), sample_times()) if arm.is_servo else None
    return Plan(tuple(commands), stacked, scene, gains)


def sample_times() -> Array:
    """Return the times of the samples of a motion [s]."""
    return np.asarray(PERIOD_S * np.arange(SAMPLES), float)


def _jumps(rng: np.random.Generator) -> Array:
    """Return jumps every 0.8 to 1.4 s."""
    found, at = np.empty(SAMPLES), float(rng.uniform(-0.4, 0.4))
    change_s = 0.3 + float(rng.uniform(0.0, 0.5))
    for k, time_s in enumerate(sample_times()):
        if time_s >= change_s:
            change_s += float(rng.uniform(0.8, 1.4))
            at = float(np.clip(at + rng.choice((-1, 1)) * rng.uniform(0.15, 0.4), -0.7, 0.7))
        found[k] = at
    return found


def _chirp(rng: np.random.Generator) -> Array:
    """Return a sine whose frequency grows from 0.3 to 2.5 Hz, with less amplitude as it grows."""
    t = sample_times()
    last = t[-1]
    low, high = 0.3 * rng.uniform(0.8, 1.2), 2.5 * rng.uniform(0.8, 1.2)
    frequency = low * (high / low) ** (t / last)
    phase = 2.0 * np.pi * np.cumsum(frequency) * PERIOD_S + rng.uniform(0.0, 2.0 * np.pi)
    return np.asarray(rng.uniform(-0.3, 0.3) + 0.5 * (low / frequency) ** 0.6 * np.sin(phase))


def _slow(rng: np.random.Generator) -> Array:
    """Return a triangle of constant speed, with two or three reversals."""
    t = sample_times()
    period_s = rng.uniform(3.0, 5.0)
    saw = (t / period_s + rng.uniform()) % 1.0
    return np.asarray(rng.uniform(-0.3, 0.3) + 0.6 * (4.0 * np.abs(saw - 0.5) - 1.0))


def _moves(rng: np.random.Generator) -> Array:
    """Return moves between points with a smooth profile, and rests between them."""
    found, at, k = np.empty(SAMPLES), float(rng.uniform(-0.7, 0.7)), 0
    while k < SAMPLES:
        rest, move = int(rng.integers(20, 60)), int(rng.integers(40, 100))
        goal = float(rng.uniform(-0.9, 0.9))
        s = np.arange(move) / move
        path = np.concatenate([np.full(rest, at), at + (goal - at) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)])
        part = path[: SAMPLES - k]
        found[k : k + part.size] = part
        k, at = k + part.size, goal
    return found


def _waves(rng: np.random.Generator) -> Array:
    """Return three sines."""
    t = sample_times()
    waves = [
        share * np.sin(2.0 * np.pi * rng.uniform(0.8, 1.25) * frequency * t + rng.uniform(0.0, 2.0 * np.pi))
        for share, frequency in ((0.45, 0.35), (0.2, 0.9), (0.08, 1.9))
    ]
    return np.asarray(np.sum(waves, axis=0) + rng.uniform(-0.2, 0.2))


KINDS: Final = {"jumps": _jumps, "chirp": _chirp, "slow": _slow, "moves": _moves, "waves": _waves}


def lowest_m(robot: Robot, positions: Array) -> float:
    """Return the least height of the tool at positions, (n_motions, n_joints, n) [rad]."""
    data = mujoco.MjData(robot.model)
    indices = [joint.qpos_index for joint in robot.joints]
    heights = []
    for pose in np.moveaxis(positions, 1, 2)[:, ::5].reshape(-1, len(indices)):
        data.qpos[indices] = pose
        mujoco.mj_kinematics(robot.model, data)
        heights.append(float(data.site(robot.tool_site).xpos[2]))
    return min(heights)


FALSE_ALARM: Final = 0.05
POWER: Final = 0.9
QUANTUM_RAD: Final = 2.0 * np.pi / 4096
"""Step of a 12-bit encoder."""
NOISE_RAD: Final = 0.0015
"""Standard deviation of the noise before it is quantised: about one step, as the SO-101 shows after a fit."""
CORRELATION: Final = 0.8
"""Correlation of neighbouring samples, 10 ms apart: a time constant of 45 ms."""


VARIANCE_RAD2: Final = NOISE_RAD**2 + QUANTUM_RAD**2 / 12.0
LOG_SD_RAD: Final = float(np.sqrt(VARIANCE_RAD2))
LOG_CORRELATION: Final = CORRELATION * NOISE_RAD**2 / VARIANCE_RAD2
"""First-order autoregression of the logs: quantisation adds a variance of quantum^2 / 12, white."""


def whiten(change_rad: Array) -> Array:
    """Whiten changes of positions along their last axis, (..., n)."""
    first = change_rad[..., :1] / LOG_SD_RAD
    later = change_rad[..., 1:] - LOG_CORRELATION * change_rad[..., :-1]
    return np.concatenate([first, later / (LOG_SD_RAD * np.sqrt(1.0 - LOG_CORRELATION**2))], axis=-1)


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Columns of the nuisances, whitened, each for one standard deviation of its prior."""

    columns: Array
    """(n, n_nuisances)."""
    solve: Array
    """Inverse of columns' columns + 1, times columns', (n_nuisances, n)."""


def make_nuisance(columns: Array) -> Nuisance:
    """Prepare the removal of what nuisances imitate; columns are (n, n_nuisances)."""
    gram = columns.T @ columns + np.eye(columns.shape[1])
    return Nuisance(columns, np.asarray(np.linalg.solve(gram, columns.T), float))


def information(one: Array, other: Array, nuisance: Nuisance) -> float:
    """Return the product of two whitened changes, (n,), less what the nuisances imitate."""
    return float(one @ other - (one @ nuisance.columns) @ (nuisance.solve @ other))


@cache
def limit_noncentrality(motions: int, hypotheses: int) -> float:
    """Return the strength of an effect at the family-wise limit."""
    freedom = motions - 1
    threshold = float(t.isf(FALSE_ALARM / (2.0 * hypotheses), freedom))
    return float(brentq(lambda shift: nct.sf(threshold, freedom, shift) - POWER, 0.0, 10.0 * threshold))
