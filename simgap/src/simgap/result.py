"""Records of a diagnosis: what was found, how sure, how far, and what remains."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from simgap.effects.effect import READING_HOOKS, Effect
from simgap.effects.variation import Variation
from simgap.logs import Motion
from simgap.residuals.residuals import SECOND_ENCODER
from simgap.robot import Robot

MOST: Final = 0.5
"""Share of an error from which on a cause accounts for most of it."""
MIN_REMAINDER: Final = 1.2
"""Least error over that of noise that is told to remain: the noise is known from few repeats."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One effect that the data need, with the sets that cannot be excluded at 5 %."""

    place: str
    family: StrEnum
    effect: str
    size: tuple[float, ...]
    size_names: tuple[str, ...]
    interval: tuple[tuple[float, float], ...]
    """90 % interval of each size."""
    text: str
    """The sizes as `Effect.describe` gives them."""
    share: float
    """Share of the explainable error of its joint that comes back without it, in motions left out."""
    places: tuple[str, ...]
    """Places that cannot be excluded, the best first."""
    families: tuple[StrEnum, ...]
    effects: tuple[str, ...]
    """Keys of effects that cannot be excluded."""
    next_motion: str
    """Motion that would separate the members of the sets; empty if one is left."""


@dataclass(frozen=True, slots=True)
class Base:
    """Fitted number of a joint that the model does not know for certain; not a finding."""

    place: str
    name: str
    nominal: float
    value: float
    interval: tuple[float, float]
    is_identifiable: bool
    """False if the data show nothing of it, or only its ratio to the gain where that is fitted too."""
    share: float = math.nan
    """Share of the mean error of its joint that comes back with the number of the model; NaN if not known."""
    is_pushed: bool = False
    """True if it ends at a bound that the motions contradict."""

    @property
    def differs(self) -> bool:
        """Return whether the model is wrong here: the interval says so, and so does half of the error."""
        low, high = self.interval
        return self.is_identifiable and not low <= self.nominal <= high and not self.share < MOST


@dataclass(frozen=True, slots=True)
class JointError:
    """Mean absolute residual of one joint on held-out motions, on the fitted ones if none is held out.

    For a tracker it is the root mean square.
    """

    joint: str
    unit: str
    nominal: float
    """With the model as it is."""
    base: float
    """With its base parameters fitted."""
    explained: float
    """With base parameters and findings fitted."""
    noise_floor: float
    """From repeats; NaN if unknown."""
    kind: str = ""
    """Kind of residual."""


@dataclass(frozen=True, slots=True)
class Remainder:
    """Residual of one joint that no effect of the catalogue explains."""

    joint: str
    regime: str
    """"slow", "fast" or "all motion"; "at rest" for a tracker."""
    mean_abs: float
    unit: str
    depends_on: str
    """Variable on which it depends most: "position", "velocity", ..; empty if on none."""
    depends_share: float
    """Share of its variance that this variable explains in motions that took no part."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Samples or motions that took no part, and why."""

    motion: str
    reason: str
    n_samples: int


@dataclass(frozen=True, slots=True)
class Rejected:
    """Effect that was tested and is not named."""

    place: str
    effect: str
    reason: str
    """Numbers of the test, as a part of a sentence."""


