"""Parameters of flight software: everything that it assumes about the arm and its motion.

Plain records of numbers load strictly, have one digest and read well. The names give SI units. Annotations
give the limits; the loader and the ground dictionary read them.
"""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.collision_params import CollisionParams, PartGeometry
from fsw.dictionary.heat_params import HeatParams
from fsw.dictionary.types import Angle, Joints5, Length, Limits, Matrix6, Row6, Vector3

_ZERO_ROW: Row6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
RIGID: Matrix6 = (_ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW, _ZERO_ROW)
"""Compliance of a rigid link."""


@dataclass(frozen=True, slots=True)
class Transform6:
    """General link transform D = Rz(theta) Tz(d) Ry(beta) Ty(b) Rx(alpha) Tx(a), equation 1 of the paper."""

    theta_rad: Angle = 0.0
    """Turn about z, to which the angle of the link's joint is added."""
    d_m: Length = 0.0
    """Translation along z, after theta."""
    beta_rad: Angle = 0.0
    """Turn about y, after d."""
    b_m: Length = 0.0
    """Translation along y, after beta."""
    alpha_rad: Angle = 0.0
    """Turn about x, after b."""
    a_m: Length = 0.0
    """Translation along x, after alpha."""


@dataclass(frozen=True, slots=True)
class PointMass:
    """Point mass in the link frame, which turns with the joint of the link."""

    mass_kg: Annotated[float, Limits(0.0, 200.0)] = 0.0
    """Mass."""
    com_m: Vector3 = (0.0, 0.0, 0.0)
    """Position."""


@dataclass(frozen=True, slots=True)
class LinkParams:
    """Link: the transform to the frame at its end, its spring, and its mass on either side of the spring.

    The spring is at the elastic centre, in the link frame. The link frame is the frame at the start of the
    link, turned by its joint. The compliance maps (moment, force) to (rotation, translation).
    """

    transform: Transform6
    elastic_centre_m: Vector3 = (0.0, 0.0, 0.0)
    """Position of the spring in the link frame."""
    compliance: Matrix6 = RIGID
    """Compliance of the spring, moment first, with mixed units: rad/(N m), rad/N, m/(N m), m/N."""
    near: PointMass = PointMass()
    far: PointMass = PointMass()
    expansion_1_K: Row6 = _ZERO_ROW
    """Expansion per kelvin at the end of the link, in its end frame: rotation [rad/K], translation [m/K]."""


@dataclass(frozen=True, slots=True)
class Links:
    """Links, named by the frame at their end; arm1 is the rover up to the azimuth joint, without a joint."""

    arm1: LinkParams
    arm2: LinkParams
    arm3: LinkParams
    arm4: LinkParams
    arm5: LinkParams
    arm6: LinkParams

    def in_order(self) -> tuple[LinkParams, ...]:
        """Return the links from the rover outward."""
        return (self.arm1, self.arm2, self.arm3, self.arm4, self.arm5, self.arm6)


@dataclass(frozen=True, slots=True)
class ToolParams:
    """Tool on the turret: its frame in the turret frame Arm6, and its shapes.

    The x axis of the tool is the approach direction.
    """

    name: str
    """Name in commands, in small letters."""
    title: str
    """Name in sentences."""
    transform: Transform6
    geometry: PartGeometry
    """Shapes for the collision check, in the tool frame."""
    expansion_1_K: Row6 = _ZERO_ROW
    """Expansion per kelvin, in tool axes."""


@dataclass(frozen=True, slots=True)
class SwitchParams:
    """Contact switch, with a bit in the sensor word."""

    name: str
    """Name in events, in small letters."""
    tool: str
    """Name of the tool that it is on."""


