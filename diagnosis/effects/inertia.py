"""Errors of masses and inertias."""

from dataclasses import dataclass
from typing import ClassVar

from diagnosis.arrays import Array
from diagnosis.effects.effect import Family, Fields, Size
from diagnosis.effects.joint import JointEffect
from diagnosis.robot import Robot


@dataclass(frozen=True, slots=True)
class Armature(JointEffect):
    """Inertia of the rotor, seen at the joint, beside that of the model."""

    name: ClassVar[str] = "armature"
    family: ClassVar[Family] = Family.INERTIA

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Inertia: at most what takes the whole torque at the highest acceleration, at least none at all."""
        scale = self.scales.torque_Nm / self.scales.acceleration_rad_s2
        return (Size("armature_kgm2", -self.scales.armature_kgm2, scale, 0.05 * scale),)

    def set_model(self, size: Array, fields: Fields, robot: Robot) -> None:
        """Add to the armature."""
        fields.armature_kgm2[:, self.index] += size[:, 0]
