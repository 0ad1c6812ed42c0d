"""Parameters: everything about the arm and its motion that flight software takes on trust.

Plain records of numbers, so that they load strictly, hash to one digest and read as they are.
SI units, named in the suffix. Limits are annotations; the loader and the ground dictionary read them.
"""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.commands import Joints5, Vector3

Row6 = tuple[float, float, float, float, float, float]
Matrix6 = tuple[Row6, Row6, Row6, Row6, Row6, Row6]

_NO_ROW: Row6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
RIGID: Matrix6 = (_NO_ROW, _NO_ROW, _NO_ROW, _NO_ROW, _NO_ROW, _NO_ROW)


@dataclass(frozen=True, slots=True)
class Limits:
    """The closed range in which a number is believable."""

    low: float
    high: float


Length = Annotated[float, Limits(-5.0, 5.0)]
Angle = Annotated[float, Limits(-6.5, 6.5)]


@dataclass(frozen=True, slots=True)
class Transform6:
    """The general link transform D = Rz(theta) Tz(d) Ry(beta) Ty(b) Rx(alpha) Tx(a), paper equation 1."""

    theta_rad: Angle = 0.0
    d_m: Length = 0.0
    beta_rad: Angle = 0.0
    b_m: Length = 0.0
    alpha_rad: Angle = 0.0
    a_m: Length = 0.0


@dataclass(frozen=True, slots=True)
class Lump:
    """A point mass; its position is in the link frame, which turns with the link's joint."""

    mass_kg: Annotated[float, Limits(0.0, 200.0)] = 0.0
    com_m: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class LinkParams:
    """One link: the transform to the frame at its end, its spring, and its mass on either side of the spring.

    The spring sits at the elastic centre, given in the link frame (the frame at the link's start, turned by
    the link's joint). The compliance maps (moment, force) to (rotation, translation): rad/(N m), rad/N,
    m/(N m), m/N.
    """

    transform: Transform6
    elastic_centre_m: Vector3 = (0.0, 0.0, 0.0)
    compliance: Matrix6 = RIGID
    near: Lump = Lump()
    far: Lump = Lump()
    expansion_1_K: Row6 = _NO_ROW
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
    expansion_1_K: Row6 = _NO_ROW
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
    encoder_counts_per_turn: Annotated[int, Limits(1, 65536)]
    backlash_rad: Annotated[float, Limits(0.0, 0.02)]
    gear_stiffness_Nm_rad: Annotated[float, Limits(1e3, 1e8)]
    output_friction_Nm: Annotated[float, Limits(0.0, 200.0)]
    soft_min_rad: Angle
    soft_max_rad: Angle
    speed_rad_s: Annotated[float, Limits(1e-3, 0.1)]
    acceleration_rad_s2: Annotated[float, Limits(1e-3, 1.0)]
    jerk_rad_s3: Annotated[float, Limits(1e-3, 10.0)]
    current_limit_A: Annotated[float, Limits(0.1, 20.0)]


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
class PoseParams:
    """Named arm poses and the way between them."""

    stowed_rad: Joints5
    unstow_via_rad: tuple[Joints5, ...]
    ready_rad: Joints5


@dataclass(frozen=True, slots=True)
class MotionParams:
    """How a move begins, runs and ends."""

    brake_delay_s: Annotated[float, Limits(0.02, 1.0)]
    """Time a brake takes to hold or let go, at most."""
    settle_error_rad: Annotated[float, Limits(1e-6, 1e-2)]
    settle_rate_rad_s: Annotated[float, Limits(1e-7, 1e-2)]
    settle_time_s: Annotated[float, Limits(0.0, 10.0)]
    settle_timeout_s: Annotated[float, Limits(0.1, 60.0)]
    stop_factor: Annotated[float, Limits(1.0, 100.0)]
    """A commanded stop may use this many times the acceleration of a move."""
    stowed_rad: Annotated[float, Limits(0.0, 0.2)]
    """How close to the stowed pose every joint of a stowed arm is."""
    reference_margin_rad: Annotated[float, Limits(0.0, 0.2)]
    """How far beyond the soft limits, at a hardstop for one, a reference may be."""
    guarded_speed_m_s: Annotated[float, Limits(1e-4, 0.02)]
    retract_speed_m_s: Annotated[float, Limits(1e-4, 0.05)]
    line_acceleration_m_s2: Annotated[float, Limits(1e-4, 0.1)]
    line_jerk_m_s3: Annotated[float, Limits(1e-4, 1.0)]
    line_step_m: Annotated[float, Limits(1e-3, 0.1)]
    """Spacing of the inverse-kinematics knots of a straight move."""
    line_max_m: Annotated[float, Limits(0.01, 2.0)]
    """Longest straight move."""
    line_turn_rad: Annotated[float, Limits(0.0, 0.5)]
    """How far the tool may look away from the approach when a guarded move begins."""
    load_period: Annotated[int, Limits(1, 640)]
    """Cycles between two estimates of load, backlash side and deflected tool pose."""


@dataclass(frozen=True, slots=True)
class MonitorParams:
    """Bounds of the monitors; a persistence is the number of cycles a bound must be passed in a row."""

    gravity_min_m_s2: Annotated[float, Limits(0.0, 10.0)]
    gravity_max_m_s2: Annotated[float, Limits(1.0, 30.0)]
    """Outside these a gravity reading is no gravity."""
    setpoint_step_factor: Annotated[float, Limits(1.0, 3.0)]
    """Largest change of a set-point in a cycle, in units of the joint's speed times the cycle."""
    following_error_rad: Annotated[float, Limits(1e-5, 0.1)]
    following_persistence: Annotated[int, Limits(1, 640)]
    soft_limit_margin_rad: Annotated[float, Limits(0.0, 0.03)]
    """Room beyond the soft limits of the output for wind-up and backlash of the motor angle."""
    over_current_fraction: Annotated[float, Limits(0.1, 1.0)]
    """Share of the joint's current limit."""
    over_current_persistence: Annotated[int, Limits(1, 640)]


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of flight software."""

    arm_name: str
    links: Links
    tools: Tools
    joints: Joints
    poses: PoseParams
    motion: MotionParams
    monitors: MonitorParams