@dataclass(frozen=True, slots=True)
class JointParams:
    """Joint and its actuator; angles, speeds and torques are those of the output."""

    gear_ratio: Annotated[float, Limits(1.0, 1e5)]
    """Turns of the motor for one turn of the output."""
    encoder_counts_per_turn: Annotated[int, Limits(1, 65536)]
    """Encoder counts per turn of the motor."""
    backlash_rad: Annotated[float, Limits(0.0, 0.02)]
    """Nominal full width of the backlash."""
    gear_stiffness_Nm_rad: Annotated[float, Limits(1e3, 1e8)]
    """Stiffness of the gear between motor and output."""
    output_friction_Nm: Annotated[float, Limits(0.0, 200.0)]
    """Static friction of the output."""
    damping_Nms_rad: Annotated[float, Limits(0.0, 1e5)]
    """Viscous friction of motor and gear at the lowest temperature of a move."""
    load_error_Nm: Annotated[float, Limits(0.0, 100.0)]
    """Largest error of the modelled load, less the friction of the output, on Mars."""
    torque_constant_Nm_A: Annotated[float, Limits(1.0, 1e4)]
    """Torque constant of the motor, at the output."""
    hardstop_rad: Angle
    """Output angle at the negative hardstop."""
    hardstop_stiffness_Nm_rad: Annotated[float, Limits(1e3, 1e8)]
    """Stiffness of the hardstop, without the gear."""
    hardstop_press_Nm: Annotated[float, Limits(1.0, 2000.0)]
    """Torque, above the running torque, at which a joint on its hardstop stalls."""
    hardstop_rated_Nm: Annotated[float, Limits(1.0, 5000.0)]
    """Rated torque of the hardstop."""
    soft_min_rad: Angle
    """Lowest output angle of a move."""
    soft_max_rad: Angle
    """Highest output angle of a move."""
    speed_rad_s: Annotated[float, Limits(1e-3, 0.1)]
    """Highest speed of a move."""
    acceleration_rad_s2: Annotated[float, Limits(1e-3, 1.0)]
    """Highest acceleration of a move."""
    jerk_rad_s3: Annotated[float, Limits(1e-3, 10.0)]
    """Highest jerk of a move."""
    current_limit_A: Annotated[float, Limits(0.1, 20.0)]
    """Current limit of the motor in a move."""


@dataclass(frozen=True, slots=True)
class Joints:
    """The joints from the rover outward."""

    azimuth: JointParams
    elevation: JointParams
    elbow: JointParams
    wrist: JointParams
    turret: JointParams

    def in_order(self) -> tuple[JointParams, ...]:
        """Return the joints in the order of Joint."""
        return (self.azimuth, self.elevation, self.elbow, self.wrist, self.turret)


@dataclass(frozen=True, slots=True)
class HardstopParams:
    """Search of the negative hardstops, and poses of the joints during it."""

    start_rad: Joints5
    """Angles of the joints before their calibration."""
    park_rad: Joints5
    """Angles of the joints after their calibration."""
    second_start_rad: Joints5
    """Pose for the second calibration of the elevation, when all joints are calibrated and its load is
    known."""
    pose_tolerance_rad: Annotated[float, Limits(0.0, 0.5)]
    """Largest distance of a joint from these angles."""
    coarse_speed_share: Annotated[float, Limits(0.01, 1.0)]
    """Speed until the first contact with the hardstop, as a share of the speed of a move."""
    fine_speed_rad_s: Annotated[float, Limits(1e-4, 0.01)]
    """Speed of the measurement."""
    retreat_rad: Annotated[float, Limits(0.005, 0.2)]
    """Way back between first contact and measurement."""
    breakaway_A_s: Annotated[float, Limits(0.01, 20.0)]
    """Rate at which the current limit rises until the motor turns."""
    lead_rad: Annotated[float, Limits(1e-4, 2e-3)]
    """Largest lead of the set-point before a motor that is held up."""
    stall_speed_share: Annotated[float, Limits(0.001, 0.5)]
    """Share of the commanded speed below which a motor may have stalled."""
    stall_time_s: Annotated[float, Limits(0.05, 10.0)]
    """Time below this share of the speed, at the current limit, after which a motor has stalled."""
    window_rad: Annotated[float, Limits(1e-3, 0.1)]
    """Largest distance of a hardstop from its nominal angle, by the resolver."""
    moved_rad: Annotated[float, Limits(1e-4, 0.1)]
    """Largest change of a hardstop since the last calibration."""
    stiffness_ratio: Annotated[float, Limits(1.1, 10.0)]
    """Largest ratio of measured to nominal stiffness, or of nominal to measured, of a hardstop."""


@dataclass(frozen=True, slots=True)
class PoseParams:
    """Named poses of the arm and the way between them."""

    stowed_rad: Joints5
    """Output angles of the stowed arm."""
    unstow_via_rad: tuple[Joints5, ...]
    """Output angles of the way points from the stowed to the ready pose, in order."""
    ready_rad: Joints5
    """Output angles of the pose in which work begins and ends."""


