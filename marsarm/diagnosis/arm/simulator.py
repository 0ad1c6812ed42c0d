"""Arm simulator for the diagnosis: predicts features with effects of the catalogue and with nuisances."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.arm_effects import family_of, locate
from marsarm.diagnosis.arm.feature_set import FeatureSet, every_motion, simulate_features
from marsarm.diagnosis.arm.features import CONDITIONS, UNITS, MotionFeatures
from marsarm.diagnosis.problem import LOG_UNIT, FeatureLayout, Hypothesis, Parameter
from sim.effects import catalogue
from sim.effects.catalogue import effect_name, effect_place_text
from sim.effects.effect import EachMove, Effect
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
    options: SimulationOptions = SHORT_SETTLING
    patch: tuple[Effect, ...] = ()
    """Effects that are always on."""

    def predict_effects(
        self, effects: Sequence[Effect], wanted: Callable[[MotionFeatures], bool] = every_motion
    ) -> Array:
        """Predict the features (m,) with the patch and these effects; NaN for motions not wanted.

        PlantDiverged if MuJoCo counted a warning.
        """
        return simulate_features(self.feature_set, (*self.patch, *effects), self.options, wanted)


def moves(effect: Effect, one: MotionFeatures) -> bool:
    """Check that an effect can influence a motion: at a joint if it moves, geometry never."""
    if isinstance(effect, (HardstopStiffness, *REST_ONLY_EFFECTS)):
        return False  # no motion of a campaign reaches a hardstop
    joint = getattr(effect, "joint", None)
    return joint is None or any(segment.joint is Joint(joint) for segment in one.segments)


def list_hypotheses(
    names: Sequence[str] | None = None, tools: Sequence[str] | None = None
) -> Iterator[Hypothesis]:
    """Yield the candidate causes of these names at an arm with these tools.

    None for all of the catalogue, and for the tools of the default arm.

    They are those of the catalogue, but no disturbance of single moves, and nothing that logs record.

    An offset of the sensor of the structure looks like warming of the arm.
    """
    recorded = (EachMove, Ambient, StructureTemperature, StructureSensor)
    kinds = catalogue.catalogue()
    every = catalogue.hypotheses(kinds if names is None else {name: kinds[name] for name in names}, tools)
    return (to_hypothesis(one, family_of(one.kind)) for one in every if not issubclass(one.kind, recorded))


def to_hypothesis(one: catalogue.EffectHypothesis, family: StrEnum) -> Hypothesis:
    """Convert an entry of the catalogue to a hypothesis; arrays keep their defaults.

    A factor with neutral value 1 is given by its logarithm, which makes it symmetric.
    """
    effect, place = effect_name(one.kind), effect_place_text(one.kind, dict(one.place)) or "arm"
    return Hypothesis(effect, place, tuple(_list_parameters(one)), family, locate(effect, place), one)


def _list_parameters(one: catalogue.EffectHypothesis) -> Iterator[Parameter]:
    for parameter in one.amplitudes:
        size = parameter.spec
        if size is None or size.neutral is None or parameter.count != 1:
            continue
        if size.neutral == 1.0 and size.low > 0.0:
            ends = float(np.log(size.low)), float(np.log(size.high))
            yield Parameter(parameter.field, LOG_UNIT, *ends, float(np.log1p(size.typical)), 0.0)
        else:
            yield Parameter(parameter.field, size.unit, size.low, size.high, size.typical, size.neutral)


def build_layout(feature_set: FeatureSet, sigma: Array) -> FeatureLayout:
    """Describe the features; every place has its own channels.

    Args:
        sigma: Noise floor in the units of the channels, shape (m,).
    """
    features = feature_set.list_features()
    return FeatureLayout(
        sigma=sigma,
        block=np.array([one.block for one in features], str),
        channel=np.array([one.channel_name for one in features], str),
        unit=np.array([UNITS[one.channel] for one in features], str),
        regime=np.array([one.regime for one in features], str),
        condition=np.array([one.condition for one in features]).reshape(-1, len(CONDITIONS)),
        key=np.array([f"{one.recording.name}/{one.key}" for one in features], str),
        conditions=np.array(CONDITIONS),
    )
