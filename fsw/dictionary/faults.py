"""Faults: events that need a response; fsw/protect/responses.py defines the responses."""

from dataclasses import dataclass

from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr, Severity
from fsw.dictionary.types import SwitchName, ToolName


@dataclass(frozen=True, slots=True)
class Fault(Evr):
    """Fault; a subclass gives the text and its fields."""

    severity = Severity.WARNING_HI


@dataclass(frozen=True, slots=True)
class StalledEarly(Fault):
    """A joint that searched for its hardstop stalled at another angle."""

    text = "{e.joint.name} stalled at {e.angle_rad:.4f} rad, its hardstop is at {e.stop_rad:.4f} rad"
    joint: Joint
    angle_rad: float
    """Resolver reading."""
    stop_rad: float


@dataclass(frozen=True, slots=True)
class HardstopMissed(Fault):
    """A joint passed the angle of its hardstop."""

    text = "{e.joint.name} is at {e.angle_rad:.4f} rad and met no hardstop at {e.stop_rad:.4f} rad"
    joint: Joint
    angle_rad: float
    """Resolver reading."""
    stop_rad: float


@dataclass(frozen=True, slots=True)
class HardstopImplausible(Fault):
    """A joint pressed on an obstacle that is softer or harder than a hardstop."""

    text = (
        "{e.joint.name} is pressed on something that gives {e.compliance_urad_Nm:.2f} urad per N m, "
        "a hardstop gives {e.nominal_urad_Nm:.2f}"
    )
    joint: Joint
    compliance_urad_Nm: float
    nominal_urad_Nm: float


@dataclass(frozen=True, slots=True)
class HardstopMoved(Fault):
    """A hardstop is not at the angle of the last calibration."""

    text = "{e.joint.name}: its hardstop moved by {e.moved_rad:.6f} rad, bound {e.bound_rad:.6f} rad"
    joint: Joint
    moved_rad: float
    bound_rad: float


@dataclass(frozen=True, slots=True)
class MotorStuck(Fault):
    """A motor did not turn: it has no power, is seized, or is held up below its current limit."""

    text = "{e.joint.name} does not turn at {e.current_A:.2f} A, limit {e.limit_A:.2f} A"
    joint: Joint
    current_A: float
    limit_A: float


@dataclass(frozen=True, slots=True)
class CurrentImplausible(Fault):
    """A current reading is above its limit, or of the wrong sign for the motion."""

    text = "{e.joint.name} reads {e.current_A:.2f} A, which cannot be at a limit of {e.limit_A:.2f} A"
    joint: Joint
    current_A: float
    limit_A: float


@dataclass(frozen=True, slots=True)
class HardstopUnclear(Fault):
    """A joint stalled, but its torque did not rise linearly as on a hardstop."""

    text = "{e.joint.name} stalled where no hardstop can be told from its current"
    joint: Joint


@dataclass(frozen=True, slots=True)
class ResolverDisagrees(Fault):
    """A resolver disagrees with the output angle from encoder, wind-up and backlash."""

    text = "{e.joint.name}: resolver off by {e.error_rad:.5f} rad, bound {e.bound_rad:.5f} rad"
    joint: Joint
    error_rad: float
    bound_rad: float


@dataclass(frozen=True, slots=True)
class ReadingImplausible(Fault):
    """A reading has not been plausible for as long as its persistence."""

    text = "{e.sensor} reads {e.value:.7g}, plausible is {e.lowest:.7g} .. {e.highest:.7g}"
    sensor: str
    """Channel of the reading, and its index."""
    value: float
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True)
class SetpointUnsafe(Fault):
    """A set-point was held back: not finite, beyond the limits, or too far from the last one."""

    text = "{e.joint.name}: set-point {e.setpoint_rad:.4f} rad held back, last {e.last_rad:.4f} rad"
    joint: Joint
    setpoint_rad: float
    last_rad: float


@dataclass(frozen=True, slots=True)
class SoftLimitPassed(Fault):
    """A joint is beyond its soft limit and moves outward."""

    text = "{e.joint.name} at {e.angle_rad:.4f} rad, soft limit {e.limit_rad:.4f} rad"
    joint: Joint
    angle_rad: float
    limit_rad: float


@dataclass(frozen=True, slots=True)
class OverCurrent(Fault):
    """A motor drew more than its bound for longer than its persistence."""

    text = "{e.joint.name} drew {e.current_A:.2f} A, bound {e.bound_A:.2f} A"
    joint: Joint
    current_A: float
    bound_A: float


