"""A kinematic stand-in for the plant: with power on and brakes off, encoders follow their set-points."""

import atexit
from collections.abc import Callable
from copy import copy
from dataclasses import fields, is_dataclass, replace
from functools import cache, lru_cache, wraps

import numpy as np

from fsw.collision.distance import begin_clearance, compute_clearances, describe_violation, follow_clearance
from fsw.config import Config, configure
from fsw.cycle import step
from fsw.dictionary.commands import Command, GuardedMove, MoveTool
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import Evr
from fsw.estimate.gear import LIKELY
from fsw.estimate.joints import JointEstimate
from fsw.estimate.reference import no_reference
from fsw.executive.planning import Start, plan_command
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Pose
from fsw.messages import Outputs, Sensors
from fsw.motion.plan import Refusal
from fsw.motion.work import Work, complete
from fsw.state import State, boot
from sim.arms import arm_named

MARS_R_m_s2 = np.array([0.0, 0.0, 3.711])
DITHER = 1e-12
FAR_M = 1e3
STEP_K = 0.9
"""Change of the temperature of the structure in a cycle."""


@lru_cache
def config_of(arm: str = "nominal") -> Config:
    """Flight software of an arm in the open, with nothing to keep clear of."""
    return in_the_open(configure(arm_named(arm).params))


@lru_cache
def beside_the_rover() -> Config:
    """The nominal configuration whole."""
    return configure(arm_named("nominal").params)


def in_the_open(config: Config) -> Config:
    """The rover and the ground are far away."""
    geometry = config.collision_geometry
    X_CS = Pose(geometry.rover.X_CS.R, geometry.rover.X_CS.p + FAR_M)
    far = replace(geometry, rover=replace(geometry.rover, X_CS=X_CS), ground_z_m=FAR_M)
    opened = replace(config)
    vars(opened)["collision_geometry"] = far  # in place of what it would build
    return opened


def with_params(**groups) -> Config:
    """The configuration in the open with other values of some parameters, by group."""
    params = arm_named("nominal").params
    changed = {
        name: replace(getattr(params, name), **values) if isinstance(values, dict) else values
        for name, values in groups.items()
    }
    return in_the_open(configure(replace(params, **changed)))


def in_limits(config: Config, rng: np.random.Generator, n: int, shrink: float = 0.0) -> np.ndarray:
    """Random joint vectors (5, n) inside the soft limits."""
    low, high = config.arm.soft_min_rad, config.arm.soft_max_rad
    return rng.uniform(low + shrink, high - shrink, (n, 5)).T.copy()


def facing(config: Config, tool: str, angle_rad: float = 0.3, pose_rad=None) -> np.ndarray:
    """The ready or another pose with the turret turned so that the tool looks this far from the wrist's x."""
    pose = np.array(config.params.poses.ready_rad if pose_rad is None else pose_rad)
    boresight = config.arm.X_FT[tool].R[:, 0]
    pose[Joint.TURRET] = (angle_rad - np.arctan2(boresight[1], boresight[0])) % (2 * np.pi)
    return pose


def pose_of(arm: Arm, output_rad: np.ndarray, tool: str, gravity_R_m_s2=None) -> Pose:
    """Compute X_RT of the rigid arm, or of the arm at rest that gravity deflects."""
    if gravity_R_m_s2 is None:
        return tool_pose(arm, forward(arm, output_rad), tool)
    return tool_pose(arm, settle_output(arm, output_rad, gravity_R_m_s2).frames, tool)


def levers_m(arm: Arm, tool: str, output_rad: np.ndarray, gravity_R_m_s2=None) -> np.ndarray:
    """Compute by finite differences how far a radian of each joint moves a tool back along its axis."""
    steps = output_rad[:, None] + 1e-5 * np.column_stack([np.zeros(5), np.eye(5), -np.eye(5)])
    X = pose_of(arm, steps, tool, gravity_R_m_s2)
    return X.R[:, 0, 0] @ (X.p[:, 6:] - X.p[:, 1:6]) / 2e-5


