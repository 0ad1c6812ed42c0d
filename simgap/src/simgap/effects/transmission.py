"""Effects of gears and encoders: backlash, compliance and its rotor, coupling, errors that repeat."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, Family, Fields, Rotor, Size, State, Tick
from simgap.robot import Robot

FREE_RAD: Final = 1e6
"""Range of a gear that nothing limits."""
ROTOR_SHARE: Final = 0.01
"""Inertia of the rotor body, as a share of the inertia at the joint: a model without armature needs one."""
LARGEST_PHASE: Final = 0.5
"""Largest phase [rad] of the gear resonance in a time step. The integrators are explicit in springs: they are
stable up to 2, and at 0.5 the frequency is right within 1 %."""
DAMPING_RATIO: Final = 0.05
"""Of the gear resonance: a steel gear loses a few tenths of the energy of an oscillation."""


@dataclass(frozen=True, slots=True)
class _Gear(Effect):
    """Gear between the rotor of a motor and its joint."""

    family: ClassVar[Family] = Family.TRANSMISSION
    place: str
    index: int
    """Index of the joint in the robot."""
    encoder_is_at_output: bool
    typical: float
    """In the unit of the size, as is the highest."""
    highest: float
    is_slide: bool = False

    def vary(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add the rotor."""
        _add_rotor(spec, robot, self.place)


@dataclass(frozen=True, slots=True)
class Backlash(_Gear):
    """Free angle between rotor and joint, with hard flanks.

    MuJoCo realisation: a limited tendon over rotor and joint. Its damping acts on the flanks only, so that
    the rotor is free between them.
    """

    name: ClassVar[str] = "backlash"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Whole free angle."""
        return (Size("backlash_m" if self.is_slide else "backlash_rad", 0.0, self.highest, self.typical),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Let the motor turn the rotor, and limit the angle between rotor and joint."""
        rows = size[:, 0] != 0
        half_rad = size[rows] / 2 * np.array((-1.0, 1.0))
        fields.rotors.append(Rotor(self.index, _rotor(self.place), rows, self.encoder_is_at_output))
        gear = fields.batch.model.tendon(_gear(self.place)).id
        fields.batch.expand("tendon_lengthspring")[rows, gear] = half_rad
        is_rigid = fields.batch.expand("tendon_stiffness")[rows, gear] == 0
        fields.batch.expand("tendon_range")[np.flatnonzero(rows)[is_rigid], gear] = half_rad[is_rigid]

    def deflection_rad(self, size: Array, state: State) -> Array:
        """Return half the backlash against the load: the output lies on the flank that carries it."""
        return np.asarray(-0.5 * size[:, 0] * np.sign(state.load_Nm[:, self.index]))


@dataclass(frozen=True, slots=True)
class JointCompliance(_Gear):
    """Elastic gear between rotor and joint.

    MuJoCo realisation: a tendon spring over rotor and joint; backlash at the same joint is its dead band. A
    gear that is stiffer than the time step resolves has the stiffness that it resolves.
    """

    name: ClassVar[str] = "joint compliance"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Deflection per torque."""
        name = "compliance_m_N" if self.is_slide else "compliance_rad_Nm"
        return (Size(name, 0.0, self.highest, self.typical),)

    def describe(self, size: Array) -> str:
        """Return the stiffness too, which data sheets give."""
        unit = "N/m" if self.is_slide else "N m/rad"
        stiffness = f" (stiffness {1 / size[0]:.4g} {unit})" if size[0] > 0 else ""
        return f"{self.sizes[0].name} = {size[0]:.4g}{stiffness}"

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Let the motor turn the rotor, and put the spring between rotor and joint."""
        rows = size[:, 0] != 0
        fields.rotors.append(Rotor(self.index, _rotor(self.place), rows, self.encoder_is_at_output))
        inertia_kgm2 = gear_inertia_kgm2(robot, self.index)
        stiffest = inertia_kgm2 * (LARGEST_PHASE / robot.model.opt.timestep) ** 2
        stiffness = np.minimum(1 / size[rows, 0], stiffest)
        gear = fields.batch.model.tendon(_gear(self.place)).id
        fields.batch.expand("tendon_stiffness")[rows, gear] = stiffness
        fields.batch.expand("tendon_damping")[rows, gear] = (
            2 * DAMPING_RATIO * np.sqrt(stiffness * inertia_kgm2)
        )
        fields.batch.expand("tendon_range")[rows, gear] = (-FREE_RAD, FREE_RAD)

    def deflection_rad(self, size: Array, state: State) -> Array:
        """Return the deflection of the output under the load: it stays behind the motor that carries it."""
        return np.asarray(-size[:, 0] * state.load_Nm[:, self.index])


