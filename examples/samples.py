"""Write logs of a robot that hides an effect: `python examples/samples.py servo`, `so101` or `tracker`.

Each is a folder of that name: an arm of two servos, whose elbow gets its commands 30 ms late; an SO-101 with
a cable that pulls at its wrist like a spring; a UR10 with poses of a tracker, and with an eccentric gear at
its elbow.
"""

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from simgap import Array, Link, Robot, read_arm

ROBOTS = Path(__file__).resolve().parents[1] / "models" / "robots"
NOISE_rad = 1.5e-3
"""One sigma of a position: a count of a 12-bit encoder."""
MODEL = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 0.5">
      <joint name="shoulder" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02"/>
      <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      <body pos="0.25 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.1" frictionloss="0.05" armature="0.02"/>
        <inertial pos="0.12 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="20" kv="1" forcerange="-20 20"/>
    <position name="elbow" joint="elbow" kp="20" kv="1" forcerange="-20 20"/>
  </actuator>
</mujoco>
"""
HEAD = """name = "{name}"
model = "model.xml"
time_step_s = {step_s}
control_rate_Hz = {rate_Hz}
time = {{ column = "t", unit = "s" }}
motion = {{ columns = ["motion"], repeat_column = "repeat" }}
"""
JOINT = """
[joints.{name}]
mode = "position"
command = {{ column = "command_{name}", unit = "rad" }}
position = {{ column = "position_{name}", unit = "rad" }}
"""


def write_servo(folder: Path) -> None:
    """Write an arm whose elbow gets its commands three rows late, until it is repaired."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    random = np.random.default_rng(1)
    time_s, commands = np.arange(0.0, 3.0, 0.01), []
    for _ in range(4):
        steps = random.uniform(-0.5, 0.5, (6, 2))
        commands.append(np.where(time_s[:, None] < 0.5, 0.0, steps[(2.0 * time_s).astype(int)]))

    def arrive(sent: Array) -> Array:
        late = np.vstack([np.zeros((3, 2)), sent[:-3]])
        return np.column_stack([sent[:, 0], late[:, 1]])

    (folder / "model.xml").write_text(MODEL)
    robot = HEAD.format(name="servo arm", step_s=0.005, rate_Hz=200.0)
    names = ("shoulder", "elbow")
    (folder / "robot.toml").write_text(robot + "".join(JOINT.format(name=name) for name in names))
    record(folder / "log.csv", model, names, time_s, commands, arrive, random)
    record(folder / "repaired.csv", model, names, time_s, commands, lambda sent: sent, random)


def write_so101(folder: Path) -> None:
    """Write model, robot file and log of an SO-101 with a spring of 0.6 N m/rad at its wrist."""
    given = ROBOTS / "so101"
    robot = Robot.from_toml(given / "robot.toml")
    spec = mujoco.MjSpec.from_string(robot.model_xml)
    for joint in robot.joints:
        spec.actuator(joint.name).set_to_position(kp=joint.kp_Nm_rad)
    model, names = spec.compile(), tuple(joint.name for joint in robot.joints)
    model.jnt_stiffness[names.index("wrist_flex")] = 0.6
    random, time_s = np.random.default_rng(1), np.arange(0.0, 5.0, 0.02)
    ramp = np.minimum(time_s, 1.0)[:, None]
    reach_rad = np.array([0.6, 0.3, 0.4, 0.6, 0.6, 0.3])
    commands = []
    for _ in range(4):
        speed, phase = 2.0 * np.pi * random.uniform(0.2, 0.9, 6), random.uniform(0.0, 2.0 * np.pi, 6)
        commands.append(ramp * reach_rad * np.sin(speed * time_s[:, None] + phase) + [0, 0, 0.5, 0, 0, 0.8])
    (folder / "model.xml").write_text((given / "model.xml").read_text())
    joints = (JOINT.format(name=name) + "kp_Nm_rad = 8.9\ntorque_limit_Nm = 3.35\n" for name in names)
    (folder / "robot.toml").write_text(
        HEAD.format(name="SO-101", step_s=0.01, rate_Hz=100.0) + "".join(joints)
    )
    record(folder / "log.csv", model, names, time_s, commands, lambda sent: sent, random)


