"""Parameters: everything about the arm and its motion that flight software takes on trust.

Plain records of numbers, so that they load strictly, hash to one digest and read as they are.
SI units, named in the suffix. Limits are annotations; the loader and the ground dictionary read them.
"""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.collision_params import CollisionParams
from fsw.dictionary.types import Angle, Joints5, Length, Limits, Matrix6, Row6, Vector3

_ZERO_ROW: Row6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
RIGID: Matrix6 = (_ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW)


@dataclass(frozen=True, slots=True)
class Transform6:
    """The general link transform D = Rz(theta) Tz(d) Ry(beta) Ty(b) Rx(alpha) Tx(a), paper equation 1."""

    theta_rad: Angle = 0.0
    """Turn about z; the angle of the link's joint is added to it."""
    d_m: Length = 0.0
    """Way along z, after theta."""
    beta_rad: Angle = 0.0
    """Turn about y, after d."""
    b_m: Length = 0.0
    """Way along y, after beta."""
    alpha_rad: Angle = 0.0
    """Turn about x, after b."""
    a_m: Length = 0.0
    """Way along x, after alpha."""


@dataclass(frozen=True, slots=True)
class PointMass:
    """A point mass; its position is in the link frame, which turns with the link's joint."""

    mass_kg: Annotated[float, Limits(0.0, 200.0)] = 0.0
    """Its mass."""
    com_m: Vector3 = (0.0, 0.0, 0.0)
    """Where it is."""


@dataclass(frozen=True, slots=True)
class LinkParams:
    """One link: the transform to the frame at its end, its spring, and its mass on either side of the spring.

    The spring sits at the elastic centre, given in the link frame (the frame at the link's start, turned by
    the link's joint). The compliance maps (moment, force) to (rotation, translation): rad/(N m), rad/N,
    m/(N m), m/N.
    """

    transform: Transform6
    elastic_centre_m: Vector3 = (0.0, 0.0, 0.0)
    """Where the spring sits."""
    compliance: Matrix6 = RIGID
    """What the spring gives, moment first; no units of one kind: rad/(N m), rad/N, m/(N m), m/N."""
    near: PointMass = PointMass()
    far: PointMass = PointMass()
    expansion_1_K: Row6 = _ZERO_ROW
    """Growth per kelvin at the link's end, in its end frame: rotation [rad/K], translation [m/K]."""


@dataclass(frozen=True, slots=True)
class Links:
    """The links by the frame at their end; arm1 is the rover up to the azimuth joint and has no joint."""

    arm1: LinkParams
    arm2: LinkParams
    arm3: LinkParams
    arm4: LinkParams
    arm5: LinkParams
    arm6: LinkParams

    def in_order(self) -> tuple[LinkParams, ...]:
        """The links from the rover outward."""
        return (self.arm1, self.arm2, self.arm3, self.arm4, self.arm5, self.arm6)


@dataclass(frozen=True, slots=True)
class ToolParams:
    """Where a tool frame stands on the turret interface, frame Arm6; tool x is the approach direction."""

    transform: Transform6
    expansion_1_K: Row6 = _ZERO_ROW
    """Growth per kelvin, in tool axes."""


@dataclass(frozen=True, slots=True)
class Tools:
    """The tools on the turret."""

    drill: ToolParams
    drt: ToolParams
    mahli: ToolParams
    apxs: ToolParams
    portion: ToolParams

    def in_order(self) -> tuple[ToolParams, ...]:
        """The tools in the order of Tool."""
        return (self.drill, self.drt, self.mahli, self.apxs, self.portion)