def gear_inertia_kgm2(robot: Robot, index: int) -> float:
    """Return the inertia that the spring of a gear moves: rotor and joint in series, at zero pose."""
    dof = robot.joints[index].dof_index
    whole = float(robot.model.dof_M0[dof])
    rotor = float(robot.model.dof_armature[dof]) + ROTOR_SHARE * whole
    link = max(whole - float(robot.model.dof_armature[dof]), ROTOR_SHARE * whole)
    return rotor * link / (rotor + link)


def _rotor(joint: str) -> str:
    return f"{joint} rotor"


def _gear(joint: str) -> str:
    return f"{joint} gear"


def _add_rotor(spec: mujoco.MjSpec, robot: Robot, joint: str) -> None:
    """Add a rotor that stands still beside the robot, and a tendon over it that does nothing yet.

    That of a slide is a hinge too, which gravity does not move: it turns by 1 rad in 1 m.
    """
    if spec.joint(_rotor(joint)) is not None:
        return
    inertia_kgm2 = ROTOR_SHARE * float(robot.model.dof_M0[robot.joint(joint).dof_index])
    turned = spec.joint(robot.mjcf_joint(joint))
    body = spec.worldbody.add_body(
        name=_rotor(joint), mass=1.0, inertia=(inertia_kgm2,) * 3, explicitinertial=True
    )
    body.add_joint(
        name=_rotor(joint),
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=(0.0, 0.0, 1.0),
        damping=0.0,
        frictionloss=0.0,
        armature=0.0,
        limited=mujoco.mjtLimited.mjLIMITED_FALSE,
        solref_friction=turned.solref_friction,
        solimp_friction=turned.solimp_friction,
    )
    gear = spec.add_tendon(
        name=_gear(joint),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=(-FREE_RAD, FREE_RAD),
        springlength=(0.0, 0.0),
        solref_limit=(2 * robot.model.opt.timestep, 1.0),  # the stiffest flank that is stable
        solimp_limit=(0.99, 0.99, 1e-3, 0.5, 2.0),
    )
    gear.wrap_joint(turned.name, 1.0)
    gear.wrap_joint(_rotor(joint), -1.0)


@dataclass(frozen=True, slots=True)
class JointCoupling(Effect):
    """The motor of a joint turns by size times the motion of a neighbour while the joint stands still.

    Motor angle m = q + size * q_neighbour, so by virtual work the load of the joint comes back to the
    neighbour: its motor carries size * load less. A second encoder at the output shows the angle. An encoder
    at the motor is in the loop, which hides the angle, so that a simulation has the torque alone. The torque
    acts at the neighbour, for which inverse dynamics has no hook.
    """

    name: ClassVar[str] = "joint coupling"
    family: ClassVar[Family] = Family.TRANSMISSION
    place: str
    index: int
    neighbour: str
    neighbour_index: int
    typical_ratio: float

    @property
    def key(self) -> str:
        """Name with the neighbour."""
        return f"{self.place}: {self.name} to {self.neighbour}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Turn of the motor per turn of the neighbour; 1 is a joint that keeps its direction in the world."""
        return (Size("coupling_ratio", -1.0, 1.0, self.typical_ratio),)

    def act(self, size: Array, tick: Tick) -> None:
        """Add the torque at the neighbour."""
        tick.applied_Nm[:, self.neighbour_index] += size[:, 0] * tick.state.load_Nm[:, self.index]

    def deflection_rad(self, size: Array, state: State) -> Array:
        """Return the turn of the output that the motor does not make."""
        return np.asarray(-size[:, 0] * state.q_rad[:, self.neighbour_index])


