"""The arm's simulator as the diagnosis asks it: the catalogue's effects, and what calibration leaves."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from fsw.dictionary.joints import Frame, Joint, Tool
from fsw.dictionary.params import Params
from fsw.dictionary.tuples import row6
from fsw.kinematics.transforms import Array
from ground.gap.arm.campaign import Compared, predicted_values
from ground.gap.arm.features import CONDITIONS, UNITS, Moving, channel_of
from ground.gap.hypothesis import Hypothesis, Nuisance, Parameter
from ground.gap.layout import Ints, Layout
from ground.gap.simulator import Settings
from sim.driven import Manner
from sim.effects import catalogue
from sim.effects import describe as described
from sim.effects.built import (
    IDENTIFIABLE,
    LEFT_FRAME_M,
    LEFT_FRAME_RAD,
    LEFT_STIFFNESS,
    LEFT_ZERO_RAD,
    SPRINGS,
)
from sim.effects.contacts import ContactStiffness, SurfacePosition
from sim.effects.describe import name_of, place_named
from sim.effects.effect import EachMove, Effect
from sim.effects.environment import Ambient
from sim.effects.geometry import FrameError, LinkWarming, Warming
from sim.effects.joints import GearFriction, GearStiffness, HardstopAngle, HardstopStiffness, ResolverBias
from sim.effects.links import LinkAngle, LinkLength, ThermalGradient, ToolOffset, ToolTurn
from sim.effects.numerics import Numerics
from sim.effects.sensors import CurrentBias, EncoderZero
from sim.effects.size import Size
from sim.effects.structure import LinkBending, LinkStiffness, LinkTorsion, RoverCompliance
from sim.trials import FRICTION

BRIEFLY: Final = Manner(settle_s=4.0)
"""The arm settles before a recording for less long than in the closed loop: enough for differences."""
CALMLY: Final = Manner(settle_s=8.0)
"""Long enough for what a case is compared with."""
ONLY_POSED: Final = (
    *(LinkLength, LinkAngle, ThermalGradient, LinkWarming, Warming, FrameError, ToolOffset, ToolTurn),
    *(LinkStiffness, LinkBending, LinkTorsion, RoverCompliance, ContactStiffness, SurfacePosition),
)
"""Effects that show where the arm rests, or not at all; in free motion they are below its noise."""


@dataclass(frozen=True, slots=True)
class Uncertain:
    """A number that the calibration leaves uncertain, and the effect that it is."""

    nuisance: Nuisance
    effect: Callable[[float], Effect]
    """With this departure."""
    like: str = ""
    """The hypothesis, as told, that is the same number where it is small, if there is one."""
    one_sided: bool = False
    """Whether it departs to positive numbers only."""
    at: str = ""
    """Where alone it shows, if not everywhere."""


class ArmSimulator:
    """Ours, bound to a campaign (ground.gap.simulator.Simulator)."""

    def __init__(
        self,
        campaign: Compared,
        base: Params,
        sigma: Array,
        kinds: Mapping[str, type[Effect]] | None = None,
        manner: Manner = BRIEFLY,
        patch: tuple[Effect, ...] = (),
    ):
        """With a floor (m,); `kinds` are hypotheses, by default the catalogue's; `patch` is always on."""
        self.campaign, self.base, self.manner, self.patch = campaign, base, manner, patch
        self.layout = layout_of(campaign, sigma)
        self._made = {told(one): one for one in raced(kinds)}
        self.hypotheses = tuple(self._made)
        self._uncertain = tuple(left_uncertain())
        self.nuisances = tuple(one.nuisance for one in self._uncertain)
        self.likes = tuple(one.like for one in self._uncertain)
        self.one_sided = tuple(one.one_sided for one in self._uncertain)
        self.only_at = tuple(one.at for one in self._uncertain)

    def predict(self, settings: Settings, nuisance: Array) -> Array:
        """The features (m,); errors as of `predicted_values`."""
        return self.predicted(self.effects(settings, nuisance), all_of)

    def effects(self, settings: Settings, nuisance: Array) -> list[Effect]:
        """What is switched on beside the patch: hypotheses, and nuisances that are not 0."""
        found = [switched_on(self._made[one], one, values) for one, values in settings.items()]
        found += [one.effect(float(v)) for one, v in zip(self._uncertain, nuisance, strict=True) if v]
        return found

    def predicted(self, effects: Sequence[Effect], wanted: Callable[[Moving], bool]) -> Array:
        """Features (m,) with the patch and these; those of moving recordings that are not wanted are NaN."""
        return predicted_values(self.campaign, self.base, (*self.patch, *effects), self.manner, wanted)


