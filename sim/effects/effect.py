"""Base classes of effects, each of which is one difference between a built arm and its drawing."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol, get_type_hints

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import JointParams, LinkParams, Params
from fsw.dictionary.types import Limits, Matrix6, names_tool, row6
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from sim.arm_model.description import ArmDescription
from sim.arm_model.load import default_arm
from sim.record import NO_DISTURBANCE, Disturbance, MoveDisturbance, no_move_disturbance
from sim.setting import WARM_C

if TYPE_CHECKING:  # an arm is described without a simulation of it
    import mujoco

    from sim.plant import Plant


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterSpec(Limits):
    """Bounds of a parameter, its unit, and its typical departure from neutral."""

    unit: str
    typical: float
    """Departure from neutral; for a parameter without a neutral value, the value itself."""
    neutral: float | None = None
    """Value without any change; None for a shape parameter."""


Factor = Annotated[float, ParameterSpec(0.1, 10.0, unit="1", typical=0.2, neutral=1.0)]
"""Factor on the value of the drawing."""
SmallAngle = Annotated[float, ParameterSpec(-0.1, 0.1, unit="rad", typical=2e-3, neutral=0.0)]
SmallLength = Annotated[float, ParameterSpec(-0.1, 0.1, unit="m", typical=1.5e-3, neutral=0.0)]
Compliance = Annotated[float, ParameterSpec(0.0, 1e-3, unit="rad/(N m)", typical=5e-6, neutral=0.0)]
TemperatureRise = Annotated[float, ParameterSpec(-200.0, 200.0, unit="K", typical=30.0, neutral=0.0)]
StartTime = Annotated[float, ParameterSpec(0.0, 1e5, unit="s", typical=10.0)]


class SensorError(Protocol):
    """Error of a sensor that changes its readings."""

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return the wrong readings in place of the right ones."""

    def update(self, sensors: Sensors) -> "SensorError":
        """Return the same error; it keeps the first readings after its begin if it needs them."""


def apply_sensor_errors(
    sensor_errors: tuple[SensorError, ...], sensors: Sensors, rng: np.random.Generator
) -> tuple[Sensors, tuple[SensorError, ...]]:
    """Apply sensor errors to readings as they began; return readings, and the errors of the next cycle."""
    updated = []
    for error in sensor_errors:
        updated.append(error.update(sensors))
        sensors = updated[-1].read(sensors, rng)
    return sensors, tuple(updated)


class ResolverError(Protocol):
    """Error of a resolver that depends on the output angle."""

    def error_rad(self, output_rad: Array) -> Array:
        """Return the error of each resolver, shape (5,), at output angles of shape (5,)."""


@dataclass(frozen=True, slots=True, eq=False)
class ActiveEffect:
    """Effect that acts in every cycle, with its state."""

    effect: "EachCycle"
    state: Any = None
    begun: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Hardware:
    """Avionics and sensors; joint arrays in the order of Joint."""

    rad_per_count: Array
    """True encoder scale, output side; flight software may use another one."""
    counter_zero_rad: Array
    """Motor angle, output side, at which the counter of an encoder reads 0."""
    resolver_bias_rad: Array
    resolver_step_rad: float
    """Resolution; 0 means no rounding."""
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
    """Temperature around each motor."""
    structure_C: float
    """Temperature of links and tools."""
    structure_offset_K: float
    """Error of the sensor of that temperature."""
    structure_noise_K: float
    power_until_s: float
    """Time at which the bus voltage fails for good; brakes hold without power."""
    brake_stuck: NDArray[np.bool_]
    """Brakes that do not release once they are on."""
    missed_cycles: int
    """Number of the next cycles in which flight software is not called."""
    sensor_errors: tuple["SensorError", ...]
    timed: tuple["Timed", ...]
    """Effects that have not begun."""
    each_move: tuple["EachMove", ...]
    """Effects that are drawn for every move."""
    resolver_errors: tuple["ResolverError", ...]
    """Active errors of resolvers beside their bias."""
    each_cycle: tuple["ActiveEffect", ...]
    """Effects that act on the plant in every cycle."""


