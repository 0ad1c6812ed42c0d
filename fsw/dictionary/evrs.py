"""Event reports: what flight software says happened, as typed objects."""

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from fsw.dictionary.joints import Joint, Switch, Tool
from fsw.dictionary.modes import Mode


class Severity(IntEnum):
    """How much an event matters, after NASA's F Prime."""

    DIAGNOSTIC = 0
    ACTIVITY_LO = 1
    ACTIVITY_HI = 2
    COMMAND = 3
    WARNING_LO = 4
    WARNING_HI = 5
    FATAL = 6


@dataclass(frozen=True, slots=True)
class Evr:
    """An event; a subclass gives the severity, the text and the fields that the text names."""

    severity: ClassVar[Severity]
    text: ClassVar[str]

    @property
    def name(self) -> str:
        """The name of the event."""
        return type(self).__name__

    @property
    def message(self) -> str:
        """The text with its fields filled in."""
        return self.text.format(e=self)


@dataclass(frozen=True, slots=True)
class Booted(Evr):
    """The first cycle: which parameters flight software runs on."""

    severity = Severity.ACTIVITY_HI
    text = "flight software up, parameters {e.params_sha256}"
    params_sha256: str


@dataclass(frozen=True, slots=True)
class CommandAccepted(Evr):
    """A command passed its checks and begins."""

    severity = Severity.COMMAND
    text = "{e.command} accepted"
    command: str


@dataclass(frozen=True, slots=True)
class CommandCompleted(Evr):
    """A command reached its end as asked."""

    severity = Severity.COMMAND
    text = "{e.command} completed"
    command: str


@dataclass(frozen=True, slots=True)
class CommandRefused(Evr):
    """A command did not pass its checks; nothing moved."""

    severity = Severity.WARNING_LO
    text = "{e.command} refused: {e.reason}"
    command: str
    reason: str


@dataclass(frozen=True, slots=True)
class CommandAborted(Evr):
    """A command was ended before it was done."""

    severity = Severity.WARNING_LO
    text = "{e.command} aborted"
    command: str


@dataclass(frozen=True, slots=True)
class ModeChanged(Evr):
    """The arm's mode changed."""

    severity = Severity.ACTIVITY_LO
    text = "mode {e.before.name} -> {e.after.name}"
    before: Mode
    after: Mode


@dataclass(frozen=True, slots=True)
class JointCalibrated(Evr):
    """A joint found its hardstop; its encoder zero follows from it."""

    severity = Severity.ACTIVITY_HI
    text = (
        "{e.joint.name} calibrated: zero moved by {e.moved_rad:.6f} rad, runs with {e.running_Nm:.1f} N m, "
        "hardstop and gear give {e.compliance_urad_Nm:.2f} urad per N m, backlash {e.backlash_rad:.6f} rad "
        "(measured: {e.backlash_measured})"
    )
    joint: Joint
    moved_rad: float
    """Against the zero of before, or what the resolver said."""
    running_Nm: float
    compliance_urad_Nm: float
    backlash_rad: float
    backlash_measured: bool


@dataclass(frozen=True, slots=True)
class StalledEarly(Evr):
    """A joint that was looking for its hardstop stalled where there is none."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} stalled at {e.angle_rad:.4f} rad, its hardstop is at {e.stop_rad:.4f} rad"
    joint: Joint
    angle_rad: float
    """As its resolver reads."""
    stop_rad: float


@dataclass(frozen=True, slots=True)
class HardstopMissed(Evr):
    """A joint went beyond the place where its hardstop should be."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} is at {e.angle_rad:.4f} rad and met no hardstop at {e.stop_rad:.4f} rad"
    joint: Joint
    angle_rad: float
    """As its resolver reads."""
    stop_rad: float


@dataclass(frozen=True, slots=True)
class NoHardstop(Evr):
    """What a joint was pressed against is softer or harder than a hardstop."""

    severity = Severity.WARNING_HI
    text = (
        "{e.joint.name} is pressed on something that gives {e.compliance_urad_Nm:.2f} urad per N m, "
        "a hardstop gives {e.drawn_urad_Nm:.2f}"
    )
    joint: Joint
    compliance_urad_Nm: float
    drawn_urad_Nm: float


@dataclass(frozen=True, slots=True)
class HardstopMoved(Evr):
    """A hardstop is not where it was found last."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name}: its hardstop moved by {e.moved_rad:.6f} rad, bound {e.bound_rad:.6f} rad"
    joint: Joint
    moved_rad: float
    bound_rad: float


@dataclass(frozen=True, slots=True)
class MotorStuck(Evr):
    """A motor did not turn: not driven, seized, or held up while its current reads less than its limit."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} does not turn at {e.current_A:.2f} A, limit {e.limit_A:.2f} A"
    joint: Joint
    current_A: float
    limit_A: float


