"""Effects on gears, hardstops and resolvers of the joints."""

from dataclasses import dataclass, replace
from typing import Annotated

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from sim.disturbance import at_joint
from sim.effects.effect import Effect, Factor, Hardware, ParameterSpec, SmallAngle
from sim.effects.flight_params import joint_of, with_joint


@dataclass(frozen=True, slots=True)
class HardstopAngle(Effect):
    """Angle of the negative hardstop beyond that of the drawing; it shifts the encoder zero too."""

    joint: Joint
    shift_rad: SmallAngle

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Shift the lower end of the travel of the output."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_output")
        tendon.springlength = tendon.springlength + np.array([self.shift_rad, 0.0])

    def on_params(self, params: Params) -> Params:
        """Set the true angle of the hardstop."""
        joint = joint_of(params, self.joint)
        return with_joint(
            params, self.joint, replace(joint, hardstop_rad=joint.hardstop_rad + self.shift_rad)
        )


@dataclass(frozen=True, slots=True)
class HardstopStiffness(Effect):
    """Factor on the stiffness of the hardstops of a joint."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the spring at both ends of the travel of the output."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_output")
        tendon.stiffness = tendon.stiffness * self.factor

    def on_params(self, params: Params) -> Params:
        """Set the true stiffness."""
        joint = joint_of(params, self.joint)
        stiffness = joint.hardstop_stiffness_Nm_rad * self.factor
        return with_joint(params, self.joint, replace(joint, hardstop_stiffness_Nm_rad=stiffness))


@dataclass(frozen=True, slots=True)
class ResolverBias(Effect):
    """Constant error of a resolver."""

    joint: Joint
    bias_rad: SmallAngle

    def on_hardware(self, hardware: Hardware) -> Hardware:
        """Add to the bias of the reading."""
        bias_rad = hardware.resolver_bias_rad + at_joint(self.joint, self.bias_rad)
        return replace(hardware, resolver_bias_rad=bias_rad)


@dataclass(frozen=True, slots=True)
class BacklashWidth(Effect):
    """Factor on the backlash of a gear."""

    joint: Joint
    factor: Annotated[float, ParameterSpec(0.0, 5.0, unit="1", typical=0.1, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the dead band of the gear tendon."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_gear")
        tendon.springlength = tendon.springlength * self.factor

    def on_params(self, params: Params) -> Params:
        """Set the true width."""
        joint = joint_of(params, self.joint)
        return with_joint(params, self.joint, replace(joint, backlash_rad=joint.backlash_rad * self.factor))


@dataclass(frozen=True, slots=True)
class GearStiffness(Effect):
    """Factor on the torsional stiffness of a gear."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale spring and damper of the gear tendon."""
        tendon = spec.tendon(f"{self.joint.name.lower()}_gear")
        tendon.stiffness = tendon.stiffness * self.factor
        tendon.damping = tendon.damping * self.factor

    def on_params(self, params: Params) -> Params:
        """Set the true stiffness."""
        joint = joint_of(params, self.joint)
        stiffness = joint.gear_stiffness_Nm_rad * self.factor
        return with_joint(params, self.joint, replace(joint, gear_stiffness_Nm_rad=stiffness))


@dataclass(frozen=True, slots=True)
class GearFriction(Effect):
    """Factor on Coulomb and viscous friction of motor and gear."""

    joint: Joint
    factor: Factor

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the friction of the motor hinge."""
        motor = spec.joint(f"{self.joint.name.lower()}_motor")
        motor.frictionloss *= self.factor
        motor.damping *= self.factor