@dataclass(frozen=True, slots=True)
class JointParams:
    """One joint and its actuator; angles, speeds and torques are those of the output."""

    gear_ratio: Annotated[float, Limits(1.0, 1e5)]
    """Turns of the motor for one of the output."""
    encoder_counts_per_turn: Annotated[int, Limits(1, 65536)]
    """Of the motor."""
    backlash_rad: Annotated[float, Limits(0.0, 0.02)]
    """Full width of the gap, as drawn."""
    gear_stiffness_Nm_rad: Annotated[float, Limits(1e3, 1e8)]
    """Of the wind-up between motor and output."""
    output_friction_Nm: Annotated[float, Limits(0.0, 200.0)]
    """Torque that the output resists with before it turns."""
    load_error_Nm: Annotated[float, Limits(0.0, 100.0)]
    """How far the modelled load, less the friction of the output, may be from the true one on Mars."""
    torque_constant_Nm_A: Annotated[float, Limits(1.0, 1e4)]
    """Of the motor, at the output."""
    hardstop_rad: Angle
    """Where the output meets its negative hardstop."""
    hardstop_stiffness_Nm_rad: Annotated[float, Limits(1e3, 1e8)]
    """Of the hardstop itself, gear apart."""
    hardstop_press_Nm: Annotated[float, Limits(1.0, 2000.0)]
    """Torque beyond that of running at which a joint on its hardstop is to stall."""
    hardstop_rated_Nm: Annotated[float, Limits(1.0, 5000.0)]
    """Torque that the hardstop is made for."""
    soft_min_rad: Angle
    """Lowest output angle that a move may ask for."""
    soft_max_rad: Angle
    """Highest output angle that a move may ask for."""
    speed_rad_s: Annotated[float, Limits(1e-3, 0.1)]
    """Highest speed of a move."""
    acceleration_rad_s2: Annotated[float, Limits(1e-3, 1.0)]
    """Highest acceleration of a move."""
    jerk_rad_s3: Annotated[float, Limits(1e-3, 10.0)]
    """Highest jerk of a move."""
    current_limit_A: Annotated[float, Limits(0.1, 20.0)]
    """Most that the motor may draw in a move."""


@dataclass(frozen=True, slots=True)
class Joints:
    """The joints from the rover outward."""

    azimuth: JointParams
    elevation: JointParams
    elbow: JointParams
    wrist: JointParams
    turret: JointParams

    def in_order(self) -> tuple[JointParams, ...]:
        """The joints in the order of Joint."""
        return (self.azimuth, self.elevation, self.elbow, self.wrist, self.turret)


@dataclass(frozen=True, slots=True)
class HardstopParams:
    """How a joint finds its negative hardstop, and where the others are meanwhile."""

    start_rad: Joints5
    """Where a joint waits for its turn."""
    park_rad: Joints5
    """Where it goes after it."""
    again_rad: Joints5
    """Where the elevation has its turn again once all joints are calibrated: its load there is chosen."""
    pose_tolerance_rad: Annotated[float, Limits(0.0, 0.5)]
    """How far a joint may be from there."""
    coarse_speed_share: Annotated[float, Limits(0.01, 1.0)]
    """Of the speed of a move, until the hardstop is met for the first time."""
    fine_speed_rad_s: Annotated[float, Limits(1e-4, 0.01)]
    """While it is measured."""
    retreat_rad: Annotated[float, Limits(0.005, 0.2)]
    """Way back between the two."""
    breakaway_A_s: Annotated[float, Limits(0.01, 20.0)]
    """How fast the current limit rises until the motor turns."""
    lead_rad: Annotated[float, Limits(1e-4, 2e-3)]
    """How far the set-point may be ahead of a motor that is held up."""
    stall_speed_share: Annotated[float, Limits(0.001, 0.5)]
    """Of the speed that it seeks with; a motor that is slower may have stalled."""
    stall_time_s: Annotated[float, Limits(0.05, 10.0)]
    """A motor slower than this share of its speed for this long, at its current limit, has stalled."""
    window_rad: Annotated[float, Limits(1e-3, 0.1)]
    """How far from its place, as the resolver tells it, a hardstop may be met."""
    moved_rad: Annotated[float, Limits(1e-4, 0.1)]
    """How far it may have moved since it was found last."""
    stiffness_ratio: Annotated[float, Limits(1.1, 10.0)]
    """A hardstop that seems softer or harder than the drawing's by more is none."""


