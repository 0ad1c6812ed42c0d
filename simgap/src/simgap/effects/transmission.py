"""Effects of gears: backlash, compliance, and the rotor that both need in a simulation.

Three kinds of residual, three realisations:

- Simulation: a rotor with an angle of its own. The motor with its armature, damping and dry friction turns
  the rotor; an elastic or a free gear turns the joint. Quasi-statics would not do: an encoder at the output
  sees no deflection at rest, because the loop corrects it. It sees the time that the rotor needs to cross the
  backlash after a reversal, and a resonance. Dry friction stays at the motor, as most of it comes from the
  fast stages of a gear. At the output it would hold the joint while the rotor crosses, and backlash would
  leave hardly a trace.
- Second encoder: `deflection_rad`, quasi-static. Output and motor are both measured, and their difference is
  the deflection under the load, far below the resonance.
- Inverse dynamics: no hook, so neither effect is a candidate. Torques are computed at the measured motion. A
  deflection changes the pose by milliradians. The acceleration of the rotor relative to the joint would need
  the fourth derivative of a measured position.

At size 0 the rotor stands still beside the robot, and the motor turns the joint itself: no bit of the motion
changes. A rotor in the world, not in the link, is the usual model of an elastic joint: it leaves out the
gyroscopic torques of the rotor, as armature does.
"""

from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np

from simgap.arrays import Array, Flags
from simgap.effects.effect import Effect, Family, Fields, Rotor, Size, State
from simgap.effects.joint import mjcf_joint
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
class Backlash(Effect):
    """Free angle between rotor and joint, with hard flanks.

    MuJoCo realisation: a limited tendon over rotor and joint. Its damping acts on the flanks only, so that
    the rotor is free between them.
    """

    name: ClassVar[str] = "backlash"
    family: ClassVar[Family] = Family.TRANSMISSION
    place: str
    index: int
    """Index of the joint in the robot."""
    encoder_is_at_output: bool
    typical_rad: float
    high_rad: float

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Whole free angle."""
        return (Size("backlash_rad", 0.0, self.high_rad, self.typical_rad),)

    def vary(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add the rotor."""
        _add_rotor(spec, robot, self.place)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Let the motor turn the rotor, and limit the angle between rotor and joint."""
        rows = size[:, 0] != 0
        half_rad = size[rows] / 2 * np.array((-1.0, 1.0))
        _connect(fields, robot, self.index, rows, self.encoder_is_at_output)
        gear = fields.batch.model.tendon(_gear(self.place)).id
        fields.batch.expand("tendon_lengthspring")[rows, gear] = half_rad
        is_rigid = fields.batch.expand("tendon_stiffness")[rows, gear] == 0
        fields.batch.expand("tendon_range")[np.flatnonzero(rows)[is_rigid], gear] = half_rad[is_rigid]

    def deflection_rad(self, size: Array, state: State) -> Array:
        """Return half the backlash against the load: the output lies on the flank that carries it."""
        return np.asarray(-0.5 * size[:, 0] * np.sign(state.load_Nm[:, self.index]))


@dataclass(frozen=True, slots=True)
class JointCompliance(Effect):
    """Elastic gear between rotor and joint.

    MuJoCo realisation: a tendon spring over rotor and joint; backlash at the same joint is its dead band. A
    gear that is stiffer than the time step resolves has the stiffness that it resolves.
    """

    name: ClassVar[str] = "joint compliance"
    family: ClassVar[Family] = Family.TRANSMISSION
    place: str
    index: int
    encoder_is_at_output: bool
    typical_rad_Nm: float
    high_rad_Nm: float

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Deflection per torque."""
        return (Size("compliance_rad_Nm", 0.0, self.high_rad_Nm, self.typical_rad_Nm),)

    def describe(self, size: Array) -> str:
        """Return the stiffness too, which data sheets give."""
        stiffness = f" (stiffness {1 / size[0]:.4g} N m/rad)" if size[0] > 0 else ""
        return f"compliance_rad_Nm = {size[0]:.4g}{stiffness}"

    def vary(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add the rotor."""
        _add_rotor(spec, robot, self.place)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Let the motor turn the rotor, and put the spring between rotor and joint."""
        rows = size[:, 0] != 0
        _connect(fields, robot, self.index, rows, self.encoder_is_at_output)
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
    """Add a rotor that stands still beside the robot, and a tendon over it that does nothing yet."""
    if spec.joint(_rotor(joint)) is not None:
        return
    inertia_kgm2 = ROTOR_SHARE * float(robot.model.dof_M0[robot.joint(joint).dof_index])
    turned = spec.joint(mjcf_joint(robot, joint))
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


def _connect(fields: Fields, robot: Robot, index: int, rows: Flags, encoder_is_at_output: bool) -> None:
    """Let the motor turn the rotor."""
    place = robot.joints[index].name
    fields.rotors.append(Rotor(index, _rotor(place), rows, encoder_is_at_output))