def matrix(X: Pose) -> np.ndarray:
    """One pose as the 4x4 matrix of the textbooks."""
    return np.vstack([np.column_stack([X.R, X.p]), [0, 0, 0, 1]])


def frozen(values, dtype=float) -> np.ndarray:
    array = np.array(values, dtype)
    array.flags.writeable = False
    return array


def alive(cycle: int) -> float:
    """The least noise that tells a live sensor from a frozen one."""
    return DITHER * (-1) ** cycle


def quiet_sensors(encoder_count, cycle: int = 0, **other) -> Sensors:
    """Every reading as it is when nothing happens; arrays that raise if anyone writes to them."""
    noise = alive(cycle)
    readings = {
        "encoder_count": encoder_count,
        "resolver_rad": np.full(5, noise),
        "current_A": np.full(5, noise),
        "winding_C": np.full(5, -40.0),
        "structure_C": 20.0 + noise,
        "switch_closed": np.zeros(10),
        "gravity_R_m_s2": MARS_R_m_s2 + noise,
    } | other
    structure_C = float(np.ravel(readings.pop("structure_C"))[0])
    types = {"encoder_count": np.int64, "switch_closed": bool}
    arrays = {name: frozen(value, types.get(name, float)) for name, value in readings.items()}
    return Sensors(cycle=cycle, structure_C=structure_C, **arrays)


class Rig:
    """Flight software with an arm that does what it is told; `cycle` takes sensor readings by name."""

    def __init__(
        self,
        config: Config,
        mode: Mode = Mode.DEPLOYED,
        start_rad=None,
        calibrated: bool = True,
        warm_C: float = 20.0,
    ):
        self.config = config
        self.warm_C = warm_C
        self.structure_C = warm_C
        self.winding_C = np.full(5, -40.0)
        self.off_count = np.zeros(5)
        start = np.array(config.params.poses.ready_rad if start_rad is None else start_rad)
        self.count = np.rint(start / config.rad_per_count).astype(np.int64)
        # encoders count from joint angle zero, resolvers are right
        known = replace(no_reference(config), calibrated=np.ones(5, bool), known=np.ones(5, bool))
        self.state: State = boot(config, mode, known if calibrated else None)
        self.evrs: list[Evr] = []
        self.outputs: Outputs | None = None
        self.stuck = False
        self.cycles = 0
        if calibrated:
            self.cycle()

    def fork(self) -> "Rig":
        """Return a rig that goes on from here, without events so far; no state is changed in place."""
        rig = copy(self)
        rig.count, rig.evrs = self.count.copy(), []
        rig.winding_C, rig.off_count = self.winding_C.copy(), self.off_count.copy()
        return rig

    def resolver_rad(self) -> np.ndarray:
        """The outputs where flight software takes them to be in their gears."""
        where = self.count * self.config.rad_per_count + self.state.joints.gear_rad[:, LIKELY]
        return where + alive(self.cycles)

    def cycle(self, *commands: Command, **readings) -> Outputs:
        self.cycles += 1
        defaults = {"cycle": self.cycles, "encoder_count": self.count, "resolver_rad": self.resolver_rad()}
        defaults["winding_C"] = self.winding_C
        warming_K = np.clip(self.warm_C - self.structure_C, -STEP_K, STEP_K)
        self.structure_C += float(warming_K)
        defaults["structure_C"] = self.structure_C + alive(self.cycles)
        readings = defaults | readings
        self.state, self.outputs = step(self.config, self.state, quiet_sensors(**readings), commands)
        drive = self.outputs.drive
        if not self.stuck:
            self.count = np.where(drive.power_on & drive.brake_release, drive.setpoint_count, self.count)
        self.evrs.extend(self.outputs.evrs)
        return self.outputs

    def go_blind(self, **readings) -> None:
        """Cycle with windings that read no number until that is a fault."""
        for _ in range(self.config.params.monitors.reading_persistence):
            self.cycle(**({"winding_C": [float("nan")] * 5} | readings))

    def run(self, *commands: Command, at_most: int = 20_000, **readings) -> tuple[Evr, ...]:
        """Cycle until the arm stands on its brakes; the EVRs from the first command on."""
        first = len(self.evrs)
        self.cycle(*commands, **readings)
        for _ in range(at_most):
            if not self.outputs.joint.busy:
                return tuple(self.evrs[first:])
            self.cycle(**readings)
        raise AssertionError(f"still busy after {at_most} cycles")

    def until(self, command: Command, reached, at_most: int = 6000) -> None:
        """From a command into its move."""
        self.cycle(command)
        for _ in range(at_most):
            if reached():
                return
            self.cycle()
        raise AssertionError(f"not there after {at_most} cycles")

    def begin(self, *commands: Command, at_most: int = 2000, **readings) -> tuple[Evr, ...]:
        """From a command to the end of its planning; the EVRs from the command on."""
        first = len(self.evrs)
        self.cycle(*commands, **readings)
        for _ in range(at_most):
            if self.state.planning is None:
                return tuple(self.evrs[first:])
            self.cycle(**readings)
        raise AssertionError(f"still planning after {at_most} cycles")

    def until_moving(self, *commands: Command, cycles: int = 40) -> Outputs:
        """Into the middle of a move."""
        self.begin(*commands)
        for _ in range(cycles):
            self.cycle()
        assert np.any(self.outputs.drive.setpoint_rate_rad_s != 0)
        return self.outputs

    def tool_pose(self, tool: str) -> Pose:
        """X_RT as flight software believes it, at rest."""
        joints = self.state.joints
        return pose_of(self.config.arm, joints.output_rad, tool, joints.gravity_R_m_s2)

    def here(self, tool: str, ahead_m: float = 0.0, **fields) -> MoveTool:
        """A tool move that keeps the approach, some way ahead along it."""
        X = self.tool_pose(tool)
        return MoveTool(tool, floats(X.p + ahead_m * X.R[:, 0]), floats(X.R[:, 0]), **fields)

    def touch(self, tool: str, travel_m: float) -> GuardedMove:
        X = self.tool_pose(tool)
        return GuardedMove(tool, floats(X.p + travel_m * X.R[:, 0]), floats(X.R[:, 0]))


