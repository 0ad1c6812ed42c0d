"""Arm simulator for the diagnosis: predicts features with effects of the catalogue and with nuisances."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.arm_effects import NuisanceEffect, list_nuisance_effects
from marsarm.diagnosis.arm.feature_set import FeatureSet, every_motion, simulate_features
from marsarm.diagnosis.arm.features import CONDITIONS, UNITS, MotionFeatures, feature_channel
from marsarm.diagnosis.problem import (
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
from sim.effects.environment import Ambient, ContactStiffness, StructureTemperature, SurfacePosition
from sim.effects.geometry import (
    Expansion,
    FrameError,
    LinkAngle,
    LinkLength,
    LinkWarming,
    ThermalGradient,
    ToolOffset,
    ToolTurn,
    Warming,
)
from sim.effects.joints import HardstopStiffness
from sim.effects.sensors import StructureSensor
from sim.effects.structure import LinkBending, LinkCreep, LinkStiffness, LinkTorsion, RoverCompliance
from sim.loop import SimulationOptions

SHORT_SETTLING: Final = SimulationOptions(settle_s=4.0)
"""Settling time before a recording, shorter than in the closed loop: sufficient for differences."""
LONG_SETTLING: Final = SimulationOptions(settle_s=8.0)
"""Settling time that suffices for comparison with a case."""
REST_ONLY_EFFECTS: Final = (
    *(LinkLength, LinkAngle, ThermalGradient, FrameError, ToolOffset, ToolTurn),
    *(Expansion, LinkWarming, Warming),
    *(LinkStiffness, LinkBending, LinkCreep, LinkTorsion, RoverCompliance),
    *(ContactStiffness, SurfacePosition),
)
"""Effects that influence rests or nothing; their change of motions is below the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmSimulator:
    """Arm simulator bound to a campaign.

    It uses the nominal arm. Flight parameters do not change it, only effects do.
    """

    feature_set: FeatureSet
    layout: FeatureLayout
    """Layout of its m features, with their noise floor."""
    catalogue_entry: Mapping[Hypothesis, catalogue.EffectHypothesis]
    """Entry of the catalogue for each hypothesis."""
    nuisance_effects: tuple[NuisanceEffect, ...]
    options: SimulationOptions
    patch: tuple[Effect, ...]
    """Effects that are always on."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Candidate causes."""
        return tuple(self.catalogue_entry)

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters in the form of the diagnosis."""
        return tuple(one.nuisance for one in self.nuisance_effects)

    def with_patch(self, patch: tuple[Effect, ...]) -> "ArmSimulator":
        """Return the simulator with another patch."""
        return replace(self, patch=patch)

    def effects(self, settings: EffectValues, nuisance: Array | None = None) -> list[Effect]:
        """Create the effects beside the patch: of hypotheses, and of nuisances that are not 0.

        Args:
            nuisance: Departures from nominal in the units of the nuisances, shape (q,); None for none.
        """
        found = [make_effect(self.catalogue_entry[one], one, values) for one, values in settings.items()]
        if nuisance is None:
            return found
        pairs = zip(self.nuisance_effects, nuisance, strict=True)
        return [*found, *(one.effect(float(v)) for one, v in pairs if v)]

    def predict_effects(
        self, effects: Sequence[Effect], wanted: Callable[[MotionFeatures], bool] = every_motion
    ) -> Array:
        """Predict the features with the patch and these effects.

        Args:
            effects: Effects that are switched on beside the patch.

        Returns:
            Features in the units of their channels, shape (m,); NaN for motions that are not wanted.

        Raises:
            PlantDiverged: MuJoCo counted a warning.
        """
        return simulate_features(self.feature_set, (*self.patch, *effects), self.options, wanted)


def build_simulator(
    feature_set: FeatureSet,
    sigma: Array,
    kinds: Mapping[str, type[Effect]] | None = None,
    options: SimulationOptions = SHORT_SETTLING,
    patch: tuple[Effect, ...] = (),
) -> ArmSimulator:
    """Build the simulator of a campaign.

    Args:
        sigma: Noise floor in the units of the channels, shape (m,).
        kinds: Classes of the candidate effects by name; None for the catalogue.
        patch: Effects that are always on.

    Returns:
        Simulator with all candidate effects and nuisances.
    """
    entries = {to_hypothesis(one): one for one in list_candidates(kinds)}
    return ArmSimulator(
        feature_set, build_layout(feature_set, sigma), entries, tuple(list_nuisance_effects()), options, patch
    )


@dataclass(frozen=True, slots=True)
class AffectedMotions:
    """Predicate of the motions that effects can influence: at a joint if it moves, geometry never."""

    effects: tuple[Effect, ...]

    def __call__(self, one: MotionFeatures) -> bool:
        """Check that any of the effects influences the motion."""
        return any(self._shows(effect, one) for effect in self.effects)

    def _shows(self, effect: Effect, one: MotionFeatures) -> bool:
        if isinstance(effect, (HardstopStiffness, *REST_ONLY_EFFECTS)):
            return False  # no motion of a campaign reaches a hardstop
        joint = getattr(effect, "joint", None)
        return joint is None or any(segment.joint is Joint(joint) for segment in one.segments)


def list_candidates(kinds: Mapping[str, type[Effect]] | None) -> Iterator[catalogue.EffectHypothesis]:
    """Yield the candidate causes of the catalogue: no per-move disturbance, and nothing that logs record.

    An offset of the sensor of the structure looks like warming of the arm.
    """
    recorded = (EachMove, Ambient, StructureTemperature, StructureSensor)
    return (one for one in catalogue.hypotheses(kinds) if not issubclass(one.kind, recorded))


def to_hypothesis(one: catalogue.EffectHypothesis) -> Hypothesis:
    """Convert an entry of the catalogue to a hypothesis; array parameters keep their defaults.

    A factor with neutral value 1 is given by its logarithm, which makes it symmetric.
    """
    parameters = [p for p in (*one.amplitudes, *one.shape_parameters) if p.spec is not None and p.count == 1]
    return Hypothesis(
        effect_name(one.kind),
        effect_place_text(one.kind, dict(one.place)) or "arm",
        tuple(_to_parameter(p, p.spec) for p in parameters if p.spec is not None),
    )


def is_factor(size: ParameterSpec) -> bool:
    """Check that a parameter multiplies something and cannot be 0."""
    return size.neutral == 1.0 and size.low > 0.0


def _to_parameter(parameter: catalogue.ParameterField, size: ParameterSpec) -> Parameter:
    if is_factor(size):
        ends = float(np.log(size.low)), float(np.log(size.high))
        return Parameter(parameter.field, LOG_UNIT, *ends, float(np.log1p(size.typical)), 0.0)
    typical = float(parameter.default) if size.neutral is None else size.typical
    return Parameter(parameter.field, size.unit, size.low, size.high, typical, size.neutral)


def make_effect(made: catalogue.EffectHypothesis, hypothesis: Hypothesis, values: Array) -> Effect:
    """Create the effect of a hypothesis.

    Args:
        hypothesis: Hypothesis with p parameters.
        values: Values of the parameters in the units of the diagnosis, shape (p,).

    Returns:
        Effect with these values.
    """
    named = zip(hypothesis.parameters, values, strict=True)
    return made.effect(**{p.name: _effect_value(made, p.name, float(v)) for p, v in named})


def catalogue_effect(key: str, amplitudes: Array) -> Effect:
    """Create an effect of the catalogue.

    Args:
        key: Key of its hypothesis.
        amplitudes: Values of the amplitude parameters in the units of the diagnosis, shape (n,).
    """
    made = next(one for one in list_candidates(None) if to_hypothesis(one).key == key)
    hypothesis = to_hypothesis(made)
    return make_effect(made, hypothesis, hypothesis.fill(amplitudes))


def build_layout(feature_set: FeatureSet, sigma: Array) -> FeatureLayout:
    """Describe the features; every place has its own channels.

    Args:
        sigma: Noise floor in the units of the channels, shape (m,).

    Returns:
        Layout of the m features.
    """
    features = feature_set.list_features()
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
        keys=tuple(f"{s}/{f.key}" for s, f in zip(feature_set.list_sessions(), features, strict=True)),
    )


def _name_indices(names: tuple[str, ...], of: list[str]) -> Ints:
    number = {name: k for k, name in enumerate(names)}
    return np.array([number[name] for name in of], np.intp)


def _effect_value(made: catalogue.EffectHypothesis, field: str, value: float) -> float:
    """Convert a value to the effect's own: a factor for a logarithm, an integer where it has one."""
    parameter = next(p for p in (*made.amplitudes, *made.shape_parameters) if p.field == field)
    if parameter.spec is not None and is_factor(parameter.spec):
        return float(np.exp(value))
    whole = isinstance(parameter.default, int) and not isinstance(parameter.default, bool)
    return round(value) if whole else value
