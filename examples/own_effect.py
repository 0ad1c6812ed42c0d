"""Add a dent to the bearing of the elbow, and see it in the motor current."""

from dataclasses import dataclass
from typing import Annotated

import matplotlib.pyplot as plt
import numpy as np

from marsarm import (
    Disturbance,
    EachCycle,
    Hardware,
    Joint,
    MoveJoint,
    ParameterSpec,
    Plant,
    at_joint,
    nominal_params,
    run_commands,
    start_loop,
)

READY_RAD = nominal_params().poses.ready_rad
DENT_RAD = READY_RAD[Joint.ELBOW] + 0.1


@dataclass(frozen=True, slots=True)
class Dent(EachCycle):
    """Dent in the bearing of an output; a torque up to this one leaves it."""

    joint: Joint
    torque_Nm: Annotated[float, ParameterSpec(0.0, 100.0, unit="N m", typical=10.0, neutral=0.0)]
    angle_rad: Annotated[float, ParameterSpec(-6.5, 6.5, unit="rad", typical=0.0)]
    width_rad: Annotated[float, ParameterSpec(1e-3, 1.0, unit="rad", typical=0.02)] = 0.02

    def cycle(self, plant: Plant, hardware: Hardware, state: None) -> tuple[None, Disturbance]:
        """Return the torque, which is largest one width from the dent."""
        beside = (float(plant.output_rad()[self.joint]) - self.angle_rad) / self.width_rad
        torque_Nm = -self.torque_Nm * beside * float(np.exp(0.5 - 0.5 * beside**2))
        return None, Disturbance(output_Nm=at_joint(self.joint, torque_Nm))


def main() -> None:
    """Move the elbow over the dent; in a function, because `--effect` takes this file too."""
    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    currents = []
    for name, effects in (("nominal arm", ()), ("arm with the dent", (Dent(Joint.ELBOW, 10.0, DENT_RAD),))):
        loop = start_loop("nominal", effects=effects, start_rad=READY_RAD)
        result = run_commands(loop, MoveJoint(Joint.ELBOW, READY_RAD[Joint.ELBOW] + 0.2))
        current_A = result.series("sensors.current_A")[1][:, Joint.ELBOW]
        currents.append(np.convolve(current_A, np.full(16, 1 / 16), "same"))
        axes.plot(np.degrees(result.series("truth.output_rad")[1][:, Joint.ELBOW]), currents[-1], label=name)
    print(f"the dent changes the current by {np.abs(currents[1] - currents[0]).max():.3f} A")
    axes.axvline(np.degrees(DENT_RAD), color="gray", linestyle=":", label="place of the dent")
    axes.set(title="Elbow over a dent of 10 N m", xlabel="elbow angle [deg]", ylabel="motor current [A]")
    axes.legend()
    figure.savefig("own_effect.png", dpi=100)


if __name__ == "__main__":
    main()
