"""Plant: the MuJoCo model of arm and world, its state and its time steps."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array, Pose, screw_exp
from sim.frames import FLIP, P_NR_M
from sim.mujoco_settings import (
    MOTOR_CONSTANT,
    RATE_GAIN,
    REFERENCE_STEP_S,
    apply_settings,
    change_gains,
    keep_pad_springs,
    match_reference_damping,
    read_pad_springs,
    read_servos,
)
from sim.record import LINK_BODIES, NO_DISTURBANCE, Disturbance, MoveDisturbance, Truth, no_move_disturbance
from simgap.common.errors import UserError

JOINT_NAMES = tuple(joint.name.lower() for joint in Joint)
SPRING_NAMES = ("rover", "link1", "link2", "link3", "link4")
SCREW_AXES = ("rx", "ry", "rz", "tx", "ty", "tz")
"""Axes of screws and springs: rotations, then translations."""

HARD_FRICTION = 5e-5
"""Factor on the inverse weight of dry friction. Held by it, an output creeps in hours; with 1, in seconds."""

SETTLE_S = 4.0
"""Time on the brakes in which loads rise. In twice as long, outputs would end 4 urad away at most."""

ALL_ACTUATORS = 0b111110
"""Bits of the actuator groups 1 to 5 of the motors; a set bit means no power."""

apply_settings()


class PlantDiverged(UserError, RuntimeError):
    """Warning of MuJoCo, which may have reset the state; later states are invalid."""


@dataclass(frozen=True, slots=True, eq=False)
class Addresses:
    """Indices of the arm in MuJoCo's arrays; joint arrays in the order of Joint."""

    motor: NDArray[np.intp]
    """Hinges; an index of positions is also one of speeds, as every joint has one degree of freedom."""
    gear: NDArray[np.intp]
    gear_tendons: NDArray[np.intp]
    output_tendons: NDArray[np.intp]
    """Tendons of the outputs, with friction and hardstops."""
    actuators: NDArray[np.intp]
    brake: NDArray[np.intp]
    springs: NDArray[np.intp]
    """Springs of rover and links, from the rover outward, shape (5, 6), rotations first."""
    tools: NDArray[np.intp]
    """Sites, in the order of `Plant.tools`."""
    pads: NDArray[np.intp]
    """Sites, in the order of `Plant.switches`."""
    bodies: NDArray[np.intp]
    """Frame bodies: LINK_BODIES, then those of the tools."""


@dataclass(frozen=True, slots=True, eq=False)
class StateViews:
    """Views of MuJoCo's arrays, which change with every step; in the order of Joint."""

    motor_rad: Array
    motor_rate_rad_s: Array
    gear_rad: Array
    """Output less motor angle."""
    gear_length_rad: Array
    """Output less motor angle when MuJoCo last computed the tendons of the gears."""
    low_flank_rad: Array
    high_flank_rad: Array
    gear_stiffness_Nm_rad: Array
    servo_angle_rad: Array
    """Motor angles that the motor controllers use."""
    servo_rate_rad_s: Array
    """Motor rates that the motor controllers use."""
    motor_torque_Nm: Array
    setpoint_rad: Array
    setpoint_rate_rad_s: Array
    warnings: NDArray[np.int32]
    """Counts of MuJoCo's warnings, by kind."""


