"""The arm's simulator as the diagnosis asks it: the catalogue's effects, and what is uncertain anyway."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from ground.diagnosis.arm.feature_set import FeatureSet, every_motion, simulate_features
from ground.diagnosis.arm.features import CONDITIONS, UNITS, MotionFeatures, feature_channel
from ground.diagnosis.arm.nuisances import NuisanceEffect, list_nuisance_effects
from ground.diagnosis.problem import (
    LOG_UNIT,
    EffectValues,
    FeatureLayout,
    Hypothesis,
    Ints,
    Nuisance,
    Parameter,
)
from sim.effects import catalogue
from sim.effects.catalogue import effect_name, effect_place_text
from sim.effects.effect import EachMove, Effect, ParameterSpec
from sim.effects.environment import Ambient, ContactStiffness, SurfacePosition
from sim.effects.geometry import FrameError, LinkWarming, Warming
from sim.effects.joints import HardstopStiffness
from sim.effects.links import LinkAngle, LinkLength, ThermalGradient, ToolOffset, ToolTurn
from sim.effects.structure import LinkBending, LinkStiffness, LinkTorsion, RoverCompliance
from sim.open_loop import SimulationOptions

SHORT_SETTLING: Final = SimulationOptions(settle_s=4.0)
"""The arm settles before a recording for less long than in the closed loop: enough for differences."""
LONG_SETTLING: Final = SimulationOptions(settle_s=8.0)
"""Long enough for what a case is compared with."""
REST_ONLY_EFFECTS: Final = (
    *(LinkLength, LinkAngle, ThermalGradient, LinkWarming, Warming, FrameError, ToolOffset, ToolTurn),
    *(LinkStiffness, LinkBending, LinkTorsion, RoverCompliance, ContactStiffness, SurfacePosition),
)
"""Effects that show where the arm rests, or not at all; in free motion they are below its noise."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmSimulator:
    """Ours, bound to a campaign (ground.diagnosis.problem.Simulator): the drawing, and what is switched on.

    Whatever flight parameters know of the arm, the simulator is told by effects alone.
    """

    feature_set: FeatureSet
    layout: FeatureLayout
    """Its m features, with their floor."""
    catalogue_entry: Mapping[Hypothesis, catalogue.EffectHypothesis]
    """What each hypothesis switches on."""
    nuisance_effects: tuple[NuisanceEffect, ...]
    options: SimulationOptions
    patch: tuple[Effect, ...]
    """Always on."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """What may be the cause."""
        return tuple(self.catalogue_entry)

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """What is uncertain, as the diagnosis knows it."""
        return tuple(one.nuisance for one in self.nuisance_effects)

    def with_patch(self, patch: tuple[Effect, ...]) -> "ArmSimulator":
        """The same with another patch."""
        return replace(self, patch=patch)

    def predict(self, settings: EffectValues, nuisance: Array) -> Array:
        """The features (m,); errors as of `simulate_features`."""
        return self.predict_effects(self.effects(settings, nuisance))

    def effects(self, settings: EffectValues, nuisance: Array) -> list[Effect]:
        """What is switched on beside the patch: hypotheses, and nuisances that are not 0."""
        found = [make_effect(self.catalogue_entry[one], one, values) for one, values in settings.items()]
        found += [one.effect(float(v)) for one, v in zip(self.nuisance_effects, nuisance, strict=True) if v]
        return found

    def predict_effects(
        self, effects: Sequence[Effect], wanted: Callable[[MotionFeatures], bool] = every_motion
    ) -> Array:
        """Features (m,) with the patch and these; those of moving recordings that are not wanted are NaN."""
        return simulate_features(self.feature_set, (*self.patch, *effects), self.options, wanted)


def build_simulator(
    feature_set: FeatureSet,
    sigma: Array,
    kinds: Mapping[str, type[Effect]] | None = None,
    options: SimulationOptions = SHORT_SETTLING,
    patch: tuple[Effect, ...] = (),
) -> ArmSimulator:
    """With a floor (m,); `kinds` are hypotheses, by default the catalogue's."""
    made = {to_hypothesis(one): one for one in list_candidates(kinds)}
    return ArmSimulator(
        feature_set, build_layout(feature_set, sigma), made, tuple(list_nuisance_effects()), options, patch
    )