@dataclass(frozen=True, slots=True)
class Touched:
    """Whether effects can show in a moving recording: at a joint if it moves, of geometry never."""

    effects: tuple[Effect, ...]

    def __call__(self, one: Moving) -> bool:
        """Any of them."""
        return any(self._shows(effect, one) for effect in self.effects)

    def _shows(self, effect: Effect, one: Moving) -> bool:
        if isinstance(effect, (HardstopStiffness, *ONLY_POSED)):
            return False  # no motion of a campaign comes to a hardstop
        joint = getattr(effect, "joint", None)
        return joint is None or any(segment.joint is Joint(joint) for segment in one.segments)


def all_of(_: Moving) -> bool:
    """Every recording."""
    return True


def raced(kinds: Mapping[str, type[Effect]] | None) -> Iterator[catalogue.Hypothesis]:
    """The catalogue's hypotheses that may be a cause: no chance from move to move, nor what logs tell."""
    return (one for one in catalogue.hypotheses(kinds) if not issubclass(one.kind, (EachMove, Ambient)))


def told(one: catalogue.Hypothesis) -> Hypothesis:
    """In the words of the diagnosis; parameters that are many numbers stay as they are by default.

    Of a factor that is one where nothing is changed, it is told the logarithm: there it is symmetric.
    """
    parameters = [p for p in (*one.sizes, *one.shapes) if p.size is not None and p.count == 1]
    return Hypothesis(
        name_of(one.kind),
        place_named(one.kind, dict(one.place)) or "arm",
        tuple(_told(p, p.size) for p in parameters if p.size is not None),
    )


def is_factor(size: Size) -> bool:
    """Whether it multiplies something, and cannot be 0."""
    return size.neutral == 1.0 and size.low > 0.0


def _told(parameter: described.Parameter, size: Size) -> Parameter:
    if is_factor(size):
        ends = float(np.log(size.low)), float(np.log(size.high))
        return Parameter(parameter.field, "ln", *ends, float(np.log1p(size.typical)), 0.0)
    typical = float(parameter.default) if size.neutral is None else size.typical
    return Parameter(parameter.field, size.unit, size.low, size.high, typical, size.neutral)


def switched_on(made: catalogue.Hypothesis, hypothesis: Hypothesis, values: Array) -> Effect:
    """The effect that a hypothesis, as told, is with these values of its parameters."""
    named = zip(hypothesis.parameters, values, strict=True)
    return made.effect(**{p.name: _valued(made, p.name, float(v)) for p, v in named})


def layout_of(campaign: Compared, sigma: Array) -> Layout:
    """What the features are; each place has channels of its own."""
    features = campaign.features
    named = [channel_of(feature) for feature in features]
    blocks, places, regimes = (
        tuple(dict.fromkeys(getattr(f, name) for f in features)) for name in ("block", "place", "regime")
    )
    units = {name: UNITS[f.channel] for name, f in zip(named, features, strict=True)}
    return Layout(
        sigma=sigma,
        block=_numbers(blocks, [f.block for f in features]),
        channel=_numbers(tuple(units), named),
        place=_numbers(places, [f.place for f in features]),
        regime=_numbers(regimes, [f.regime for f in features]),
        condition=np.array([f.condition for f in features]).reshape(-1, len(CONDITIONS)),
        blocks=blocks,
        channels=tuple(units),
        units=tuple(units.values()),
        places=places,
        regimes=regimes,
        conditions=CONDITIONS,
    )


def _numbers(names: tuple[str, ...], of: list[str]) -> Ints:
    number = {name: k for k, name in enumerate(names)}
    return np.array([number[name] for name in of], np.intp)