def record(
    path: Path,
    model: mujoco.MjModel,
    names: Iterable[str],
    time_s: Array,
    commands: Iterable[Array],
    arrive: Callable[[Array], Array],
    random: np.random.Generator,
) -> None:
    """Stand in for a real arm, which moves by the commands that arrive; each motion is done twice."""
    model.opt.timestep = 0.0002  # a real arm has no time step
    model.dof_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)  # and its friction holds: that of MuJoCo creeps
    model.dof_solref[:, 0] = 2.0 * model.opt.timestep
    steps = round((time_s[1] - time_s[0]) / model.opt.timestep)
    rows = []
    for motion, sent in enumerate(one for one in commands for _ in range(2)):
        data = mujoco.MjData(model)
        data.qpos[:] = sent[0]
        arrived = arrive(sent)
        data.ctrl[:] = arrived[0]
        mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))  # it has come to rest
        for t, command, received in zip(time_s, sent, arrived, strict=True):
            shown = data.qpos + NOISE_rad * random.standard_normal(model.nq)
            rows.append((motion, motion // 2, t, *command, *shown))
            data.ctrl[:] = received
            mujoco.mj_step(model, data, steps)
    head = ("motion", "repeat", "t", *(f"{what}_{one}" for what in ("command", "position") for one in names))
    np.savetxt(path, rows, "%.6g", ",", header=",".join(head), comments="")


def write_tracker(folder: Path) -> None:
    """Write arm, robot file, mapping and poses of a UR10 with an eccentric gear at its elbow."""
    text = (ROBOTS / "ur10" / "arm.toml").read_text().replace("orders = 48", "orders = 4")
    (folder / "arm.toml").write_text(text.replace("periodic_rad = 3e-5", "periodic_rad = 2e-4"))
    links = read_arm(folder / "arm.toml").links
    names, random = [one.name for one in links], np.random.default_rng(1)
    q_rad = random.uniform(-2.5, 2.5, (300, 6))
    true_rad = q_rad + random.normal(0.0, 1e-3, 6)  # zeros of the encoders
    true_rad[:, names.index("elbow")] += 1e-3 * np.cos(q_rad[:, names.index("elbow")])
    R, p_m = Rotation.from_euler("z", 0.7), np.array([1.2, -2.0, 0.4])  # of the arm, from the tracker
    for k, link in enumerate(links):
        R, p_m = after_link(R, p_m, link, true_rad[:, k])
    p_m = p_m + R.apply([0.05, 0.0, 0.1])  # of the target, from the flange
    p_m = p_m + 5e-5 * random.standard_normal(p_m.shape)
    R = R * Rotation.from_rotvec(2e-4 * random.standard_normal(p_m.shape))
    columns = {"joints": names, "position": ["x", "y", "z"], "rotation": ["rx", "ry", "rz"]}
    head = ",".join(one for group in columns.values() for one in group)
    rows = np.column_stack([q_rad, 1e3 * p_m, R.as_rotvec()])
    np.savetxt(folder / "poses.csv", rows, "%.9g", ",", header=head, comments="")
    mapping = 'arm = "UR10"\n'
    for (name, group), more in zip(
        columns.items(), ("rad", "mm", 'rad"\nform = "rotation vector'), strict=True
    ):
        mapping += f'\n[{name}]\ncolumns = {group}\nunit = "{more}"\n'
    (folder / "mapping.toml").write_text(mapping)
    for name, arm in (("robot", "arm.toml"), ("again", "found/calibrated.toml")):
        robot = f'name = "UR10"\nserial_arm = "{arm}"\n\n[poses]\n"poses.csv" = "mapping.toml"\n'
        (folder / f"{name}.toml").write_text(robot)


def after_link(R: Rotation, p_m: Array, link: Link, q_rad: Array) -> tuple[Rotation, Array]:
    """Return the frame at the end of a link, for angles (n,) of its joint."""
    R = R * Rotation.from_euler("z", (q_rad + link.theta_rad)[:, None])
    p_m = p_m + R.apply([0.0, 0.0, link.d_m])
    R = R * Rotation.from_euler("y", link.beta_rad)
    p_m = p_m + R.apply([0.0, link.b_m, 0.0])
    R = R * Rotation.from_euler("x", link.alpha_rad)
    return R, p_m + R.apply([link.a_m, 0.0, 0.0])


KINDS = {"servo": write_servo, "so101": write_so101, "tracker": write_tracker}


def main(words: list[str]) -> None:
    """Write the samples of these kinds."""
    if not words or not set(words) <= set(KINDS):
        raise SystemExit(f"give one of {', '.join(KINDS)}")
    for kind in words:
        Path(kind).mkdir(exist_ok=True)
        KINDS[kind](Path(kind))
        print(f"{kind}/: {', '.join(sorted(one.name for one in Path(kind).iterdir()))}")


if __name__ == "__main__":
    main(sys.argv[1:])
