"""Actuators and their sensors that differ from the drawing."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from fsw.dictionary.joints import Joint
from fsw.dictionary.params import JointParams, Params
from sim.effects.effect import Effect, Hardware, at_index


@dataclass(frozen=True, slots=True)
class HardstopAngle(Effect):
    """The negative hardstop is off its place by an angle; so is the encoder zero that is found from it."""

    joint: Joint
    shift_rad: float

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Shift the lower end of the output's travel."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_output")
        tendon.springlength = tendon.springlength + np.array([self.shift_rad, 0.0])

    def on_params(self, params: Params) -> Params:
        """The true place of the hardstop."""
        joint = _joint(params, self.joint)
        return _with_joint(
            params, self.joint, replace(joint, hardstop_rad=joint.hardstop_rad + self.shift_rad)
        )


@dataclass(frozen=True, slots=True)
class HardstopStiffness(Effect):
    """The stiffness of the hardstops of a joint, times a factor."""

    joint: Joint
    factor: float

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the spring at both ends of the output's travel."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_output")
        tendon.stiffness = tendon.stiffness * self.factor

    def on_params(self, params: Params) -> Params:
        """The true stiffness."""
        joint = _joint(params, self.joint)
        stiffness = joint.hardstop_stiffness_Nm_rad * self.factor
        return _with_joint(params, self.joint, replace(joint, hardstop_stiffness_Nm_rad=stiffness))


@dataclass(frozen=True, slots=True)
class ResolverBias(Effect):
    """A resolver reads too much by an angle."""

    joint: Joint
    bias_rad: float

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Bias of the reading."""
        return replace(
            hardware, resolver_bias_rad=at_index(hardware.resolver_bias_rad, self.joint, self.bias_rad)
        )


@dataclass(frozen=True, slots=True)
class BacklashWidth(Effect):
    """The dead band of a gear, times a factor."""

    joint: Joint
    factor: float

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the dead band of the gear tendon."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_gear")
        tendon.springlength = tendon.springlength * self.factor

    def on_params(self, params: Params) -> Params:
        """The true width."""
        joint = _joint(params, self.joint)
        return _with_joint(params, self.joint, replace(joint, backlash_rad=joint.backlash_rad * self.factor))


@dataclass(frozen=True, slots=True)
class GearStiffness(Effect):
    """The torsional stiffness of a gear, times a factor."""

    joint: Joint
    factor: float

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale spring and damper of the gear tendon."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_gear")
        tendon.stiffness = tendon.stiffness * self.factor
        tendon.damping = tendon.damping * self.factor

    def on_params(self, params: Params) -> Params:
        """The true stiffness."""
        joint = _joint(params, self.joint)
        stiffness = joint.gear_stiffness_Nm_rad * self.factor
        return _with_joint(params, self.joint, replace(joint, gear_stiffness_Nm_rad=stiffness))


@dataclass(frozen=True, slots=True)
class GearFriction(Effect):
    """Coulomb and viscous friction of motor and gear, times a factor."""

    joint: Joint
    factor: float

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the friction of the motor hinge."""
        motor = spec.joint(f"{self.joint.name.lower()}_motor")
        motor.frictionloss *= self.factor
        motor.damping *= self.factor


def _joint(params: Params, joint: Joint) -> JointParams:
    found: JointParams = getattr(params.joints, joint.name.lower())
    return found


def _with_joint(params: Params, joint: Joint, changed: JointParams) -> Params:
    return replace(params, joints=replace(params.joints, **{joint.name.lower(): changed}))
