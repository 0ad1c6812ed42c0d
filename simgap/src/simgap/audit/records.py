"""Records of an audit: rates, remarks, and the samples that a diagnosis must not use."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from simgap.arrays import Flags
from simgap.result import Refusal


class RemarkKind(StrEnum):
    """Kinds of remarks, the worst first."""

    UNIT = "unit looks wrong"
    CONSTANT = "position is constant"
    CONTACT = "contact with a plane"
    CUT_OFF = "command is cut off"
    SATURATION = "saturation"
    COLLISION = "collision in the model"
    TURNS = "many turns"
    STALE = "stale samples"
    MISSING = "missing samples"
    JITTER = "uneven rate"


@dataclass(frozen=True, slots=True)
class Remark:
    """Something that the logs show and that is not an effect of the catalogue."""

    kind: RemarkKind
    joint: str
    """Name of the joint; empty for the whole robot."""
    motions: tuple[str, ...]
    text: str
    """Sentence for the user."""
    value: float = float("nan")
    """Number that was estimated, in `unit`; NaN if there is none."""
    interval: tuple[float, float] = (float("nan"), float("nan"))
    """90 % interval of the value."""
    unit: str = ""


@dataclass(frozen=True, slots=True)
class SignalRate:
    """Rate of the position of one joint in one motion."""

    motion: str
    joint: str
    n_samples: int
    duration_s: float
    rate_Hz: float
    """Reciprocal of the median period; NaN for fewer than two samples."""
    jitter_s: float
    """Half the distance of the quantiles 5 % and 95 % of the period."""
    n_missing: int
    """Rows that are missing in gaps between samples."""
    n_invalid: int
    """Samples that are not finite."""
    n_stale: int
    """Samples that repeat an old value while the joint moves."""


@dataclass(frozen=True, slots=True)
class Audit:
    """Result of an audit."""

    rates: tuple[SignalRate, ...]
    remarks: tuple[Remark, ...]
    """The worst first."""
    refused: tuple[Refusal, ...]
    usable: Mapping[tuple[str, str], Flags]
    """(motion, joint) -> flags over its position samples."""

    def is_usable(self, motion: str, joint: str) -> Flags:
        """Return which position samples of a joint a diagnosis may use, (n,)."""
        return self.usable[motion, joint]