@dataclass(frozen=True, slots=True)
class PoseParams:
    """Named arm poses and the way between them."""

    stowed_rad: Joints5
    """The arm folded away; outputs."""
    unstow_via_rad: tuple[Joints5, ...]
    """Outputs on the way from there to the ready pose, in order."""
    ready_rad: Joints5
    """Where work begins and ends; outputs."""


@dataclass(frozen=True, slots=True)
class MotionParams:
    """How a move begins, runs and ends."""

    brake_delay_s: Annotated[float, Limits(0.02, 1.0)]
    """Time a brake takes to hold or let go, at most."""
    settle_error_rad: Annotated[float, Limits(1e-6, 1e-2)]
    """How far from its set-point a motor at rest may be."""
    settle_rate_rad_s: Annotated[float, Limits(1e-7, 1e-2)]
    """How fast a motor at rest may still turn."""
    settle_time_s: Annotated[float, Limits(0.0, 10.0)]
    """How long both must hold."""
    settle_timeout_s: Annotated[float, Limits(0.1, 60.0)]
    """How long it may take until they do."""
    stop_factor: Annotated[float, Limits(1.0, 100.0)]
    """A commanded stop may use this many times the acceleration of a move."""
    stowed_rad: Annotated[float, Limits(0.0, 0.2)]
    """How close to the stowed pose every joint of a stowed arm is."""
    approach_rad: Annotated[float, Limits(1e-5, 0.05)]
    """An output that its load does not hold is dragged at least this far to the place where it is to rest."""
    tool_speed_m_s: Annotated[float, Limits(1e-3, 1.0)]
    """No joint move takes the drill faster: what it hits unforeseen, it hits as hard as it is fast."""
    guarded_speed_m_s: Annotated[float, Limits(1e-4, 0.02)]
    """Of the tool, while it looks for contact."""
    switch_force_N: Annotated[float, Limits(0.1, 50.0)]
    """At which a contact switch closes."""
    retract_speed_m_s: Annotated[float, Limits(1e-4, 0.05)]
    """Of the tool, in straight moves that look for nothing."""
    line_acceleration_m_s2: Annotated[float, Limits(1e-4, 0.1)]
    """Of the tool, in straight moves."""
    line_jerk_m_s3: Annotated[float, Limits(1e-4, 1.0)]
    """Of the tool, in straight moves."""
    line_step_m: Annotated[float, Limits(1e-3, 0.1)]
    """Spacing of the inverse-kinematics knots of a straight move."""
    line_max_m: Annotated[float, Limits(0.01, 2.0)]
    """Longest straight move."""
    line_turn_rad: Annotated[float, Limits(0.0, 0.5)]
    """How far the tool may look away from the approach when a guarded move begins."""
    load_period: Annotated[int, Limits(1, 640)]
    """Cycles between two estimates of load, backlash side and deflected tool pose."""


@dataclass(frozen=True, slots=True)
class PreloadParams:
    """How a tool is pressed on what it touches."""

    most_N: Annotated[float, Limits(1.0, 1000.0)]
    """The largest force that may be commanded."""
    rate_N_s: Annotated[float, Limits(0.1, 200.0)]
    """How fast the force grows."""
    step_N: Annotated[float, Limits(0.1, 100.0)]
    """The smallest change of a press: spacing of the knots of an overdrive."""
    error_share: Annotated[float, Limits(0.0, 1.0)]
    """How far the true force may be from the believed one, as a share of it, but at least error_N."""
    error_N: Annotated[float, Limits(0.0, 100.0)]
    """The least that the true force is taken to be off by."""
    guard_share: Annotated[float, Limits(0.05, 1.0)]
    """How far beyond the torque that a force takes the current limits are set, as a share of it."""


