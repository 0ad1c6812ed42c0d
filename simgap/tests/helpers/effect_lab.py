"""Small robots for tests of effects, and the model as an effect changes it."""

import math

import mujoco
import mujoco.batch
import numpy as np

from simgap.logs import JointLog, Motion, Signal
from simgap.robot import ControlMode, Robot, RobotJoint
from simgap.simulation.compiled import Models, nominal_fields
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import Window

ARM_XML = """
<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="base">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="turntable" pos="0 0 0.1">
        <joint name="pan" axis="0 0 1" damping="0.3" frictionloss="0.05" armature="0.02"/>
        <inertial pos="0.01 0 0.02" mass="0.2" diaginertia="2e-4 2e-4 1e-4"/>
        <body name="upper arm" pos="0.02 0 0.05">
          <joint name="lift" axis="0 1 0" damping="0.3" frictionloss="0.05" armature="0.02"/>
          <inertial pos="0.08 0.01 -0.02" quat="0.9 0.1 0.3 0.2" mass="0.3" diaginertia="5e-4 4e-4 3e-4"/>
          <body name="forearm" pos="0.15 0 -0.03">
            <joint name="elbow" axis="0 1 0" damping="0.2" frictionloss="0.04" armature="0.01"/>
            <inertial pos="0.06 0 0.01" mass="0.15" diaginertia="1e-4 3e-4 3e-4"/>
            <site name="tool" pos="0.14 0 0.02"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="pan" kp="20" kv="0.5" forcerange="-3 3"/>
    <position name="lift" joint="lift" kp="20" kv="0.5" forcerange="-3 3"/>
    <position name="elbow" joint="elbow" kp="10" kv="0.3" forcerange="-2 2"/>
  </actuator>
</mujoco>
"""

PENDULUM_XML = """
<mujoco model="pendulum">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="rod">
      <joint name="swing" axis="0 1 0" damping="0.02" armature="0.01"/>
      <inertial pos="0 0 -0.2" mass="0.5" diaginertia="1e-3 1e-3 1e-4"/>
      <site name="tool" pos="0 0 -0.3"/>
    </body>
  </worldbody>
  <actuator><position name="swing" joint="swing" kp="10" kv="0.3" forcerange="-5 5"/></actuator>
</mujoco>
"""


OWN = """
from dataclasses import dataclass
from simgap.effects.effect import Effect, Family, JointEffect, Size

@dataclass(frozen=True, slots=True)
class Mine(JointEffect):
    name = "mine"
    family = Family.EXTERNAL

    @property
    def sizes(self):
        return {sizes}

    {hook}
"""
HOOK = "def torque_Nm(self, size, state): return size[:, 0] + 0.0 * state.time_s"


def own_effect(sizes='(Size("push_Nm", 0.0, 1.0, 0.1),)', hook=HOOK):
    """Return the text of a file with an effect of the user's own."""
    return OWN.format(sizes=sizes, hook=hook)


def robot_of(xml, tool_site="tool", mode=ControlMode.POSITION):
    """Return a robot whose joints all have an actuator in the order of the joints."""
    model = mujoco.MjModel.from_xml_string(xml)
    joints = tuple(
        RobotJoint(
            name=model.joint(k).name,
            qpos_index=int(model.jnt_qposadr[k]),
            dof_index=int(model.jnt_dofadr[k]),
            actuator_index=k,
            mode=mode,
            kp_Nm_rad=float(model.actuator_gainprm[k, 0]),
            kd_Nms_rad=float(-model.actuator_biasprm[k, 2]),
            torque_limit_Nm=float(model.actuator_forcerange[k, 1]),
            is_loaded_by_gravity=model.joint(k).name != "pan",
        )
        for k in range(model.njnt)
    )
    name = xml.split('model="')[1].split('"')[0]
    return Robot(name, model, xml, joints, 5 * model.opt.timestep, tool_site)


def changed(robot, effects, sizes):
    """Return one simulation for each row of the sizes of all effects one after the other."""
    spec = mujoco.MjSpec.from_string(robot.model_xml)
    for effect in effects:
        if effect.overrides("vary"):
            effect.vary(spec, robot)
    batch = mujoco.batch.Batch(spec.compile(), nsim=len(sizes), nthread=1)
    fields = nominal_fields(robot, batch.nsim, batch)
    table, first = np.asarray(sizes, float), 0
    for effect in effects:
        number = len(effect.sizes)
        if effect.overrides("set_model"):
            effect.set_model(table[:, first : first + number], fields, robot)
        first += number
    batch.set_const()
    return batch


def inverse_Nm(model, seed, n=5):
    """Return the joint torques of random motions by inverse dynamics, (n, nv)."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    torques = []
    for _ in range(n):
        data.qpos[:] = rng.uniform(-1, 1, model.nq)
        data.qvel[:] = rng.uniform(-2, 2, model.nv)
        data.qacc[:] = rng.uniform(-5, 5, model.nv)
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse.copy())
    return np.array(torques)


def simulate(robot, effects, sizes, command, start_rad, temperature_degC=None):
    """Return what the encoders show at each control period, (n_candidates, n_joints, n_ticks).

    Args:
        robot: Robot.
        effects: Effects of all candidates.
        sizes: Sizes of all effects one after the other, a row a candidate.
        command: Command in each control period, (n_ticks, n_joints); the first one holds before.
        start_rad: Positions at the start, at rest, (n_joints,).
        temperature_degC: Temperatures, (n_joints,); None where they are not logged.
    """
    n_lead, n_ticks, n_joints = 50, *command.shape
    time_s = robot.control_period_s * np.arange(n_ticks)
    window = Window(
        motion="test",
        start_s=0.0,
        q_rad=np.asarray(start_rad, float),
        v_rad_s=np.zeros(n_joints),
        command=np.vstack((np.tile(command[0], (n_lead, 1)), command)),
        n_lead=n_lead,
        enabled=np.ones((n_ticks, n_joints), bool),
        gain=np.ones(n_joints),
        temperature_degC=np.full(n_joints, math.nan) if temperature_degC is None else temperature_degC,
        sample_time_s=(time_s,) * n_joints,
        measured_rad=(np.zeros(n_ticks),) * n_joints,
    )
    engine = Engine(Models(robot), effects, [window], n_threads=1)
    return engine.positions(np.asarray(sizes, float)).reshape(len(sizes), n_joints, n_ticks)


def motion_of(robot, time_s, position, command, name="m", repeat=""):
    """Return a motion of all joints, with positions and commands (n, n_joints) at the same times (n,)."""
    columns = zip(robot.joints, position.T, command.T, strict=True)
    logs = {one.name: JointLog(Signal(time_s, at), command=Signal(time_s, to)) for one, at, to in columns}
    return Motion(name, logs, {}, repeat)


def play(model, runtime, command, start_rad, every=1):
    """Return what the encoders show at each command of a patched model, (n, n_joints).

    Args:
        model: Patched model.
        runtime: Its effects at run time.
        command: Commands, (n, n_joints).
        start_rad: What the encoders show at the start, at rest, (n_joints,).
        every: Control periods in which a command is held.
    """
    data, shown = mujoco.MjData(model), [start_rad]
    runtime.place(data, start_rad)
    for one in command[:-1]:
        for _ in range(every):
            runtime.act(model, data, one)
            mujoco.mj_step(model, data, runtime.n_steps)
        shown.append(runtime.shown(data))
    return np.array(shown)