def left_uncertain() -> Iterator[Uncertain]:
    """What a calibration leaves (sim.effects.built), and what friction is on another day."""
    inner: list[tuple[Frame, Tool | None]] = [(f, None) for f in Frame if f is not Frame.TOOL]
    for frame, tool in (*inner, *((Frame.TOOL, tool) for tool in Tool)):
        for axis in IDENTIFIABLE[frame]:
            named = (frame.name if tool is None else tool.name).lower()
            unit, sigma = ("rad", LEFT_FRAME_RAD) if axis < len("xyz") else ("m", LEFT_FRAME_M)
            word = ("rx", "ry", "rz", "tx", "ty", "tz")[axis]
            yield Uncertain(
                Nuisance(f"frame {named}.{word}", unit, sigma),
                partial(_displaced, frame, tool, axis),
                f"{_TURN_SHIFT[tool is not None][unit]} at {named}.{word[1]}",
            )
    for joint in Joint:
        name = joint.name.lower()
        yield Uncertain(
            Nuisance(f"zero {name}", "rad", LEFT_ZERO_RAD),
            partial(HardstopAngle, joint),
            f"hardstop-angle at {name}",
        )
        yield Uncertain(
            Nuisance(f"gear stiffness {name}", "ln", LEFT_STIFFNESS),
            partial(_times, GearStiffness, joint),
            f"gear-stiffness at {name}",
        )
        yield Uncertain(
            Nuisance(f"friction {name}", "ln", FRICTION),
            partial(_times, GearFriction, joint),
            f"gear-friction at {name}",
        )
    for frame in SPRINGS:
        named = frame.name.lower()
        yield Uncertain(
            Nuisance(f"link stiffness {named}", "ln", LEFT_STIFFNESS),
            partial(_times, LinkStiffness, frame),
            f"link-stiffness at {named}",
        )
    for joint in Joint:
        name = joint.name.lower()
        yield Uncertain(
            Nuisance(f"counter {name}", "rad", COUNT_RAD),
            partial(EncoderZero, joint),
            f"encoder-zero at {name}",
        )
        for word, numerics in NUMERICS.items():
            nuisance = Nuisance(f"{word} {name}", "1", OTHERWISE)
            yield Uncertain(nuisance, partial(_otherwise, numerics), one_sided=True, at=name)
    yield from _of_sessions()


def _of_sessions() -> Iterator[Uncertain]:
    """What differs a little from session to session: nobody sets out the same twice."""
    for joint in Joint:
        name = joint.name.lower()
        for word, unit, sigma, effect, like in (
            ("friction", "ln", 0.01, partial(_times, GearFriction, joint), "gear-friction"),
            ("gear stiffness", "ln", 0.02, partial(_times, GearStiffness, joint), "gear-stiffness"),
            ("current", "A", 0.003, partial(CurrentBias, joint), "current-bias"),
            ("resolver", "rad", 6e-6, partial(ResolverBias, joint), "resolver-bias"),
        ):
            nuisance = Nuisance(f"{word} {name} of a session", unit, sigma, each_block=True)
            yield Uncertain(nuisance, effect, f"{like} at {name}")


_TURN_SHIFT: Final = ({"rad": "link-angle", "m": "link-length"}, {"rad": "tool-turn", "m": "tool-offset"})
"""Of frames, and of tools."""


NUMERICS: Final = {
    "time step": Numerics("implicit", 16),
    "scheme": Numerics("explicit", 16),
    "scheme and time step": Numerics("explicit", 24),
}
COUNT_RAD: Final = 3.3e-6
"""A count of an encoder: where in it a set-point falls is chance, the same all along."""
OTHERWISE: Final = 2.0
"""One sigma of what the plant's own numerics are off by, in differences to half the time step."""


def _otherwise(numerics: Numerics, share: float) -> Effect:
    """The whole difference: it cannot be had in parts."""
    return numerics


def _displaced(frame: Frame, tool: Tool | None, axis: int, value: float) -> Effect:
    return FrameError(frame, row6(value * np.eye(6)[axis]), tool)


def _times(kind: Callable[[Any, float], Effect], place: Joint | Frame, logarithm: float) -> Effect:
    return kind(place, float(np.exp(logarithm)))


def _valued(made: catalogue.Hypothesis, field: str, value: float) -> float:
    """As the effect has it: a factor for a logarithm, a whole number where it has one."""
    parameter = next(p for p in (*made.sizes, *made.shapes) if p.field == field)
    if parameter.size is not None and is_factor(parameter.size):
        return float(np.exp(value))
    whole = isinstance(parameter.default, int) and not isinstance(parameter.default, bool)
    return round(value) if whole else value