@dataclass(frozen=True, slots=True)
class Rival:
    """Model with an effect in place of a finding, or with the finding itself, as fitted to the motions."""

    finding: str
    """Key of the finding."""
    effect: str
    """Key of the effect in its place."""
    p: float
    """Probability that the finding fits so much better, or more, if this is the cause; 1 for itself, and for
    all rivals of a finding without a name."""
    kind: str
    """Kind of residual."""
    effects: tuple[Effect, ...]
    """All effects that act, of base and findings; first those that were fitted together with this one."""
    sizes: tuple[tuple[float, ...], ...]
    n_fitted: int
    """Number of effects that were fitted together with this one, itself included."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Result of `diagnose`."""

    robot: str
    kind: str
    seed: int
    findings: tuple[Finding, ...]
    base: tuple[Base, ...]
    errors: tuple[JointError, ...]
    remaining: tuple[Remainder, ...]
    refused: tuple[Refusal, ...]
    fitted_motions: tuple[str, ...]
    judged_motions: tuple[str, ...]
    effects: tuple[Effect, ...]
    """The effects of base and findings as fitted, from which a patch is made."""
    sizes: tuple[tuple[float, ...], ...]
    rejected: tuple[Rejected, ...] = ()
    method: str = ""
    """How residuals were made, with the filter: sentences for a report."""
    remarks: tuple[str, ...] = ()
    """What reading and audit of the logs remarked, a sentence each."""
    effect_kinds: tuple[str, ...] = ()
    """Kind of residual that each of the effects was fitted to; empty if there is one kind."""
    is_base_only: bool = False
    """True if no effect was looked for."""
    start: tuple[tuple[float, ...], ...] = ()
    """Sizes with which the diagnosis started, from an earlier result; empty if it started from the model."""
    rivals: tuple[Rival, ...] = ()
    """For each finding, models that may be the cause instead, which `simgap next` tells apart; empty after a
    start from an earlier result."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of residual that were used."""
        return tuple(self.kind.split(" and "))

    def fitted_to(
        self, kind: str, is_reference: bool = False
    ) -> tuple[tuple[Effect, ...], tuple[tuple[float, ...], ...]]:
        """Return the effects that were fitted to a kind of residual, and their sizes, or those before."""
        kinds = self.effect_kinds or (self.kind,) * len(self.effects)
        own = [k for k, one in enumerate(kinds) if one == kind]
        sizes = self.reference if is_reference else self.sizes
        return tuple(self.effects[k] for k in own), tuple(sizes[k] for k in own)

    @property
    def reference(self) -> tuple[tuple[float, ...], ...]:
        """Sizes of the effects in the model that errors and findings count from; zeros without a start."""
        return self.start or tuple(tuple(0.0 for _ in size) for size in self.sizes)

    def of_model(self) -> tuple[tuple[Effect, ...], tuple[tuple[float, ...], ...]]:
        """Return the effects that change the model, each once, and their sizes.

        What a second encoder reads wrongly is no part of the model: it has one encoder a joint. Nor is what
        follows a condition: the model is that of the robot file, where such an effect is absent.
        """
        chosen: dict[str, tuple[Effect, tuple[float, ...]]] = {}
        for kind in self.kinds:
            for effect, size in zip(*self.fitted_to(kind), strict=True):
                is_reading = kind == SECOND_ENCODER and effect.overrides(*READING_HOOKS)
                if not (is_reading or isinstance(effect, Variation)):
                    chosen.setdefault(effect.key, (effect, size))
        return tuple(one for one, _ in chosen.values()), tuple(size for _, size in chosen.values())

    @property
    def closure(self) -> float | None:
        """Share of the explainable energy of held-out motions that is gone with base and findings.

        Energies are squared mean errors less that of noise, each joint in units of its noise floor. None if
        no motion was held out, if the floor of a joint is unknown, or if no error is above the floor.
        """
        if not (self.judged_motions and self.errors) or not all(one.noise_floor > 0 for one in self.errors):
            return None
        before = sum((one.nominal / one.noise_floor) ** 2 - 1.0 for one in self.errors)
        after = sum((one.explained / one.noise_floor) ** 2 - 1.0 for one in self.errors)
        return 1.0 - after / before if before > 0.0 else None

    def patch(self, robot: Robot, folder: str | Path) -> tuple[Path, ...]:
        """Write the patched model and the runtime file, and return the paths; see `simgap.patch`."""
        from simgap.patch.patch import save_patch

        return save_patch(robot, self, Path(folder))

    def report(self, path: str | Path, robot: Robot, motions: Sequence[Motion] = ()) -> None:
        """Write the page, with interactive traces of these motions; see `simgap.report`."""
        from simgap.report.page import save_diagnosis_page
        from simgap.report.traces import convert_trace, trace_motions

        traces = [convert_trace(robot, one) for one in trace_motions(robot, motions, self)]
        save_diagnosis_page(self, traces, Path(path))


@dataclass(frozen=True, slots=True)
class Limit:
    """Change of a base parameter that these logs cannot exclude."""

    place: str
    name: str
    low: float
    """Ends of its 90 % interval, where all base parameters of the joint may change."""
    high: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Changes between two sets of logs, and limits of those that were not seen."""

    found: Diagnosis
    """Its findings are changes; its errors are those with one model for both, and with the changes."""
    limits: tuple[Limit, ...]