def made_once(make: Callable[..., Rig]) -> Callable[..., Rig]:
    """Make a rig for the first test that asks for it, and give every test a fork."""
    kept = cache(make)
    atexit.register(kept.cache_clear)  # Ruckig complains of paths that outlive it
    return wraps(make)(lambda *args, **kwargs: kept(*args, **kwargs).fork())


def content(record):
    """A record as plain values that compare bit by bit."""
    if isinstance(record, np.ndarray):
        return record.dtype.str, record.shape, record.tobytes()
    if is_dataclass(record):
        return type(record).__name__, tuple(content(getattr(record, f.name)) for f in fields(record))
    if isinstance(record, tuple):
        return tuple(content(item) for item in record)
    if type(record).__name__ == "Trajectory":
        times = np.linspace(0.0, record.duration, 7)
        return tuple(str(record.at_time(t)) for t in times)
    return record.hex() if isinstance(record, float) else record


def floats(values) -> tuple:
    return tuple(float(v) for v in values)


def find_violation(geometry, frames, padding_m, touching=None, surface=None):
    """Find the first pose of a path at which a part of the arm is too close to an obstacle."""
    near_m = compute_clearances(geometry, frames, padding_m, touching, surface).near_m
    begun = begin_clearance(near_m[..., 0], padding_m, touching)
    return describe_violation(geometry, follow_clearance(begun, near_m))


def planned(config: Config, work):
    """The plan, or the reason for none."""
    return complete(config, work) if isinstance(work, Work) else work


def plan_of(config: Config, joints: JointEstimate, command, tool: str = "apxs", surface=None):
    """The plan of the last move of a command, or the reason for none."""
    found = complete(config, plan_command(Start(joints, tool, surface), command))
    return found if isinstance(found, Refusal) else found.plans[-1]
