"""Stop the arm with a monitor on the ground, before flight software finds that a joint is stuck."""

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from marsarm import CycleRecord, Joint, MoveJoint, nominal_params, run_commands, start_loop

READY_RAD = nominal_params().poses.ready_rad


@dataclass(slots=True)
class LagMonitor:
    """Monitor of the angle by which a motor lags behind its set-point."""

    joint: Joint
    bound_rad: float
    persistence: int = 4
    count: int = 0

    def __call__(self, record: CycleRecord) -> bool:
        """Return whether the bound was passed in this many cycles in a row."""
        joint = record.outputs.joint
        lag_rad = abs(joint.setpoint_rad[self.joint] - joint.motor_rad[self.joint])
        self.count = self.count + 1 if lag_rad > self.bound_rad else 0
        return self.count >= self.persistence


figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for name, monitor in (
    ("flight software alone", lambda _: False),
    ("with the monitor", LagMonitor(Joint.ELBOW, 2e-4)),
):
    loop = start_loop("as-built:7", effects=["joint-seized:elbow:at_s=7"], start_rad=READY_RAD)
    goal_rad = READY_RAD[Joint.ELBOW] + 0.2
    result = run_commands(loop, MoveJoint(Joint.ELBOW, goal_rad), stop_when=monitor)
    time_s, current_A = result.series("sensors.current_A")
    axes.plot(time_s, current_A[:, Joint.ELBOW], label=f"{name}: {result.outcome}")
    print(f"{name}: {result.outcome} after {time_s[-1]:.2f} s, peak {np.abs(current_A).max():.2f} A")
axes.set(title="A joint that gets stuck", xlabel="time [s]", ylabel="current of the elbow motor [A]")
axes.legend()
figure.savefig("own_monitor.png", dpi=100)