@dataclass(frozen=True, slots=True)
class MotionParams:
    """Parameters of moves."""

    brake_delay_s: Annotated[float, Limits(0.02, 1.0)]
    """Largest time that a brake takes to engage or release."""
    settle_error_rad: Annotated[float, Limits(1e-6, 1e-2)]
    """Largest distance of a motor at rest from its set-point."""
    settle_rate_rad_s: Annotated[float, Limits(1e-7, 1e-2)]
    """Largest rate of a motor at rest."""
    settle_time_s: Annotated[float, Limits(0.0, 10.0)]
    """Time for which both must hold."""
    settle_timeout_s: Annotated[float, Limits(0.1, 60.0)]
    """Largest time until both hold."""
    stop_factor: Annotated[float, Limits(1.0, 100.0)]
    """Deceleration of a commanded stop, as a multiple of the acceleration of a move."""
    stow_tolerance_rad: Annotated[float, Limits(0.0, 0.2)]
    """Largest distance of each joint of a stowed arm from the stowed pose."""
    takeup_rad: Annotated[float, Limits(1e-5, 0.05)]
    """Least distance over which the gear drags an output that its load does not hold to its goal."""
    tool_speed_m_s: Annotated[float, Limits(1e-3, 1.0)]
    """Largest speed of the farthest tool in a joint move; it limits the impact on an unforeseen obstacle."""
    guarded_speed_m_s: Annotated[float, Limits(1e-4, 0.02)]
    """Speed of the tool in a guarded move."""
    switch_force_N: Annotated[float, Limits(0.1, 50.0)]
    """Force at which a contact switch closes."""
    retract_speed_m_s: Annotated[float, Limits(1e-4, 0.05)]
    """Speed of the tool in straight moves that do not seek contact."""
    line_acceleration_m_s2: Annotated[float, Limits(1e-4, 0.1)]
    """Acceleration of the tool in straight moves."""
    line_jerk_m_s3: Annotated[float, Limits(1e-4, 1.0)]
    """Jerk of the tool in straight moves."""
    line_step_m: Annotated[float, Limits(1e-3, 0.1)]
    """Spacing of the inverse-kinematics knots of a straight move."""
    line_max_m: Annotated[float, Limits(0.01, 2.0)]
    """Longest straight move."""
    line_turn_rad: Annotated[float, Limits(0.0, 0.5)]
    """Largest angle between tool axis and approach at the start of a guarded move."""
    load_period_cycles: Annotated[int, Limits(1, 640)]
    """Number of cycles between two estimates of load, backlash side, temperature and tool pose."""


@dataclass(frozen=True, slots=True)
class PreloadParams:
    """Parameters of pressing a tool on a surface."""

    max_force_N: Annotated[float, Limits(1.0, 1000.0)]
    """Largest force that may be commanded."""
    rate_N_s: Annotated[float, Limits(0.1, 200.0)]
    """Rate of the force."""
    step_N: Annotated[float, Limits(0.1, 100.0)]
    """Smallest change of force: spacing of the knots of an overdrive."""
    error_share: Annotated[float, Limits(0.0, 1.0)]
    """Largest error of the estimated force, as a share of it, but at least error_N."""
    error_N: Annotated[float, Limits(0.0, 100.0)]
    """Least bound of the error of the estimated force."""
    current_margin_share: Annotated[float, Limits(0.05, 1.0)]
    """Margin of the current limits above the torque that a force takes, as a share of it."""


@dataclass(frozen=True, slots=True)
class TeachPoint:
    """Taught point: the pose of a tool in RMECH that flight software estimated at the correct pose."""

    name: str
    """Name of the point in commands."""
    tool: str
    """Name of the taught tool."""
    p_RoTo_R_m: Vector3
    """Estimated position of the tool."""
    approach_R: Vector3
    """Estimated direction of the tool's x axis."""
    branch: str = "auto"
    """Branch of the inverse kinematics: auto, or one of the names in kinematics.branches.BRANCHES."""


