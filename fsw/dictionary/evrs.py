"""Event reports (EVRs) of flight software, as typed objects."""

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.types import SwitchName, ToolName


class Severity(IntEnum):
    """Severity of an event, after NASA's F Prime."""

    DIAGNOSTIC = 0
    ACTIVITY_LO = 1
    ACTIVITY_HI = 2
    COMMAND = 3
    WARNING_LO = 4
    WARNING_HI = 5
    FATAL = 6


@dataclass(frozen=True, slots=True)
class Evr:
    """Event; a subclass gives the severity, the text and the fields that the text names."""

    severity: ClassVar[Severity]
    text: ClassVar[str]

    @property
    def name(self) -> str:
        """Name of the event."""
        return type(self).__name__

    @property
    def message(self) -> str:
        """Text with its fields filled in."""
        return self.text.format(e=self)


@dataclass(frozen=True, slots=True)
class Booted(Evr):
    """Flight software runs its first cycle, on these parameters."""

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
    """A command completed as commanded."""

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
    """A command was ended before it was complete."""

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
    """Change of the encoder zero, or its difference from the first resolver reading."""
    running_Nm: float
    compliance_urad_Nm: float
    backlash_rad: float
    backlash_measured: bool


@dataclass(frozen=True, slots=True)
class BranchChosen(Evr):
    """A tool move takes this branch of the inverse kinematics."""

    severity = Severity.ACTIVITY_LO
    text = "{e.tool}: branch {e.branch}"
    tool: ToolName
    branch: str


@dataclass(frozen=True, slots=True)
class ContactMade(Evr):
    """A contact switch closed in a guarded move, as intended."""

    severity = Severity.ACTIVITY_HI
    text = "contact on {e.switch} after {e.travel_m:.4f} m"
    switch: SwitchName
    travel_m: float


@dataclass(frozen=True, slots=True)
class Preloaded(Evr):
    """The overdrive for a force is complete; the force is an estimate, because no sensor measures it."""

    severity = Severity.ACTIVITY_HI
    text = "{e.tool} pressed with {e.force_N:.1f} N"
    tool: ToolName
    force_N: float


@dataclass(frozen=True, slots=True)
class PreloadMissed(Evr):
    """A press ends with a force more than 10 % off, or not known to 10 %, for a reason."""

    severity = Severity.WARNING_LO
    text = "{e.tool} is pressed with about {e.force_N:.1f} N of {e.commanded_N:.1f} N: {e.reason}"
    tool: ToolName
    force_N: float
    commanded_N: float
    reason: str


@dataclass(frozen=True, slots=True)
class ForceEstimated(Evr):
    """Ratios of true to modelled force, estimated from motor currents; they correct the rest of the press."""

    severity = Severity.ACTIVITY_LO
    text = "{e.tool}: a newton of the model is {e.along:.3f} N along its axis, {e.across:.3f} N across"
    tool: ToolName
    along: float
    across: float


@dataclass(frozen=True, slots=True)
class SpotSet(Evr):
    """A tool change starts from this estimated position of the touching tool."""

    severity = Severity.ACTIVITY_LO
    text = "spot of {e.tool} at {e.x_m:.4f} {e.y_m:.4f} {e.z_m:.4f} m in RMECH"
    tool: ToolName
    x_m: float
    y_m: float
    z_m: float


@dataclass(frozen=True, slots=True)
class BacklashUndecided(Evr):
    """A tool change starts from a spot that a joint on an unknown flank may have put elsewhere."""

    severity = Severity.WARNING_LO
    text = (
        "{e.joint.name}: backlash undecided, the output may be {e.error_rad:.5f} rad from its estimate: "
        "{e.error_m:.4f} m at {e.tool}"
    )
    joint: Joint
    error_rad: float
    tool: ToolName
    error_m: float
    """Largest distance of the tool from its estimate, across its axis."""


@dataclass(frozen=True, slots=True)
class ParamSet(Evr):
    """A parameter has a new value; the digest is of all parameters."""

    severity = Severity.ACTIVITY_HI
    text = "{e.parameter} is {e.value:.9g}, parameters {e.params_sha256}"
    parameter: str
    value: float
    params_sha256: str


@dataclass(frozen=True, slots=True)
class TiltSet(Evr):
    """The ground set the tilt of the rover."""

    severity = Severity.ACTIVITY_HI
    text = "tilt set, {e.difference_rad:.4f} rad from what the IMU reads"
    difference_rad: float


@dataclass(frozen=True, slots=True)
class CyclesSkipped(Evr):
    """Flight software was not called for a tolerable number of cycles."""

    severity = Severity.WARNING_LO
    text = "{e.cycles} cycles missed"
    cycles: int


@dataclass(frozen=True, slots=True)
class ReadingNotUsed(Evr):
    """A reading is not plausible and is not used; the next ones are told only after it was plausible."""

    severity = Severity.WARNING_LO
    text = "{e.sensor} reads {e.value:.7g}, plausible is {e.lowest:.7g} .. {e.highest:.7g}; not used"
    sensor: str
    """Channel of the reading, and its index."""
    value: float
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True)
class FaultResponse(Evr):
    """Flight software responded to a fault."""

    severity = Severity.WARNING_HI
    text = "response {e.response}"
    response: str


@dataclass(frozen=True, slots=True)
class FaultCleared(Evr):
    """The ground cleared the fault."""

    severity = Severity.ACTIVITY_HI
    text = "fault cleared"


@dataclass(frozen=True, slots=True)
class SoftwareError(Evr):
    """An exception reached the outermost loop; the brakes are on and flight software has ended."""

    severity = Severity.FATAL
    text = "software error: {e.what}"
    what: str