class Plant:
    """MuJoCo model and data of an arm in its world, as avionics and judges access them."""

    def __init__(self, model: mujoco.MjModel):
        self.model = model = copy(model)  # changed below; two plants of one model are equal
        self.data = mujoco.MjData(model)
        rate_gain = model.actuator_gainprm[:, RATE_GAIN].copy()
        gear_excess_s = match_reference_damping(model)
        self._rate_share = rate_gain / model.actuator_gainprm[:, RATE_GAIN]
        self._lead_s = (model.opt.timestep - REFERENCE_STEP_S) / 2
        # the dual solver evaluates a servo at the start of a step: its torque at the end is that of the next
        self._late_s = model.opt.timestep if model.opt.solver == mujoco.mjtSolver.mjSOL_PGS else 0.0
        self.steps_per_cycle = round(1.0 / (CYCLE_HZ * model.opt.timestep))
        if not np.isclose(self.steps_per_cycle * model.opt.timestep * CYCLE_HZ, 1.0, rtol=1e-12):
            raise ValueError(f"time step {model.opt.timestep} s does not divide a cycle of 1/{CYCLE_HZ} s")
        of_steps = np.arange(self.steps_per_cycle) - (self.steps_per_cycle - 1) / 2
        self._middle_s = (model.opt.timestep * of_steps).tolist()
        turret = model.body("turret").id
        self.tools = tuple(model.body(k).name for k in np.flatnonzero(model.body_parentid == turret))
        """Names of the tools: the bodies on the turret."""
        touch = np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_TOUCH)
        self.switches = tuple(model.sensor(k).name for k in touch)
        """Names of the contact switches, in the order of the sensor word."""
        self.frame_bodies = (*LINK_BODIES, *self.tools)
        # full arrays for axes and origins of all tools: broadcasting would take twice as long
        self._flip_rows = np.tile(FLIP[:, None], (len(self.tools), 1, 3))
        self._flip = np.tile(FLIP, (len(self.tools), 1))
        self._p_NR_m = np.tile(P_NR_M, (len(self.tools), 1))
        self.at = Addresses(
            motor=np.array([model.joint(f"{name}_motor").qposadr[0] for name in JOINT_NAMES]),
            gear=np.array([model.joint(f"{name}_gear").qposadr[0] for name in JOINT_NAMES]),
            gear_tendons=np.array([model.tendon(f"{name}_gear").id for name in JOINT_NAMES]),
            output_tendons=np.array([model.tendon(f"{name}_output").id for name in JOINT_NAMES]),
            actuators=np.array([model.actuator(name).id for name in JOINT_NAMES]),
            brake=np.array([model.equality(f"{name}_brake").id for name in JOINT_NAMES]),
            springs=np.array(
                [[model.joint(f"{s}_{axis}").qposadr[0] for axis in SCREW_AXES] for s in SPRING_NAMES]
            ),
            tools=np.array([model.site(tool).id for tool in self.tools]),
            pads=np.array([model.site(switch).id for switch in self.switches]),
            bodies=np.array([model.body(name).id for name in self.frame_bodies]),
        )
        self._built_quat = model.body_quat[self.at.bodies]
        self._built = Pose(rotation_matrices(self._built_quat), model.body_pos[self.at.bodies].T.copy())
        self._bands_rad = model.tendon_lengthspring[self.at.gear_tendons].copy()
        self._free_damping_Nms_rad = model.tendon_damping[self.at.gear_tendons].copy()
        added_Nms_rad = gear_excess_s * model.tendon_stiffness[self.at.gear_tendons]
        self._flank_damping_Nms_rad = self._free_damping_Nms_rad - added_Nms_rad
        self._on_flank = np.zeros(len(Joint), bool).tobytes()
        self._friction_Nm = model.dof_frictionloss[self.at.motor].copy()
        self._damping_Nms_rad = model.dof_damping[self.at.motor].copy()
        self._pad_springs = read_pad_springs(model)
        self._servos = read_servos(model, self.at.actuators)
        self.move_disturbance = no_move_disturbance()
        self.disturbance = NO_DISTURBANCE
        self.model.tendon_invweight0[model.tendon_frictionloss > 0] *= HARD_FRICTION
        self.torque_constant_Nm_A = model.actuator_gainprm[self.at.actuators, MOTOR_CONSTANT].copy()
        self._views = self._make_views()

    def _make_views(self) -> StateViews:
        data, motors, gears = self.data, as_slice(self.at.motor), as_slice(self.at.gear)
        gear_tendons, actuators = as_slice(self.at.gear_tendons), as_slice(self.at.actuators)
        low_rad, high_rad = self.model.tendon_lengthspring[gear_tendons].T
        return StateViews(
            motor_rad=data.qpos[motors],
            motor_rate_rad_s=data.qvel[motors],
            gear_rad=data.qpos[gears],
            gear_length_rad=data.ten_length[gear_tendons],
            low_flank_rad=low_rad,
            high_flank_rad=high_rad,
            gear_stiffness_Nm_rad=self.model.tendon_stiffness[gear_tendons],
            servo_angle_rad=data.actuator_length[actuators],
            servo_rate_rad_s=data.actuator_velocity[actuators],
            motor_torque_Nm=data.actuator_force[actuators],
            setpoint_rad=data.ctrl[0::2],
            setpoint_rate_rad_s=data.ctrl[1::2],
            warnings=data.warning.number,
        )

    def duplicate(self) -> "Plant":
        """Copy the plant in its present state."""
        other = copy(self)
        other.model, other.data = copy(self.model), copy(self.data)
        other._views = other._make_views()
        return other

    @property
    def half_backlash_rad(self) -> Array:
        """Return half the width of the backlash, shape (5,)."""
        return np.asarray((self._views.high_flank_rad - self._views.low_flank_rad) / 2)

    def set_move_disturbance(self, move: MoveDisturbance) -> None:
        """Displace frames and gears from their built positions."""
        screw = np.stack([move.screw(name) for name in self.frame_bodies], axis=1)
        X = self._built @ screw_exp(screw)
        quat = self._built_quat.copy()
        for k in np.flatnonzero(screw.any(axis=0)):
            mujoco.mju_mat2Quat(quat[k], X.R[:, :, k].ravel())
        self.model.body_pos[self.at.bodies] = X.p.T
        self.model.body_quat[self.at.bodies] = quat
        self.move_disturbance = move
        self._shift_gears()

    def set_disturbance(self, disturbance: Disturbance) -> None:
        """Change the joints against their built state until the next call.

        An array that is the same object as before is not set again.
        """
        model, at, before = self.model, self.at, self.disturbance
        self.disturbance = disturbance
        if disturbance.friction_Nm is not before.friction_Nm:
            model.dof_frictionloss[at.motor] = np.maximum(self._friction_Nm + disturbance.friction_Nm, 0.0)
        if disturbance.damping_Nms_rad is not before.damping_Nms_rad:
            model.dof_damping[at.motor] = np.maximum(self._damping_Nms_rad + disturbance.damping_Nms_rad, 0.0)
        if disturbance.servo is not before.servo:
            change_gains(model, self._servos, disturbance.servo)
        # set always: a reset of MuJoCo's data removes it
        self.data.qfrc_applied[at.motor] = self.data.qfrc_applied[at.gear] = disturbance.output_Nm
        if disturbance.gear_rad is not before.gear_rad:
            self._shift_gears()

    def _shift_gears(self) -> None:
        shift_rad = self.move_disturbance.gear_rad + self.disturbance.gear_rad
        self.model.tendon_lengthspring[self.at.gear_tendons] = self._bands_rad + shift_rad[:, None]

    def place(
        self, motor_rad: Array, settle_s: float = SETTLE_S, begin: Callable[[], None] | None = None
    ) -> None:
        """Put the motors at these angles, (5,), with brakes on, and raise gravity and other loads from 0.

        `begin` is called once before, to begin effects. Outputs begin on the flanks that loads press them to,
        and loads rise without a jerk: what falls or swings would rest anywhere in the band of its friction.
        """
        model, data, at, views = self.model, self.data, self.at, self._views
        mujoco.mj_resetData(model, data)
        data.qpos[at.motor] = motor_rad
        self.command(motor_rad, np.zeros(len(Joint)))
        model.opt.disableactuator = ALL_ACTUATORS
        for joint in Joint:
            self.brake(joint, True)
        if begin is not None:
            begin()
        mujoco.mj_forward(model, data)
        gravity, applied_Nm = model.opt.gravity.copy(), data.qfrc_applied.copy()
        load_Nm = (applied_Nm - data.qfrc_bias)[at.gear]
        held_Nm = model.tendon_frictionloss[at.output_tendons] + model.tendon_frictionloss[at.gear_tendons]
        flank_rad = np.where(load_Nm > 0.0, views.high_flank_rad, views.low_flank_rad)
        data.qpos[at.gear] = np.where(np.abs(load_Nm) > held_Nm, flank_rad, 0.0)
        for share in np.linspace(0.0, 1.0, round(settle_s * CYCLE_HZ) + 1)[1:]:
            rise = share**3 * (10 - 15 * share + 6 * share**2)
            model.opt.gravity[:], data.qfrc_applied[:] = gravity * rise, applied_Nm * rise
            self.step()
        data.time = 0.0

    def show(self, output_rad: Array, strain: Array) -> None:
        """Set the geometry only, from output angles, shape (5,), and spring strains, (6, 5) or wider."""
        self.data.qpos[self.at.motor] = output_rad
        self.data.qpos[self.at.springs] = strain[:, : len(SPRING_NAMES)].T
        mujoco.mj_kinematics(self.model, self.data)

    def brake(self, joint: int, on: bool) -> None:
        """Lock a motor at its present angle, or release it."""
        self.model.eq_data[self.at.brake[joint], 0] = self.data.qpos[self.at.motor[joint]]
        self.data.eq_active[self.at.brake[joint]] = on

    def command(self, motor_rad: Array, rate_rad_s: Array) -> None:
        """Set the set-points of the motor controllers, each (5,), converted from those of the reference step.

        A servo compares its set-point with the angle at the start of a step, half a step too early. Only the
        feedback of its rate is reduced by the damping that the integrator adds.
        """
        self._views.setpoint_rad[:] = motor_rad - self._lead_s * rate_rad_s
        self._views.setpoint_rate_rad_s[:] = self._rate_share * rate_rad_s

    def step(self) -> None:
        """Advance the physics by one control cycle; the set-points, of its middle, move on at their rates.

        If they stood still, torques would follow a saw-tooth, and a cold motor would stop in every cycle.
        PlantDiverged says that MuJoCo counted a warning.
        """
        self.damp_gears()
        data, setpoint_rad, end_s = self.data, self._views.setpoint_rad, self.data.time + 1.0 / CYCLE_HZ
        angle_rad, rate_rad_s = setpoint_rad.copy(), self._views.setpoint_rate_rad_s / self._rate_share
        for by_s in self._middle_s:
            np.add(angle_rad, rate_rad_s * by_s, out=setpoint_rad)
            mujoco.mj_step(self.model, data)
            if data.ncon:
                keep_pad_springs(self.model, data, self._pad_springs)
        data.time = end_s  # a cycle is exact in binary, a step need not be
        setpoint_rad += rate_rad_s * self._late_s
        self.update_motors()
        setpoint_rad[:] = angle_rad
        self._check()

    def damp_gears(self) -> None:
        """Set the damping of the gears as the reference step does: other on a flank than in the backlash."""
        views = self._views
        length_rad = views.gear_length_rad
        on_flank = (length_rad < views.low_flank_rad) | (length_rad > views.high_flank_rad)
        if (flags := on_flank.tobytes()) != self._on_flank:
            self._on_flank = flags
            damping = np.where(on_flank, self._flank_damping_Nms_rad, self._free_damping_Nms_rad)
            self.model.tendon_damping[self.at.gear_tendons] = damping

    def update_motors(self) -> None:
        """Compute the motor torques of the present state; those of the last step belong to its start."""
        views = self._views
        views.servo_angle_rad[:], views.servo_rate_rad_s[:] = views.motor_rad, views.motor_rate_rad_s
        mujoco.mj_fwdActuation(self.model, self.data)

    def _check(self) -> None:
        if np.count_nonzero(self._views.warnings):
            names = [mujoco.mjtWarning(i).name for i in np.flatnonzero(self._views.warnings)]
            raise PlantDiverged(f"MuJoCo warned of {', '.join(names)} at {self.data.time:.3f} s")

    def motor_rad(self) -> Array:
        """Return the true motor angles, output side, shape (5,)."""
        return self._views.motor_rad.copy()

    def output_rad(self) -> Array:
        """Return the true output angles, shape (5,): motor, backlash and wind-up."""
        return np.asarray(self._views.motor_rad + self._views.gear_rad)

    def backlash_rad(self) -> Array:
        """Return the true position in the backlash, shape (5,): plus or minus half its width on a flank."""
        return self._within_backlash(self._gear_rad())

    def _within_backlash(self, gear_rad: Array) -> Array:
        return np.clip(gear_rad, -self.half_backlash_rad, self.half_backlash_rad)

    def gear_torque_Nm(self) -> Array:
        """Return the torque in each gear, shape (5,); a load towards positive angles is positive."""
        gear_rad = self._gear_rad()
        return np.asarray(self._views.gear_stiffness_Nm_rad * (gear_rad - self._within_backlash(gear_rad)))

    def _gear_rad(self) -> Array:
        """Return output less motor angles without the disturbances of the gears, shape (5,)."""
        return np.asarray(self._views.gear_rad - self.move_disturbance.gear_rad - self.disturbance.gear_rad)

    def stop_rad(self) -> Array:
        """Return the output angles of the negative hardstops, shape (5,)."""
        return np.asarray(self.model.tendon_lengthspring[self.at.output_tendons, 0])

    def stop_torque_Nm(self) -> Array:
        """Return the torque of each output on its negative hardstop, shape (5,)."""
        pressed = self.stop_rad() - self.output_rad()
        return np.asarray(self.model.tendon_stiffness[self.at.output_tendons] * np.maximum(pressed, 0.0))

    def built_friction(self) -> tuple[Array, Array]:
        """Return Coulomb friction [N m] and damping [N m s/rad] as built, each (5,), output side."""
        return self._friction_Nm, self._damping_Nms_rad

    def motor_current_A(self) -> Array:
        """Return the true motor currents, shape (5,)."""
        return np.asarray(self._views.motor_torque_Nm / self.torque_constant_Nm_A)

    def tool_shift(self, tool: str, output_rad: Array) -> Array:
        """Return the shift [m] of a tool in RMECH, shape (3,), by a small output change, shape (5,)."""
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian, None, self.at.tools[self.tools.index(tool)])
        return np.asarray(FLIP * (jacobian[:, self.at.gear] @ output_rad))

    def pads_R_m(self) -> Array:
        """Return the positions of the contact switches in RMECH, (n, 3), of the last call of `truth`."""
        return np.asarray(FLIP * self.data.site_xpos.take(self.at.pads, 0) - P_NR_M)

    def truth(self) -> Truth:
        """Update the forward kinematics and return the state of the plant."""
        model, data, tools = self.model, self.data, self.at.tools
        mujoco.mj_kinematics(model, data)
        mujoco.mj_energyVel(model, data)
        return Truth(
            time_s=data.time,
            motor_rad=self.motor_rad(),
            output_rad=self.output_rad(),
            motor_torque_Nm=data.actuator_force.copy(),
            p_RoTo_R_m=self._flip * data.site_xpos.take(tools, 0) - self._p_NR_m,
            R_RT=self._flip_rows * data.site_xmat.take(tools, 0).reshape(-1, 3, 3),
            contact_force_N=self._contact_force() if data.ncon else 0.0,
            kinetic_energy_J=float(data.energy[1]),
        )

    def _contact_force(self) -> float:
        force, total = np.zeros(6), 0.0
        for k in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, k, force)
            total += float(force[0])
        return total


def as_slice(addresses: NDArray[np.intp]) -> slice:
    """Convert evenly spaced addresses to a slice, which copies nothing; ValueError if they are not."""
    places = slice(addresses[0], addresses[-1] + 1, addresses[1] - addresses[0])
    if not np.array_equal(np.arange(addresses[-1] + 1)[places], addresses):
        raise ValueError(f"addresses {addresses.tolist()} in MuJoCo's arrays do not lie evenly")
    return places


def rotation_matrices(quat: Array) -> Array:
    """Convert MuJoCo's quaternions, shape (n, 4), to rotation matrices, shape (3, 3, n)."""
    R = np.zeros((len(quat), 9))
    for row, q in zip(R, quat, strict=True):
        mujoco.mju_quat2Mat(row, q)
    return np.moveaxis(R.reshape(-1, 3, 3), 0, -1)
