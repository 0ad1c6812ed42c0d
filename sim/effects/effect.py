"""Base classes of effects: each is one way in which a built arm differs from the drawing."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.params import Params
from fsw.dictionary.types import Limits
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from sim.disturbance import Disturbance, MoveDisturbance, no_move_disturbance
from sim.plant import Plant


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterSpec(Limits):
    """The bounds of a parameter, its unit, and how far from neutral it is typically."""

    unit: str
    typical: float
    """Departure from neutral; of a parameter without a neutral value, the value."""
    neutral: float | None = None
    """Where the effect changes nothing; None for a parameter that only shapes what others bring about."""


Factor = Annotated[float, ParameterSpec(0.1, 10.0, unit="1", typical=0.2, neutral=1.0)]
"""Of what the drawing says."""
SmallAngle = Annotated[float, ParameterSpec(-0.1, 0.1, unit="rad", typical=2e-3, neutral=0.0)]
SmallLength = Annotated[float, ParameterSpec(-0.1, 0.1, unit="m", typical=1.5e-3, neutral=0.0)]
Compliance = Annotated[float, ParameterSpec(0.0, 1e-3, unit="rad/(N m)", typical=5e-6, neutral=0.0)]
TemperatureRise = Annotated[float, ParameterSpec(-200.0, 200.0, unit="K", typical=30.0, neutral=0.0)]
StartTime = Annotated[float, ParameterSpec(0.0, 1e5, unit="s", typical=10.0)]


class SensorError(Protocol):
    """Something wrong with a sensor."""

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """The readings as they come, of what they would be."""

    def update(self, sensors: Sensors) -> "SensorError":
        """The same, knowing what was read when it began."""


def apply_sensor_errors(
    sensor_errors: tuple[SensorError, ...], sensors: Sensors, rng: np.random.Generator
) -> tuple[Sensors, tuple[SensorError, ...]]:
    """The readings with all that is wrong with them, in the order in which it began; and what that knows."""
    begun = []
    for one in sensor_errors:
        begun.append(one.update(sensors))
        sensors = begun[-1].read(sensors, rng)
    return sensors, tuple(begun)


class ResolverError(Protocol):
    """Something wrong with a resolver that depends on how its joint stands."""

    def error_rad(self, output_rad: Array) -> Array:
        """What each resolver (5) reads too much at these outputs (5)."""


@dataclass(frozen=True, slots=True, eq=False)
class ActiveEffect:
    """An effect that acts in every cycle, and what it remembers."""

    effect: "EachCycle"
    state: Any = None
    begun: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Hardware:
    """What avionics and sensors are made of; joint arrays in the order of Joint."""

    rad_per_count: Array
    """Output side: encoder counts and gear ratio as they are, whatever flight software believes."""
    counter_zero_rad: Array
    """Motor angle, output side, at which an encoder's counter happens to read 0."""
    resolver_bias_rad: Array
    resolver_step_rad: float
    """Of the smallest digit; 0 reads exactly."""
    resolver_noise_rad: float
    current_noise_A: float
    gravity_noise_m_s2: float
    gravity_bias_R_m_s2: Array
    brake_delay_s: Array
    switch_force_N: float
    """Force at which a contact switch closes."""
    switch_release_N: float
    """Force at which it opens again."""
    winding_K_W: Array
    """Thermal resistance from winding to ambient."""
    winding_s: Array
    """Thermal time constant."""
    ambient_C: Array
    """Around each motor."""
    power_until_s: float
    """When the bus voltage goes for good; brakes hold without power."""
    brake_stuck: NDArray[np.bool_]
    """Brakes that, once on, do not release."""
    missed_cycles: int
    """For how many cycles from now on flight software is not called."""
    sensor_errors: tuple["SensorError", ...]
    """What is wrong with sensors by now."""
    timed: tuple["Timed", ...]
    """What is still to happen."""
    each_move: tuple["EachMove", ...]
    """What is drawn anew for every move."""
    resolver_errors: tuple["ResolverError", ...]
    """What is wrong with resolvers, beyond a bias."""
    each_cycle: tuple["ActiveEffect", ...]
    """What acts on the plant in every cycle."""


