"""Put the APXS of a calibrated arm on a rock, and plot joints and contact force."""

import matplotlib.pyplot as plt
import numpy as np

from marsarm import Placement, Surface, World, placement_commands, run_commands, start_loop

rock = Surface(p_N_m=(2.05, 0.1, -0.25), normal_N=(-0.5, 0.1, -0.85))
placement = Placement("apxs", rock.p_N_m, rock.normal_N)
loop = start_loop("calibrated:7", World(surface=rock))
result = run_commands(loop, *placement_commands(placement, stowed=True))
for at_s, event in result.evrs:
    print(f"{at_s:7.2f} s  {event.message}")
print(f"outcome: {result.outcome}")

figure, (joints, force) = plt.subplots(2, figsize=(8, 6), layout="constrained")
time_s, output_rad = result.series("truth.output_rad")
joints.plot(time_s, np.degrees(output_rad), label=["azimuth", "elevation", "elbow", "wrist", "turret"])
joints.set(title="Placement of the APXS on a rock", xlabel="time [s]", ylabel="joint angle [deg]")
joints.legend(ncols=5, fontsize="small")
force.plot(*result.series("truth.contact_force_N"), color="tab:red")
force.set(title="The touch", xlabel="time [s]", ylabel="contact force [N]")
force.set_xlim(time_s[-1] - 25, time_s[-1] - 10)
figure.savefig("closed_loop.png", dpi=100)