def nominal_hardware(arm: ArmDescription | None = None) -> Hardware:
    """Return the avionics of the drawing of an arm; None for the default one."""
    arm = arm or default_arm().description
    joints = arm.joints.by_name()
    motors = [arm.actuator_of(name) for name in joints]
    counts = np.array([motor.encoder_counts_per_turn * motor.gear_ratio for motor in motors])
    return Hardware(
        rad_per_count=2 * np.pi / counts,
        counter_zero_rad=np.array([joint.counter_zero_rad for joint in joints.values()]),
        resolver_bias_rad=np.zeros(5),
        resolver_step_rad=2 * np.pi / 2**16,
        resolver_noise_rad=1e-4,
        current_noise_A=0.02,
        gravity_noise_m_s2=0.005,
        gravity_bias_R_m_s2=np.zeros(3),
        brake_delay_s=np.full(5, 0.075),
        switch_force_N=2.0,
        switch_release_N=1.0,
        winding_K_W=np.array([motor.winding_K_W for motor in motors]),
        winding_s=np.array([motor.winding_s for motor in motors]),
        ambient_C=np.full(5, WARM_C),
        structure_C=WARM_C,
        structure_offset_K=0.0,
        structure_noise_K=0.1,
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
    """Base of all effects; a subclass has fields for its place and parameters, and overrides what it changes.

    A field whose type is a joint, a frame, a tool or a literal is part of the place.
    The others are parameters with a ParameterSpec.
    An effect that a flight parameter describes also overrides `on_params`.
    """

    built_in: ClassVar[bool] = True
    """True if the arm has the effect during its hardstop initialisation; False if a run adds it."""

    def on_model(self, spec: "mujoco.MjSpec") -> None:
        """Change the MuJoCo model."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Change avionics or sensors."""
        return hardware

    def on_params(self, params: Params) -> Params:
        """Return the flight parameters of a perfect calibration of this effect."""
        return params

    def find_misfit(self, params: Params) -> str | None:
        """Return why the arm of these parameters cannot have this effect, None if it can."""
        hints = get_type_hints(type(self), include_extras=True)
        for field in fields(self):
            tool = getattr(self, field.name)
            if names_tool(hints[field.name]) and tool not in (None, *params.tool_names):
                known = ", ".join(params.tool_names)
                return f"{field.name}: {tool} is not a tool of this arm; there are {known}"
        return None


@dataclass(frozen=True, slots=True)
class ReadingError(Effect):
    """Effect on a reading after its noise."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add the error to the active ones."""
        return replace(hardware, sensor_errors=(*hardware.sensor_errors, self))

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Sensors:
        """Return the wrong readings in place of the right ones."""
        raise NotImplementedError

    def update(self, sensors: Sensors) -> "ReadingError":
        """Return the same error, which has no state."""
        return self


@dataclass(frozen=True, slots=True)
class Timed(Effect):
    """Effect that begins with the first cycle at or after a given time."""

    built_in: ClassVar[bool] = False
    at_s: StartTime

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add this effect to those that have not begun."""
        return replace(hardware, timed=(*hardware.timed, self))

    def begin(self, plant: "Plant", hardware: Hardware) -> Hardware:
        """Change the running plant; return the avionics and sensors from this cycle on."""
        return hardware


@dataclass(frozen=True, slots=True)
class EachMove(Effect):
    """Effect that is drawn again for each move: when a motor is powered after all were off."""

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add this effect to those that are drawn for every move."""
        return replace(hardware, each_move=(*hardware.each_move, self))

    def draw(self, rng: np.random.Generator) -> MoveDisturbance:
        """Draw the disturbance of one move."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class EachCycle(Effect):
    """Effect that depends on the state of the plant and is computed once a control cycle.

    Its state is an immutable value, so that a run can be forked.
    """

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add this effect to those that act in every cycle."""
        return replace(hardware, each_cycle=(*hardware.each_cycle, ActiveEffect(self)))

    def begin(self, plant: "Plant", hardware: Hardware) -> Any:
        """Return the initial state; None unless overridden."""
        return None

    def cycle(self, plant: "Plant", hardware: Hardware, state: Any) -> tuple[Any, Disturbance]:
        """Return the next state, and the disturbance of the plant in this cycle.

        An override that changes the plant itself sets the change again in every cycle.
        """
        raise NotImplementedError


class EffectMisfit(ValueError):
    """Effect that an arm cannot have; the message names it and says what would be right."""


def check_effects(effects: Iterable[Effect], params: Params) -> None:
    """Check that the arm of these parameters can have these effects; EffectMisfit if it lacks a place."""
    for effect in effects:
        problem = effect.find_misfit(params)
        if problem is not None:
            raise EffectMisfit(f"effect {type(effect).__name__}: {problem}")


def apply_effects(effects: Iterable[Effect], spec: "mujoco.MjSpec", hardware: Hardware) -> Hardware:
    """Change the MuJoCo model by all effects, in order; return the avionics and sensors.

    The arm grows to its temperature last, with the coefficients that the effects leave.
    """
    for effect in effects:
        effect.on_model(spec)
        hardware = effect.on_hardware(hardware)
    from sim.world import grow  # loads MuJoCo, which takes 0.1 s, and an arm is described without it

    grow(spec, hardware.structure_C)
    return hardware


def hardware_with_effects(effects: Iterable[Effect], hardware: Hardware) -> Hardware:
    """Return avionics and sensors changed by all effects."""
    for effect in effects:
        hardware = effect.on_hardware(hardware)
    return hardware


def params_with_effects(effects: Iterable[Effect], params: Params) -> Params:
    """Return the flight parameters of a perfect calibration of all these effects."""
    for effect in effects:
        params = effect.on_params(params)
    return params


def apply_cycle_effects(plant: "Plant", hardware: Hardware) -> Hardware:
    """Apply the effects of every cycle to the plant; return the avionics and sensors after it."""
    hardware, total = evaluate_cycle_effects(plant, hardware)
    plant.set_disturbance(total)
    return hardware


def evaluate_cycle_effects(plant: "Plant", hardware: Hardware) -> tuple[Hardware, Disturbance]:
    """Compute avionics, sensors and the total disturbance of this cycle; the plant keeps its own."""
    total, active = NO_DISTURBANCE, []
    for one in hardware.each_cycle:
        before = one.state if one.begun else one.effect.begin(plant, hardware)
        state, disturbance = one.effect.cycle(plant, hardware, before)
        total += disturbance
        is_kept = one.begun and state is one.state
        active.append(one if is_kept else ActiveEffect(one.effect, state, True))
    if any(after is not before for after, before in zip(active, hardware.each_cycle, strict=True)):
        hardware = replace(hardware, each_cycle=tuple(active))  # costs as much time as an effect
    return hardware, total


def draw_move_disturbance(effects: Iterable[EachMove], rng: np.random.Generator) -> MoveDisturbance:
    """Draw the disturbance of one move as the sum over these effects."""
    return sum((effect.draw(rng) for effect in effects), no_move_disturbance())


def refuse_first_joint(joint: Joint) -> None:
    """Refuse the joint that has no other between itself and the rover; ValueError if it is the azimuth."""
    if joint is Joint.AZIMUTH:
        raise ValueError("joint: azimuth has no joint between itself and the rover")


def with_element(values: NDArray[Any], index: int, value: float) -> NDArray[Any]:
    """Return a copy with one element replaced."""
    changed = values.copy()
    changed[index] = value
    return changed


def joint_of(params: Params, joint: Joint) -> JointParams:
    """Return the flight parameters of a joint."""
    found: JointParams = getattr(params.joints, joint.name.lower())
    return found


def with_joint(params: Params, joint: Joint, **values: Any) -> Params:
    """Return the parameters with some of those of one joint replaced."""
    changed = replace(joint_of(params, joint), **values)
    return replace(params, joints=replace(params.joints, **{joint.name.lower(): changed}))


def scale_joint(params: Params, joint: Joint, name: str, factor: float) -> Params:
    """Return the parameters with one of those of one joint multiplied by a factor."""
    return with_joint(params, joint, **{name: getattr(joint_of(params, joint), name) * factor})


def link_of(params: Params, frame: Frame) -> LinkParams:
    """Return the flight parameters of the link that ends in a frame other than TOOL."""
    found: LinkParams = getattr(params.links, frame.name.lower())
    return found


def with_link(params: Params, frame: Frame, changed: LinkParams) -> Params:
    """Return the parameters with those of one link replaced."""
    return replace(params, links=replace(params.links, **{frame.name.lower(): changed}))


def rotate_matrix(matrix: Matrix6, R: Array) -> Matrix6:
    """Rotate a matrix for screws by R: its rotation and its translation parts."""
    R6 = np.zeros((6, 6))
    R6[:3, :3] = R6[3:, 3:] = R
    return matrix6(R6 @ np.array(matrix) @ R6.T)


def matrix6(values: Array) -> Matrix6:
    """Return a matrix as six tuples of six numbers."""
    a, b, c, d, e, f = (row6(row) for row in values.tolist())
    return (a, b, c, d, e, f)
