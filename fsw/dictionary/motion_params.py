"""Parameters of moves, presses, the search of hardstops, thermal compensation and monitors. SI units."""

from dataclasses import dataclass
from typing import Annotated

from fsw.dictionary.types import Joints5, Limits


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
    tool_speed_m_s: Annotated[float, Limits(5e-3, 1.0)]
    """Largest speed of the farthest tool in a joint move; it limits the impact on an unforeseen obstacle.

    The longest way of a tool, some 20 m, then takes less than the 7,600 s for which a path can be computed.
    """
    guarded_speed_m_s: Annotated[float, Limits(1e-4, 0.02)]
    """Speed of the tool in straight moves that meet something, or may: guarded and free ones."""
    switch_force_N: Annotated[float, Limits(0.1, 50.0)]
    """Force at which a contact switch closes."""
    retract_speed_m_s: Annotated[float, Limits(1e-4, 0.05)]
    """Speed of the tool in retractions."""
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
    spot_error_m: Annotated[float, Limits(0.0, 0.1)]
    """Largest error of a touched spot, from undecided backlash, with which a tool change begins."""
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
class HeatParams:
    """Compensation of the thermal growth of links and tools."""

    calibration_C: Annotated[float, Limits(-100.0, 60.0)]
    """Temperature of the structure at which the transforms of links and tools hold."""
    compensated_share: Annotated[float, Limits(0.0, 1.0)]
    """Share of the growth that flight software compensates; 0 turns the compensation off."""
    filter_s: Annotated[float, Limits(0.1, 3600.0)]
    """Time constant of the filter of the temperature."""
    step_K: Annotated[float, Limits(0.01, 50.0)]
    """Change of the filtered temperature at which flight software builds the arm anew."""


@dataclass(frozen=True, slots=True)
class MonitorParams:
    """Bounds of the monitors; a persistence is the number of cycles in a row beyond a bound."""

    gravity_min_m_s2: Annotated[float, Limits(0.0, 10.0)]
    """Lowest plausible gravity."""
    gravity_max_m_s2: Annotated[float, Limits(1.0, 30.0)]
    """Highest plausible gravity."""
    gravity_step_m_s2: Annotated[float, Limits(0.01, 10.0)]
    """Largest change of a component of gravity from reading to reading."""
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
    structure_step_K: Annotated[float, Limits(0.01, 100.0)]
    """Largest change of the temperature of the structure from reading to reading."""
    winding_step_K: Annotated[float, Limits(0.01, 100.0)]
    """Largest change of the temperature of a winding from reading to reading."""
    reading_persistence: Annotated[int, Limits(2, 64)]
    """Cycles in which a reading is not plausible."""
    frozen_persistence: Annotated[int, Limits(2, 6400)]
    """Cycles in which a reading stays the same to the last bit."""
    missed_cycles: Annotated[int, Limits(0, 64)]
    """Largest number of missed cycles in a row."""
    tilt_rad: Annotated[float, Limits(1e-3, 0.5)]
    """Largest turn of gravity during a move, and its largest difference from the commanded tilt."""
    tilt_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a larger turn."""
    contact_persistence: Annotated[int, Limits(1, 640)]
    """Cycles in which a tool that presses with more than `guarded_force_N` has no closed switch."""
    preload_error_N: Annotated[float, Limits(1.0, 500.0)]
    """Largest difference between commanded force and force estimated from the wind-up of the joints."""
    preload_persistence: Annotated[int, Limits(1, 640)]
    """Cycles of a larger force error."""
    current_noise_A: Annotated[float, Limits(1e-4, 1.0)]
    """Noise of a current reading, one sigma."""
    resolver_noise_rad: Annotated[float, Limits(1e-6, 1e-2)]
    """Noise of a resolver reading, one sigma, rounding included."""
    guarded_force_N: Annotated[float, Limits(1.0, 500.0)]
    """Largest force on a guarded tool while none of its switches is closed; before contact, from wind-up."""
