"""Record a log, replay it bit for bit, and replay it with a parameter changed."""

from pathlib import Path

import matplotlib.pyplot as plt

from marsarm import (
    CYCLE_HZ,
    Joint,
    MoveJoint,
    ReplayRequest,
    nominal_params,
    read_log,
    record_commands,
    replay,
    start_loop,
)

READY_RAD = nominal_params().poses.ready_rad

loop = start_loop("as-built:7", start_rad=READY_RAD)
record_commands("run.mcap", loop, MoveJoint(Joint.ELBOW, READY_RAD[Joint.ELBOW] + 0.2))
print(f"the log has {len(read_log('run.mcap')['/joint'])} cycles")

same = replay(ReplayRequest(Path("run.mcap")))
print(f"replay is identical: {same.differences.identical}")

Path("softer.toml").write_text("[joints.elbow]\ngear_stiffness_Nm_rad = 8e4\n")
changed = replay(ReplayRequest(Path("run.mcap"), params=Path("softer.toml")))
print("\n".join(changed.changed_params))

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for channel in changed.differences.channels:
    if channel.channel in ("/joint.output_rad", "/joint.setpoint_rad"):
        time_s = [tick / CYCLE_HZ for tick in range(channel.compared)]
        axes.plot(time_s, 1e6 * channel.profile, label=channel.channel)
axes.set(title="Replay with a softer elbow gear", xlabel="time [s]", ylabel="change [µrad]")
axes.legend()
figure.savefig("replay_log.png", dpi=100)
