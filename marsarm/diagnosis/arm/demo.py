"""Demonstration of the diagnosis: an effect is drawn and sealed, recorded, diagnosed, and then compared.

The arm is one that a solver does not know: with a random effect of detectable size, and a background.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array
from marsarm.common.pool import select_runner
from marsarm.common.requests import NOMINAL_ARM
from marsarm.diagnosis.arm.audit import load_checked_recordings
from marsarm.diagnosis.arm.campaign_sensitivities import campaign_digest, check_cache_folder
from marsarm.diagnosis.arm.case import CampaignModel, CaseDiagnosis, diagnose_case, load_campaign_model
from marsarm.diagnosis.arm.record import HELD_OUT_FOLDER, record_campaign, record_logs, split_logs
from marsarm.diagnosis.arm.request import DemoRequest, RecordRequest
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.problem import BOUND_SHARE, Hypothesis
from sim.arms import BuiltArm, arm_named, effects_of_run
from sim.diagnosis_campaign import DiagnosisSession, campaign_sessions
from sim.effects.effect import Effect
from sim.effects.environment import Numerics
from sim.effects.joints import GearFriction
from sim.effects.sensors import CounterStart
from sim.initialisation import DAILY_FRICTION_SIGMA, true_reference
from sim.scenario.effects import effect_text
from sim.tolerances import draw_calibration_errors
from simgap import Diagnosis, Finding, to_document
from simgap.common.errors import BadRequest
from simgap.common.files import cache_folder, json_sha256
from simgap.common.options import check_options
from simgap.common.progress import Progress, as_guess, no_progress, part_of
from simgap.report.sentences import level

PLANT_NUMERICS: Final = Numerics("explicit", 7)
"""Numerics of the plant: finer than the solver's, and of a scheme that the solver does not know. With steps
that are not much finer, this scheme nearly diverges, and gears settle elsewhere than with finer steps."""
LIMIT_MULTIPLES: Final = (0.5, 4.0)
"""Range of the sampled amplitudes, in detection limits."""


@dataclass(frozen=True, slots=True)
class DetectableEffect:
    """Effect with its detection limit in typical sizes and its class; None for an out-of-catalogue effect."""

    hypothesis: Hypothesis
    limit: float
    label: int | None

    def can_sample(self, multiples: tuple[float, float] = LIMIT_MULTIPLES) -> bool:
        """Check that the campaign detects the effect and that its bounds allow the smallest amplitude."""
        return bool(np.isfinite(self.limit)) and max(self._rooms()) >= multiples[0] * self.limit

    def sample(
        self, rng: np.random.Generator, multiples: tuple[float, float] = LIMIT_MULTIPLES
    ) -> "SampledEffect":
        """Sample an amplitude within multiples of the detection limit, log-uniformly, with a random sign.

        It stays within the bounds. All parameters depart from neutral by the same number of typical sizes.
        """
        times = float(np.exp(rng.uniform(*np.log(multiples))))
        sign, rooms = int(rng.choice((-1, 1))), self._rooms()
        if rooms[sign > 0] < multiples[0] * self.limit:
            sign = -sign
        typical = min(times * self.limit, rooms[sign > 0])
        departures = np.full(len(self.hypothesis.parameters), sign * typical)
        return SampledEffect(self, departures, typical / self.limit)

    def _rooms(self) -> tuple[float, float]:
        """Return how many typical sizes all amplitudes together may depart down and up."""
        least, most = self.hypothesis.common_range
        return -BOUND_SHARE * least, BOUND_SHARE * most


@dataclass(frozen=True, slots=True, eq=False)
class SampledEffect:
    """Sampled effect: its departures in typical sizes, shape (n,), and its amplitude in detection limits."""

    source: DetectableEffect
    departures: Array
    times_limit: float

    def switch_on(self) -> Effect:
        """Return the effect of the plant."""
        return self.source.hypothesis.switch_on(self.departures)


def sample_effect(some: Sequence[DetectableEffect], rng: np.random.Generator) -> DetectableEffect:
    """Sample an effect uniformly, then one of its places: many places do not make it more frequent."""
    names = sorted({one.hypothesis.name for one in some})
    name = names[int(rng.integers(len(names)))]
    places = [one for one in some if one.hypothesis.name == name]
    return places[int(rng.integers(len(places)))]


def list_detectable(model: DiagnosisModel, limits: Array) -> list[DetectableEffect]:
    """List the hypotheses of a model with their equivalence classes.

    Args:
        limits: Detection limits, without a unit (typical sizes), shape (h,).
    """
    rows = zip(model.sensitivities.hypotheses, limits.tolist(), model.label.tolist(), strict=True)
    return [DetectableEffect(*row) for row in rows]


def sample_background(rng: np.random.Generator, arm: str = NOMINAL_ARM) -> tuple[Effect, ...]:
    """Sample what a calibration of an arm leaves, friction of the day, counter offsets, other numerics."""
    errors = draw_calibration_errors(arm_named(arm).model, int(rng.integers(2**31)))
    friction = tuple(
        GearFriction(joint, float(np.exp(DAILY_FRICTION_SIGMA * rng.standard_normal()))) for joint in Joint
    )
    counters = tuple(CounterStart(joint, float(rng.uniform(-np.pi, np.pi))) for joint in Joint)
    return (PLANT_NUMERICS, *counters, *errors, *friction)


def record_blind(
    folder: Path,
    effects: tuple[Effect, ...],
    sessions: Sequence[DiagnosisSession],
    seed: int,
    progress: Progress,
    arm: str = NOMINAL_ARM,
) -> bool:
    """Record sessions of an arm with effects in a folder; return whether every motion completed."""
    built = arm_named(arm).with_effects(effects)
    reference, begun = blind_reference(built, arm), effects_of_run(effects)
    numbers = np.random.default_rng(seed).integers(2**31, size=len(sessions))
    made = []
    for done, (session, number) in enumerate(zip(sessions, numbers, strict=True)):
        progress(done, len(sessions), "recording")
        made += record_campaign(folder, [session], built, reference, int(number), no_progress, begun)
    return len(made) == len(sessions)


def blind_reference(built: BuiltArm, arm: str) -> Reference:
    """Return the joint zeros that homing of a built arm finds; all else is that of the named one."""
    return replace(nominal_reference(arm), zero_rad=true_reference(built).zero_rad)


@cache
def nominal_reference(arm: str = NOMINAL_ARM) -> Reference:
    """Return the homing result of a named arm; computed once in each process."""
    return true_reference(arm_named(arm))


Kind = Literal["none", "known", "left out"]
KINDS: Final[tuple[tuple[Kind, float], ...]] = (("none", 0.1), ("known", 0.65), ("left out", 0.25))
"""What is drawn, with its probability; an effect that is left out is one that the catalogue then lacks."""
SIZES: Final = (1.0, 4.0)
"""Range of the drawn sizes, in detection limits of the selection from all hypotheses."""
MAX_DRAWS: Final = 20
"""Most draws until the arm can complete its sessions; one in twenty effects stops it."""
SENSITIVITIES_BEGIN: Final = 0.07
RECORDING_BEGINS: Final = 0.8
DIAGNOSIS_BEGINS: Final = 0.95
"""Shares of a demonstration's time, for the progress: of 340 s on one core, the campaign is recorded in some
20 s, its sensitivities take 270 s, the recording of the arm 25 s and the diagnosis the rest."""


@dataclass(frozen=True, slots=True)
class DemoTruth:
    """Drawn truth; the salt prevents that a guessed effect is confirmed by the digest without the seed."""

    salt: str
    kind: Kind
    effect: str
    """Name of the effect; "" for none."""
    place: str
    spec: str
    """Text that switches it on."""
    times_limit: float
    """Size over the detection limit of the selection."""
    background: tuple[str, ...]
    """Calibration errors, friction of the day and numerics of the arm."""

    def digest(self) -> str:
        """Return the SHA-256 of the truth."""
        return json_sha256(asdict(self))


@dataclass(frozen=True, slots=True)
class Demo:
    """Result of a demonstration."""

    truth: DemoTruth
    case: CaseDiagnosis
    is_right: bool
    reason: str
    """Why it is right or wrong, as a sentence."""


def run_demo(request: DemoRequest, progress: Progress, publish: Callable[[str], None]) -> Demo:
    """Draw an effect, record an arm with it, publish the digest, diagnose the logs, and compare.

    BadRequest if the request is wrong, or the cache cannot be written.
    """
    check_options(request)
    progress = as_guess(progress)
    campaign = load_demo_campaign(request, progress)
    with TemporaryDirectory() as name:
        recording = part_of(progress, RECORDING_BEGINS, DIAGNOSIS_BEGINS)
        truth = _record_drawn(Path(name), campaign.model, request.seed, recording)
        publish(truth.digest())
        progress(DIAGNOSIS_BEGINS, 1.0, "diagnosing")
        left_out = truth.effect if truth.kind == "left out" else ""
        case = diagnose_blind(Path(name), campaign, request.seed, left_out)
    return Demo(truth, case, *judge(truth, campaign.model, case.diagnosis))


def demo_json(found: Demo) -> dict[str, Any]:
    """Return the document of a demonstration."""
    truth = {**asdict(found.truth), "sha256": found.truth.digest()}
    right = {"is_right": found.is_right, "reason": found.reason}
    return {**right, "truth": truth, "diagnosis": to_document(found.case.diagnosis)}


def load_demo_campaign(request: DemoRequest, progress: Progress) -> CampaignModel:
    """Load the campaign of the nominal arm; record and compute what is not cached.

    Of two demonstrations that record it at once, one takes the logs of the other, which are the same.
    """
    folder = cache_folder("marsarm", "gap-demo") / campaign_digest((), (), NOMINAL_ARM)[:16]
    if not any(folder.glob("*.mcap")):
        check_cache_folder(folder.parent)
        try:
            record_logs(RecordRequest(folder), part_of(progress, 0.0, SENSITIVITIES_BEGIN))
        except BadRequest:
            if not any(folder.glob("*.mcap")):
                raise
    logs, held_out = (sorted(of.glob("*.mcap")) for of in (folder, folder / HELD_OUT_FOLDER))
    run = select_runner(request.workers, None)
    sensitivities = part_of(progress, SENSITIVITIES_BEGIN, RECORDING_BEGINS)
    return load_campaign_model(logs, held_out, folder, run, sensitivities)


def _record_drawn(folder: Path, model: DiagnosisModel, seed: int, progress: Progress) -> DemoTruth:
    """Draw until the arm can complete its sessions; return what was drawn then."""
    for attempt in range(MAX_DRAWS):
        rng = np.random.default_rng([seed, attempt, 12])
        truth, effects = draw_truth(model, rng)
        sessions = campaign_sessions(arm_named("nominal").params)
        if record_blind(folder, effects, sessions, int(rng.integers(2**31)), progress):
            return truth
    raise BadRequest(
        f"seed: {seed} draws {MAX_DRAWS} effects with which the arm cannot complete its sessions"
    )


def draw_truth(model: DiagnosisModel, rng: np.random.Generator) -> tuple[DemoTruth, tuple[Effect, ...]]:
    """Draw what is on in the arm; return the truth, and all effects of the arm."""
    kinds, shares = zip(*KINDS, strict=True)
    kind: Kind = kinds[int(rng.choice(len(kinds), p=shares))]
    background, salt = sample_background(rng), rng.bytes(16).hex()
    texts = tuple(effect_text(effect) for effect in background)
    if kind == "none":
        return DemoTruth(salt, kind, "", "", "", 0.0, texts), background
    seen = [one for one in list_detectable(model, model.family_wise_limits) if one.can_sample(SIZES)]
    drawn = sample_effect(seen, rng).sample(rng, SIZES)
    one, effect = drawn.source.hypothesis, drawn.switch_on()
    truth = DemoTruth(salt, kind, one.name, one.place, effect_text(effect), drawn.times_limit, texts)
    return truth, (*background, effect)


def diagnose_blind(
    folder: Path, campaign: CampaignModel, seed: int, left_out: str = "", arm: str = NOMINAL_ARM
) -> CaseDiagnosis:
    """Diagnose the logs of an arm in a folder, with a catalogue that lacks one effect if named.

    NotForDiagnosis if a log cannot be compared or most motions are missing, PlantDiverged if a simulated
    arm broke.
    """
    drawing = arm_named(arm).model
    fitted, held_out = (load_checked_recordings(logs, drawing.params, drawing) for logs in split_logs(folder))
    lacking = replace(campaign.model, left_out_effect=left_out)
    return diagnose_case(fitted, held_out, replace(campaign, model=lacking), seed)


def judge(truth: DemoTruth, model: DiagnosisModel, diagnosis: Diagnosis) -> tuple[bool, str]:
    """Say whether a diagnosis is right, level by level, and why."""
    findings = diagnosis.findings
    is_none = not findings and not diagnosis.remaining
    if truth.kind == "none":
        return is_none, "nothing was on" if is_none else "nothing was on, but something was reported"
    alike = model.equivalence_class(model.sensitivities.index(f"{truth.place}: {truth.effect}"))
    right = [one for one in findings if holds(model, one, alike)]
    named = [one for one in findings if level(one) == "effect"]
    if truth.kind == "left out":
        located = [one for one in findings if level(one) != "none"]
        places = {model.sensitivities.hypotheses[k].location for k in alike}
        for is_wrong, what in (
            (named, "another was named"),
            (is_none, "nothing was reported"),
            (not all(places & {*one.places} for one in located), "a wrong place was reported"),
        ):
            if is_wrong:
                return False, f"the catalogue lacked the effect, and {what}"
        return True, "the catalogue lacked the effect, and no other was named"
    if not right:
        return False, "the effect is in no set that was reported" if findings else "the effect was not found"
    if any(one not in right for one in named):
        return False, "the effect was found, but another was named beside it"
    if level(right[0]) == "none":
        return True, "something was reported, and no place for it"
    return True, f"the {level(right[0])} was reported"


def holds(model: DiagnosisModel, finding: Finding, alike: Sequence[int]) -> bool:
    """Check that the set of a finding, at its level, holds one of some hypotheses."""
    known, same = level(finding), [model.sensitivities.hypotheses[k] for k in alike]
    if known == "effect":
        return any(one.key in finding.effects for one in same)
    is_family = known != "family" or any(one.family in finding.families for one in same)
    return is_family and any(one.location in finding.places for one in same)