@dataclass(frozen=True, slots=True)
class AffectedMotions:
    """Whether effects can show in a moving recording: at a joint if it moves, of geometry never."""

    effects: tuple[Effect, ...]

    def __call__(self, one: MotionFeatures) -> bool:
        """Any of them."""
        return any(self._shows(effect, one) for effect in self.effects)

    def _shows(self, effect: Effect, one: MotionFeatures) -> bool:
        if isinstance(effect, (HardstopStiffness, *REST_ONLY_EFFECTS)):
            return False  # no motion of a campaign comes to a hardstop
        joint = getattr(effect, "joint", None)
        return joint is None or any(segment.joint is Joint(joint) for segment in one.segments)


def list_candidates(kinds: Mapping[str, type[Effect]] | None) -> Iterator[catalogue.EffectHypothesis]:
    """The catalogue's hypotheses that may be a cause: no chance from move to move, nor what logs tell."""
    return (one for one in catalogue.hypotheses(kinds) if not issubclass(one.kind, (EachMove, Ambient)))


def to_hypothesis(one: catalogue.EffectHypothesis) -> Hypothesis:
    """In the words of the diagnosis; parameters that are many numbers stay as they are by default.

    Of a factor that is one where nothing is changed, it is told the logarithm: there it is symmetric.
    """
    parameters = [p for p in (*one.amplitudes, *one.shape_parameters) if p.spec is not None and p.count == 1]
    return Hypothesis(
        effect_name(one.kind),
        effect_place_text(one.kind, dict(one.place)) or "arm",
        tuple(_to_parameter(p, p.spec) for p in parameters if p.spec is not None),
    )


def is_factor(size: ParameterSpec) -> bool:
    """Whether it multiplies something, and cannot be 0."""
    return size.neutral == 1.0 and size.low > 0.0


def _to_parameter(parameter: catalogue.ParameterField, size: ParameterSpec) -> Parameter:
    if is_factor(size):
        ends = float(np.log(size.low)), float(np.log(size.high))
        return Parameter(parameter.field, LOG_UNIT, *ends, float(np.log1p(size.typical)), 0.0)
    typical = float(parameter.default) if size.neutral is None else size.typical
    return Parameter(parameter.field, size.unit, size.low, size.high, typical, size.neutral)


def make_effect(made: catalogue.EffectHypothesis, hypothesis: Hypothesis, values: Array) -> Effect:
    """The effect that a hypothesis, as told, is with these values of its parameters."""
    named = zip(hypothesis.parameters, values, strict=True)
    return made.effect(**{p.name: _effect_value(made, p.name, float(v)) for p, v in named})


def build_layout(feature_set: FeatureSet, sigma: Array) -> FeatureLayout:
    """What the features are; each place has channels of its own."""
    features = feature_set.features
    named = [feature_channel(feature) for feature in features]
    blocks, places, regimes = (
        tuple(dict.fromkeys(getattr(f, name) for f in features)) for name in ("block", "place", "regime")
    )
    units = {name: UNITS[f.channel] for name, f in zip(named, features, strict=True)}
    return FeatureLayout(
        sigma=sigma,
        block=_name_indices(blocks, [f.block for f in features]),
        channel=_name_indices(tuple(units), named),
        place=_name_indices(places, [f.place for f in features]),
        regime=_name_indices(regimes, [f.regime for f in features]),
        condition=np.array([f.condition for f in features]).reshape(-1, len(CONDITIONS)),
        blocks=blocks,
        channels=tuple(units),
        units=tuple(units.values()),
        places=places,
        regimes=regimes,
        conditions=CONDITIONS,
    )


def _name_indices(names: tuple[str, ...], of: list[str]) -> Ints:
    number = {name: k for k, name in enumerate(names)}
    return np.array([number[name] for name in of], np.intp)


def _effect_value(made: catalogue.EffectHypothesis, field: str, value: float) -> float:
    """As the effect has it: a factor for a logarithm, a whole number where it has one."""
    parameter = next(p for p in (*made.amplitudes, *made.shape_parameters) if p.field == field)
    if parameter.spec is not None and is_factor(parameter.spec):
        return float(np.exp(value))
    whole = isinstance(parameter.default, int) and not isinstance(parameter.default, bool)
    return round(value) if whole else value