@dataclass(frozen=True, slots=True)
class FollowingErrorHigh(Fault):
    """A motor did not follow its set-point."""

    text = "{e.joint.name} is {e.error_rad:.5f} rad from its set-point, bound {e.bound_rad:.5f} rad"
    joint: Joint
    error_rad: float
    bound_rad: float


@dataclass(frozen=True, slots=True)
class ContactInFreeSpace(Fault):
    """A contact switch closed in a move without intended contact."""

    text = "contact on {e.switch} in free space"
    switch: SwitchName


@dataclass(frozen=True, slots=True)
class UnexpectedContact(Fault):
    """A free move meets resistance, which winds up the gears."""

    text = (
        "unexpected contact: {e.joint.name} resists with {e.torque_Nm:.0f} N m, "
        "about {e.force_N:.0f} N at the tool"
    )
    joint: Joint
    torque_Nm: float
    """Change of the torque on the joint since the move was free."""
    force_N: float
    """Force against the motion of the tool that explains the torques of all joints; 0 without a lever."""

    @property
    def message(self) -> str:
        """Text with its fields filled in; without a lever it tells the torque only."""
        text = self.text if self.force_N else self.text.partition(",")[0]
        return text.format(e=self)


@dataclass(frozen=True, slots=True)
class NoContact(Fault):
    """A guarded move ended without contact."""

    text = "no contact within {e.travel_m:.4f} m of guarded travel"
    travel_m: float


@dataclass(frozen=True, slots=True)
class NotSettled(Fault):
    """A motor did not come to rest at its set-point in time."""

    text = "{e.joint.name} not settled: {e.error_rad:.6f} rad from its set-point"
    joint: Joint
    error_rad: float


@dataclass(frozen=True, slots=True)
class MotorStalled(Fault):
    """A motor does not turn although it is commanded to."""

    text = (
        "{e.joint.name} stalled: turns at {e.rate_rad_s:.5f} rad/s, asked for {e.commanded_rad_s:.5f} rad/s"
    )
    joint: Joint
    rate_rad_s: float
    commanded_rad_s: float


@dataclass(frozen=True, slots=True)
class OverTemperature(Fault):
    """A winding is above its highest temperature."""

    text = "{e.joint.name}: winding at {e.winding_C:.1f} degC, bound {e.bound_C:.1f} degC"
    joint: Joint
    winding_C: float
    bound_C: float


@dataclass(frozen=True, slots=True)
class UnderTemperature(Fault):
    """A motor below its lowest temperature was moved."""

    text = "{e.joint.name}: winding at {e.winding_C:.1f} degC, bound {e.bound_C:.1f} degC"
    joint: Joint
    winding_C: float
    bound_C: float


@dataclass(frozen=True, slots=True)
class SensorFrozen(Fault):
    """A reading stayed the same to the last bit for longer than a working sensor allows."""

    text = "{e.sensor} reads the same for {e.cycles} cycles"
    sensor: str
    cycles: int


@dataclass(frozen=True, slots=True)
class CyclesMissed(Fault):
    """Flight software was not called for more cycles than a move tolerates."""

    text = "{e.cycles} cycles missed, at most {e.bound} are tolerated"
    cycles: int
    bound: int


@dataclass(frozen=True, slots=True)
class CycleCountWrong(Fault):
    """The cycle count of the avionics did not rise: the readings are old, or the avionics restarted."""

    text = "cycle count {e.cycle} after {e.last_cycle}, it must rise"
    cycle: int
    last_cycle: int


@dataclass(frozen=True, slots=True)
class TiltChanged(Fault):
    """Gravity turned while the arm moved, or disagrees with the tilt that the ground set."""

    text = "gravity turned by {e.turned_rad:.4f} rad, bound {e.bound_rad:.4f} rad"
    turned_rad: float
    bound_rad: float


@dataclass(frozen=True, slots=True)
class ContactLost(Fault):
    """A tool that presses has no closed contact switch."""

    text = "{e.tool} lost contact"
    tool: ToolName


@dataclass(frozen=True, slots=True)
class PreloadOutside(Fault):
    """The force estimated from the joints differs from the commanded one."""

    text = "force on {e.tool} off by {e.error_N:.1f} N from {e.force_N:.1f} N, bound {e.bound_N:.1f} N"
    tool: ToolName
    force_N: float
    error_N: float
    bound_N: float