def nominal_hardware() -> Hardware:
    """Avionics as on the drawing; sources in models/mjcf/PROVENANCE.md."""
    return Hardware(
        rad_per_count=2 * np.pi / (256 * np.array([7520.0, 7520.0, 7520.0, 4624.0, 4624.0])),
        counter_zero_rad=np.array([0.7313, -1.2147, 0.3339, -0.9281, 1.6073]),
        resolver_bias_rad=np.zeros(5),
        resolver_step_rad=2 * np.pi / 2**16,
        resolver_noise_rad=1e-4,
        current_noise_A=0.02,
        gravity_noise_m_s2=0.005,
        gravity_bias_R_m_s2=np.zeros(3),
        brake_delay_s=np.full(5, 0.075),
        switch_force_N=2.0,
        switch_release_N=1.0,
        winding_K_W=np.array([2.0, 2.0, 2.0, 3.0, 3.0]),
        winding_s=np.array([900.0, 900.0, 900.0, 600.0, 600.0]),
        ambient_C=np.full(5, 20.0),
        power_until_s=np.inf,
        brake_stuck=np.zeros(5, bool),
        missed_cycles=0,
        sensor_errors=(),
        timed=(),
        each_move=(),
        resolver_errors=(),
        each_cycle=(),
    )


@dataclass(frozen=True, slots=True)
class Effect:
    """Base of all effects: a subclass names its place and parameters and overrides what it changes.

    A field of the type of a joint, a frame, a tool or a literal says where it sits; the others are its
    parameters, with a Size. An effect that flight software has a word for also says what a perfect
    calibration would write.
    """

    built_in: ClassVar[bool] = True
    """Whether the arm has it when its joints look for their hardstops, or only once a run begins."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Change the MuJoCo model."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Change avionics or sensors."""
        return hardware

    def on_params(self, params: Params) -> Params:
        """The flight parameters that know this effect."""
        return params


@dataclass(frozen=True, slots=True)
class Timed(Effect):
    """An effect that begins at a moment of the run, with the first cycle that is not before it."""

    built_in: ClassVar[bool] = False
    at_s: StartTime

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """It is to come."""
        return replace(hardware, timed=(*hardware.timed, self))

    def begin(self, plant: Plant, hardware: Hardware) -> Hardware:
        """Change the running plant; the avionics and sensors from now on."""
        return hardware


@dataclass(frozen=True, slots=True)
class EachMove(Effect):
    """An effect that is drawn anew whenever a move begins: a motor gets power after all were without."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """It is to be drawn."""
        return replace(hardware, each_move=(*hardware.each_move, self))

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """How far off the arm comes to stand this time."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class EachCycle(Effect):
    """An effect that depends on the state of the plant: it is looked at once a control cycle.

    What it remembers is a value that is never changed, so that a run can be forked.
    """

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """It is to act."""
        return replace(hardware, each_cycle=(*hardware.each_cycle, ActiveEffect(self)))

    def begin(self, plant: Plant, hardware: Hardware) -> Any:
        """What it remembers at first; nothing unless overridden."""
        return None

    def cycle(self, plant: Plant, hardware: Hardware, state: Any) -> tuple[Any, Disturbance]:
        """What it remembers from now on, and what it does to the plant in this cycle.

        What it changes of the plant itself it must set anew in every cycle.
        """
        raise NotImplementedError


def apply_effects(effects: Iterable[Effect], spec: mujoco.MjSpec, hardware: Hardware) -> Hardware:
    """Change the MuJoCo model as all of these effects do, one after the other; the avionics and sensors."""
    for effect in effects:
        effect.on_model(spec)
        hardware = effect.on_hardware(hardware)
    return hardware


def params_with_effects(effects: Iterable[Effect], params: Params) -> Params:
    """The flight parameters that know all of these effects."""
    for effect in effects:
        params = effect.on_params(params)
    return params


def apply_cycle_effects(plant: Plant, hardware: Hardware) -> Hardware:
    """Let what acts in every cycle act on the plant in this one; the avionics and sensors after it."""
    hardware, total = evaluate_cycle_effects(plant, hardware)
    plant.set_disturbance(total)
    return hardware


def evaluate_cycle_effects(plant: Plant, hardware: Hardware) -> tuple[Hardware, Disturbance]:
    """The avionics and sensors after this cycle, and all that acts on the plant in it; it is yet to act."""
    total, running = Disturbance(), []
    for one in hardware.each_cycle:
        before = one.state if one.begun else one.effect.begin(plant, hardware)
        state, influence = one.effect.cycle(plant, hardware, before)
        total += influence
        running.append(ActiveEffect(one.effect, state, True))
    return replace(hardware, each_cycle=tuple(running)), total


def draw_move_disturbance(effects: Iterable[EachMove], rng: np.random.Generator) -> MoveDisturbance:
    """What one move leaves to chance, by all of these effects."""
    return sum((effect.draw(rng) for effect in effects), no_move_disturbance())


def with_element(values: Array, index: int, value: float) -> Array:
    """A copy with one element replaced."""
    changed = values.copy()
    changed[index] = value
    return changed