@dataclass(frozen=True, slots=True)
class TeachPoint:
    """A tool's place in RMECH as flight software believed it when the true tool was where it should be."""

    name: str
    """What commands call it."""
    tool: str
    """Which tool was taught, by its name in Tool."""
    p_RoTo_R_m: Vector3
    """Where it was believed to be."""
    approach_R: Vector3
    """Where it looked, as it was believed."""
    branch: str = "AUTO"
    """Of the inverse kinematics; AUTO, or one of the names in kinematics.branches.BRANCHES."""


@dataclass(frozen=True, slots=True)
class MonitorParams:
    """Bounds of the monitors; a persistence is the number of cycles a bound must be passed in a row."""

    gravity_min_m_s2: Annotated[float, Limits(0.0, 10.0)]
    """The least; a smaller reading is no gravity."""
    gravity_max_m_s2: Annotated[float, Limits(1.0, 30.0)]
    """Outside these a gravity reading is no gravity."""
    setpoint_step_factor: Annotated[float, Limits(1.0, 3.0)]
    """Largest change of a set-point in a cycle, in units of the joint's speed times the cycle."""
    following_error_rad: Annotated[float, Limits(1e-5, 0.1)]
    """How far a motor may be from its set-point."""
    following_persistence: Annotated[int, Limits(1, 640)]
    """For how long it must be farther."""
    soft_limit_margin_rad: Annotated[float, Limits(0.0, 0.03)]
    """Room beyond the soft limits of the output for wind-up and backlash of the motor angle."""
    over_current_fraction: Annotated[float, Limits(0.1, 1.0)]
    """Share of the joint's current limit."""
    over_current_persistence: Annotated[int, Limits(1, 640)]
    """For how long a motor must draw more."""
    resolver_error_rad: Annotated[float, Limits(1e-4, 0.1)]
    """How far a resolver may be from the believed output, its bias and the unknown share of the gap apart."""
    resolver_persistence: Annotated[int, Limits(1, 640)]
    """For how long a resolver must be off by more."""
    stall_share: Annotated[float, Limits(0.001, 0.9)]
    """A motor slower than this share of the speed that is asked for has stalled."""
    stall_error_rad: Annotated[float, Limits(1e-5, 0.1)]
    """A motor that is closer to its set-point is held up by friction, if at all."""
    stall_persistence: Annotated[int, Limits(1, 640)]
    """For how long a motor must be slower."""
    winding_min_C: Annotated[float, Limits(-150.0, 50.0)]
    """The coldest winding that may be moved."""
    winding_max_C: Annotated[float, Limits(0.0, 250.0)]
    """The hottest winding that is tolerated."""
    winding_persistence: Annotated[int, Limits(1, 640)]
    """For how long a winding must be outside these."""
    frozen_persistence: Annotated[int, Limits(2, 6400)]
    """For how long a reading must stay the same to the last bit."""
    missed_cycles: Annotated[int, Limits(0, 64)]
    """Missed cycles in a row that are tolerated."""
    tilt_rad: Annotated[float, Limits(1e-3, 0.5)]
    """How far gravity may turn during a move, and be from what the ground set."""
    tilt_persistence: Annotated[int, Limits(1, 640)]
    """For how long gravity must be turned by more."""
    contact_persistence: Annotated[int, Limits(1, 640)]
    """Cycles for which a tool that presses may have no switch closed."""
    preload_error_N: Annotated[float, Limits(1.0, 500.0)]
    """How far the force that the joints' wind-up tells may be from the one that is pressed with."""
    preload_persistence: Annotated[int, Limits(1, 640)]
    """For how long the force must be off by more."""
    guarded_force_N: Annotated[float, Limits(1.0, 500.0)]
    """Force on a guarded tool, as the joints' wind-up tells it, while no switch of it is closed."""


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of flight software."""

    arm_name: str
    """Whose parameters these are."""
    links: Links
    tools: Tools
    joints: Joints
    hardstop: HardstopParams
    poses: PoseParams
    motion: MotionParams
    preload: PreloadParams
    collision: CollisionParams
    monitors: MonitorParams
    teach: tuple[TeachPoint, ...]