@dataclass(frozen=True, slots=True)
class CurrentImplausible(Evr):
    """A current was read that is above its limit, or drives against the motion."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} reads {e.current_A:.2f} A, which cannot be at a limit of {e.limit_A:.2f} A"
    joint: Joint
    current_A: float
    limit_A: float


@dataclass(frozen=True, slots=True)
class HardstopUnclear(Evr):
    """A joint stalled, but its torque did not rise along a line as it does on a hardstop."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} stalled where no hardstop can be told from its current"
    joint: Joint


@dataclass(frozen=True, slots=True)
class ResolverDisagrees(Evr):
    """A resolver is not where encoder, wind-up and backlash say that the output is."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name}: resolver off by {e.error_rad:.5f} rad, bound {e.bound_rad:.5f} rad"
    joint: Joint
    error_rad: float
    bound_rad: float


@dataclass(frozen=True, slots=True)
class BranchChosen(Evr):
    """Which inverse-kinematics branch a tool move takes."""

    severity = Severity.ACTIVITY_LO
    text = "{e.tool.name}: branch {e.branch}"
    tool: Tool
    branch: str


@dataclass(frozen=True, slots=True)
class ContactMade(Evr):
    """A contact switch closed in a guarded move: the move's goal."""

    severity = Severity.ACTIVITY_HI
    text = "contact on {e.switch.name} after {e.travel_m:.4f} m"
    switch: Switch
    travel_m: float


@dataclass(frozen=True, slots=True)
class SensorNotFinite(Evr):
    """A reading was NaN or infinite."""

    severity = Severity.WARNING_HI
    text = "non-finite reading in {e.sensor}"
    sensor: str


@dataclass(frozen=True, slots=True)
class GravityImplausible(Evr):
    """The gravity reading is smaller or larger than any gravity the arm works in."""

    severity = Severity.WARNING_HI
    text = "gravity reads {e.gravity_m_s2:.3g} m/s2, bounds {e.min_m_s2:.3g} .. {e.max_m_s2:.3g} m/s2"
    gravity_m_s2: float
    min_m_s2: float
    max_m_s2: float


@dataclass(frozen=True, slots=True)
class SetpointUnsafe(Evr):
    """A set-point was about to go out that is not finite, beyond the limits or too far from the last one."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name}: set-point {e.setpoint_rad:.4f} rad held back, last {e.last_rad:.4f} rad"
    joint: Joint
    setpoint_rad: float
    last_rad: float


@dataclass(frozen=True, slots=True)
class SoftLimitPassed(Evr):
    """A joint is beyond its soft limit and moving outward."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} at {e.angle_rad:.4f} rad, soft limit {e.limit_rad:.4f} rad"
    joint: Joint
    angle_rad: float
    limit_rad: float


@dataclass(frozen=True, slots=True)
class OverCurrent(Evr):
    """A motor drew more than its bound for longer than its persistence."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} drew {e.current_A:.2f} A, bound {e.bound_A:.2f} A"
    joint: Joint
    current_A: float
    bound_A: float


@dataclass(frozen=True, slots=True)
class FollowingErrorHigh(Evr):
    """A motor did not follow its set-point."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} is {e.error_rad:.5f} rad from its set-point, bound {e.bound_rad:.5f} rad"
    joint: Joint
    error_rad: float
    bound_rad: float


@dataclass(frozen=True, slots=True)
class ContactInFreeSpace(Evr):
    """A contact switch closed where nothing was to be touched."""

    severity = Severity.WARNING_HI
    text = "contact on {e.switch.name} in free space"
    switch: Switch


@dataclass(frozen=True, slots=True)
class NoContact(Evr):
    """A guarded move came to the end of its travel without contact."""

    severity = Severity.WARNING_HI
    text = "no contact within {e.travel_m:.4f} m of guarded travel"
    travel_m: float


@dataclass(frozen=True, slots=True)
class NotSettled(Evr):
    """A motor did not come to rest at its set-point in time."""

    severity = Severity.WARNING_HI
    text = "{e.joint.name} not settled: {e.error_rad:.6f} rad from its set-point"
    joint: Joint
    error_rad: float


@dataclass(frozen=True, slots=True)
class FaultResponse(Evr):
    """What was done about a fault."""

    severity = Severity.WARNING_HI
    text = "response {e.response}: stopped, brakes on, moves refused until the fault is cleared"
    response: str


@dataclass(frozen=True, slots=True)
class FaultCleared(Evr):
    """The ground cleared the fault."""

    severity = Severity.ACTIVITY_HI
    text = "fault cleared"


@dataclass(frozen=True, slots=True)
class SoftwareError(Evr):
    """An exception reached the outermost loop; brakes are on and flight software has ended."""

    severity = Severity.FATAL
    text = "software error: {e.what}"
    what: str