@dataclass(frozen=True, slots=True)
class MonitorParams:
    """Bounds of the monitors; a persistence is the number of cycles in a row beyond a bound."""

    gravity_min_m_s2: Annotated[float, Limits(0.0, 10.0)]
    """Lowest plausible gravity."""
    gravity_max_m_s2: Annotated[float, Limits(1.0, 30.0)]
    """Highest plausible gravity."""
    setpoint_step_factor: Annotated[float, Limits(1.0, 3.0)]
    """Largest change of a set-point per cycle, in units of joint speed times cycle time."""
    following_error_rad: Annotated[float, Limits(1e-5, 0.1)]
    """Largest distance of a motor from its set-point."""
    following_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a larger following error."""
    soft_limit_margin_rad: Annotated[float, Limits(0.0, 0.03)]
    """Margin of the motor angle beyond the soft limits of the output, for wind-up and backlash."""
    over_current_fraction: Annotated[float, Limits(0.1, 1.0)]
    """Share of the current limit of the joint."""
    over_current_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a larger current."""
    resolver_error_rad: Annotated[float, Limits(1e-4, 0.1)]
    """Largest difference of resolver and estimated output, beyond the bias and the uncertainty of the gear
    angle."""
    resolver_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a larger resolver error."""
    stall_share: Annotated[float, Limits(0.001, 0.9)]
    """Share of the commanded speed below which a motor has stalled."""
    stall_error_rad: Annotated[float, Limits(1e-5, 0.1)]
    """Distance from the set-point below which a motor is never stalled; friction may hold it."""
    stall_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a lower speed."""
    winding_min_C: Annotated[float, Limits(-150.0, 50.0)]
    """Lowest temperature of a winding that may move."""
    winding_max_C: Annotated[float, Limits(0.0, 250.0)]
    """Highest temperature of a winding."""
    winding_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a winding outside these temperatures."""
    structure_min_C: Annotated[float, Limits(-150.0, 50.0)]
    """Lowest plausible temperature of the structure."""
    structure_max_C: Annotated[float, Limits(0.0, 100.0)]
    """Highest plausible temperature of the structure."""
    frozen_persistence: Annotated[int, Limits(2, 6400)]
    """Cycles in which a reading stays the same to the last bit."""
    missed_cycles: Annotated[int, Limits(0, 64)]
    """Largest number of missed cycles in a row."""
    tilt_rad: Annotated[float, Limits(1e-3, 0.5)]
    """Largest turn of gravity during a move, and its largest difference from the commanded tilt."""
    tilt_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a larger turn."""
    contact_persistence: Annotated[int, Limits(1, 640)]
    """Cycles in which a tool that presses has no closed switch."""
    preload_error_N: Annotated[float, Limits(1.0, 500.0)]
    """Largest difference between commanded force and force estimated from the wind-up of the joints."""
    preload_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a larger force error."""
    current_noise_A: Annotated[float, Limits(1e-4, 1.0)]
    """Noise of a current reading, one sigma."""
    resolver_noise_rad: Annotated[float, Limits(1e-6, 1e-2)]
    """Noise of a resolver reading, one sigma, rounding included."""
    guarded_force_N: Annotated[float, Limits(1.0, 500.0)]
    """Largest force on a guarded tool, estimated from wind-up, while none of its switches is closed."""


@dataclass(frozen=True, slots=True)
class ModelParams:
    """Drawing that the parameters belong to."""

    name: str
    """Name of the drawing."""
    sha256: str
    """SHA-256 of its description."""


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of flight software."""

    arm_name: str
    """Name of the arm."""
    model: ModelParams
    links: Links
    tools: tuple[ToolParams, ...]
    """Tools on the turret, in the order of every array of tools."""
    switches: tuple[SwitchParams, ...]
    """Contact switches, in the order of the sensor word."""
    joints: Joints
    hardstop: HardstopParams
    poses: PoseParams
    motion: MotionParams
    heat: HeatParams
    preload: PreloadParams
    collision: CollisionParams
    monitors: MonitorParams
    teach: tuple[TeachPoint, ...]

    @property
    def tool_names(self) -> tuple[str, ...]:
        """Return the names of the tools, in order."""
        return tuple(tool.name for tool in self.tools)

    @property
    def tool_switches(self) -> dict[str, tuple[int, ...]]:
        """Return the indices of the contact switches of each tool."""
        return {
            tool.name: tuple(k for k, switch in enumerate(self.switches) if switch.tool == tool.name)
            for tool in self.tools
        }
