"""Stop the arm with a monitor of your own: the drill may not go below a height."""

from dataclasses import dataclass

import matplotlib.pyplot as plt

from marsarm import CycleRecord, Joint, MoveJoint, nominal_params, run_commands, start_loop

READY_RAD = nominal_params().poses.ready_rad
FLOOR_M = -0.55


@dataclass(frozen=True, slots=True)
class Floor:
    """Monitor of the estimated height of the tool above the origin of the rover frame."""

    lowest_m: float

    def __call__(self, record: CycleRecord) -> bool:
        """Return whether the tool is too low; cycles without a new estimate pass."""
        tool = record.outputs.tool
        return tool is not None and -tool.p_RoTo_R_m[2] < self.lowest_m


figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for name, lowest_m in (("without the monitor", -10.0), ("with the monitor", FLOOR_M)):
    loop = start_loop("as-built:7", start_rad=READY_RAD)
    lower = MoveJoint(Joint.ELEVATION, READY_RAD[Joint.ELEVATION] + 0.3)
    result = run_commands(loop, lower, stop_when=Floor(lowest_m))
    time_s, p_RoTo_R_m = result.series("outputs.tool.p_RoTo_R_m")
    axes.plot(time_s, -p_RoTo_R_m[:, 2], label=f"{name}: {result.outcome}")
    print(f"{name}: {result.outcome} after {time_s[-1]:.2f} s, lowest {-p_RoTo_R_m[:, 2].max():.3f} m")
axes.axhline(FLOOR_M, color="gray", linestyle=":", label="lowest allowed height")
axes.set(
    title="The arm goes down until its monitor stops it", xlabel="time [s]", ylabel="height of the drill [m]"
)
axes.legend()
figure.savefig("own_monitor.png", dpi=100)