NEWTON_STEPS: Final = 8
"""Newton's method doubles its digits in each step; errors of a few milliradians need three."""
STEEPEST: Final = 0.5
"""Largest slope of one sine or cosine: with both, the shown angle still grows with the true one."""


@dataclass(frozen=True, slots=True)
class _Waves(Effect):
    """Sines and cosines of some orders: an order is the number of periods in a turn of the joint."""

    family: ClassVar[Family] = Family.GEOMETRY
    place: str

    @property
    def orders(self) -> Sequence[int]:
        """Orders, each with a sine and a cosine."""
        raise NotImplementedError

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Add the error."""
        return np.asarray(q_rad + _waves(size, self.orders, q_rad)[0])

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Subtract the error at the true angle, by Newton's method; at size 0 the first step is exact."""
        q_rad = shown_rad.copy()
        for _ in range(NEWTON_STEPS):
            error, slope = _waves(size, self.orders, q_rad)
            # orders together may be steeper than 1 in a wild guess of a fit: the step stays finite
            q_rad = q_rad - (q_rad + error - shown_rad) / np.maximum(1 + slope, 0.25)
        return q_rad


@dataclass(frozen=True, slots=True)
class PeriodicError(_Waves):
    """Sine and cosine of one order."""

    name: ClassVar[str] = "periodic joint error"
    order: int
    typical_rad: float

    @property
    def orders(self) -> Sequence[int]:
        """Order."""
        return (self.order,)

    @property
    def key(self) -> str:
        """Name with the order."""
        return f"{self.place}: {self.name} of order {self.order}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Amplitudes; both may have any sign."""
        bound_rad = STEEPEST / self.order
        return (
            Size("sine_rad", -bound_rad, bound_rad, self.typical_rad),
            Size("cosine_rad", -bound_rad, bound_rad, self.typical_rad),
        )

    def describe(self, size: Array) -> str:
        """Return amplitude and phase."""
        amplitude_mrad, phase_rad = 1e3 * np.hypot(size[0], size[1]), np.arctan2(size[1], size[0])
        return f"{amplitude_mrad:.3g} mrad with {self.order} periods a turn, phase {phase_rad:.2f} rad"


@dataclass(frozen=True, slots=True)
class SmoothPeriodicError(_Waves):
    """Periodic error of all orders up to a highest one, expected to be smooth.

    The prior of order k has the width sigma / k. An order that the data do not show stays near 0, so the
    effective number of sizes is far below twice the highest order. It is for linear residuals, of geometry or
    a second encoder: in a forward model each size costs a simulation.
    """

    name: ClassVar[str] = "periodic joint error of many orders"
    sigma_rad: float
    highest: int = 48
    """All orders up to about 32 are needed for a UR10, and 48 are better for one of two series."""

    @property
    def orders(self) -> Sequence[int]:
        """All up to the highest."""
        return range(1, self.highest + 1)

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Sine and cosine of each order."""
        return tuple(
            Size(
                f"{wave}_{order}_rad",
                -STEEPEST / order,
                STEEPEST / order,
                self.sigma_rad / order,
                self.sigma_rad / order,
            )
            for order in self.orders
            for wave in ("sine", "cosine")
        )

    def describe(self, size: Array) -> str:
        """Return the root mean square, and the strongest order."""
        amplitude_rad = np.hypot(size[::2], size[1::2])
        strongest = int(np.argmax(amplitude_rad))
        return (
            f"{1e3 * np.sqrt(np.sum(np.square(size)) / 2):.3g} mrad RMS, "
            f"most of it {1e3 * amplitude_rad[strongest]:.3g} mrad with {strongest + 1} periods a turn"
        )


def _waves(size: Array, orders: Sequence[int], q_rad: Array) -> tuple[Array, Array]:
    """Return error and slope, (n_sims, n) each, of sines and cosines in turn, (n_sims, 2 n_orders)."""
    error, slope = np.zeros_like(q_rad), np.zeros_like(q_rad)
    for k, order in enumerate(orders):
        sine, cosine = size[:, [2 * k]], size[:, [2 * k + 1]]
        s, c = np.sin(order * q_rad), np.cos(order * q_rad)
        error += sine * s + cosine * c
        slope += order * (sine * c - cosine * s)
    return error, slope
