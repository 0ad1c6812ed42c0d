"""Patch of a robot: its MJCF model with what was found, and a file for what MuJoCo cannot express.

The same hooks that the engine calls change the model here, so that both simulate the same robot.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, cast

import mujoco
import mujoco.batch
import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.common.files import atomic_write
from simgap.common.toml import toml_text
from simgap.effects.effect import RUN_HOOKS, Effect, Fields, Rotor
from simgap.patch.text import (
    BODY_OF,
    FOUND_FILE,
    MODEL_FILE,
    Change,
    change_text,
    effect_table,
    found_text,
    law_attributes,
    model_law,
    number_text,
)
from simgap.result import Diagnosis, Rival
from simgap.robot import Robot, RobotJoint
from simgap.simulation.compiled import HARD_IMPEDANCE, nominal_fields, powered_numbers

RUNTIME_FILE: Final = "runtime.toml"
FORMAT: Final = "robot runtime 2"
ATTRIBUTES: Final = {
    "body_pos": ("body", "pos"),
    "geom_pos": ("geom", "pos"),
    "tendon_lengthspring": ("tendon", "springlength"),
    "tendon_range": ("tendon", "range"),
    "tendon_stiffness": ("tendon", "stiffness"),
    "tendon_damping": ("tendon", "damping"),
}
"""Fields of a model that are an attribute of an element with a name."""
INERTIAL: Final = {
    "body_mass": "mass",
    "body_ipos": "pos",
    "body_iquat": "quat",
    "body_inertia": "diaginertia",
}
DERIVED: Final = ("body_sameframe", "body_simple", "dof_simplenum", "geom_sameframe")
"""Fields that the compiler computes from others."""


@dataclass(frozen=True, slots=True)
class Patch:
    """Patched model and what is left for the run."""

    model_xml: str
    runtime: str
    """Text of the runtime file; empty if there is nothing left."""
    found: str
    """Text of the file with which a later diagnosis starts."""


@dataclass(frozen=True, slots=True)
class _Numbers:
    """Numbers of a model after an effect; those of the joints are those of the controllers and motors."""

    joints: Mapping[str, Array]
    """By field, (n_joints,)."""
    model: Mapping[str, Array]
    """By field of MuJoCo."""


class _Recorder:
    """Batch that knows which fields were asked for."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._batch = mujoco.batch.Batch(model, 1, nthread=1)
        self.fields: dict[str, Array] = {}

    def expand(self, name: str) -> Array:
        """Return a field, which may be changed."""
        if name not in self.fields:
            self.fields[name] = self._batch.expand(name)
        return self.fields[name]


def save_patch(robot: Robot, diagnosis: Diagnosis, folder: Path) -> tuple[Path, ...]:
    """Write the files of a patch to a folder, made if need be; RobotError if MJCF cannot say an effect."""
    return write_patch(
        make_patch(robot, *diagnosis.of_model(), diagnosis.rivals, diagnosis.fitted_motions), folder
    )


def write_patch(made: Patch, folder: Path) -> tuple[Path, ...]:
    """Write the files of a patch to a folder, which is made if it is not there, and return them."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {MODEL_FILE: made.model_xml, RUNTIME_FILE: made.runtime, FOUND_FILE: made.found}
    written = [folder / name for name, text in files.items() if text]
    with ExitStack() as stack:  # all are written before the first replaces one of an earlier patch
        for path in written:
            stack.enter_context(atomic_write(path, "patch")).write(files[path.name].encode())
    if not made.runtime:
        (folder / RUNTIME_FILE).unlink(missing_ok=True)
    return tuple(written)


def make_patch(
    robot: Robot,
    effects: Sequence[Effect],
    sizes: Sequence[Sequence[float]],
    rivals: Sequence[Rival] = (),
    motions: Sequence[str] = (),
) -> Patch:
    """Return the patch of effects whose sizes are not 0, with rivals and the names of fitted motions.

    RobotError if MJCF cannot say an effect.
    """
    active = [
        (one, np.asarray(size, float))
        for effect, size in zip(effects, sizes, strict=True)
        for one in effect.parts
        if any(size)
    ]
    found = found_text(robot, effects, sizes, rivals, motions)
    text, varied = robot.model_xml, [effect for effect, _ in active if effect.overrides("vary")]
    if varied:
        spec = mujoco.MjSpec.from_string(text)
        for joint in robot.joints:  # an effect may copy them to what it adds
            of_joint = spec.joint(robot.mjcf_joint(joint.name))
            of_joint.solref_friction = (2 * robot.model.opt.timestep, 1.0)
            of_joint.solimp_friction = HARD_IMPEDANCE
        for effect in varied:
            effect.vary(spec, robot)
        for body in spec.bodies:
            if body.explicitinertial and np.isnan(body.ipos[0]):  # MuJoCo would not write its inertia
                body.ipos = (0.0, 0.0, 0.0)
        spec.compile()
        text = spec.to_xml()
    robot = _on_text(robot, text)
    recorder = _Recorder(robot.model)
    fields = nominal_fields(robot, 1, cast(Any, recorder))
    changes = [*_option_changes(robot), *_effect_changes(robot, active, fields, recorder)]
    rotors = {one.joint: one for one in fields.rotors if one.rows[0]}
    changes += _rotor_changes(robot, rotors.values(), _numbers(_with_powered(robot, fields), recorder))
    text = _changed(robot, text, changes)
    runtime = [(effect, size) for effect, size in active if effect.overrides(*RUN_HOOKS)]
    left = ""
    if runtime or rotors or fields.back_emf_Nms_rad.any():
        left = _runtime_text(robot, runtime, rotors, fields)
    return Patch(text, left, found)


def _on_text(robot: Robot, text: str) -> Robot:
    """Return a robot whose model is compiled from a text, with the same joints."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = robot.model.opt.timestep
    joints = []
    for joint in robot.joints:
        found = model.joint(robot.mjcf_joint(joint.name))
        joints.append(replace(joint, qpos_index=int(found.qposadr[0]), dof_index=int(found.dofadr[0])))
    return replace(robot, model=model, model_xml=text, joints=tuple(joints))


def _option_changes(robot: Robot) -> Iterator[Change]:
    """Yield the numerics of the diagnosis, without which the fitted numbers mean something else."""
    own, step_s = mujoco.MjModel.from_xml_string(robot.model_xml), float(robot.model.opt.timestep)
    if own.opt.timestep != step_s or own.opt.integrator != mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        numerics = (("timestep", number_text(step_s)), ("integrator", "implicitfast"))
        yield Change("option", "", numerics, "time step and integrator of the diagnosis")
    reference = (2 * step_s, 1.0)
    hard = (("solreffriction", number_text(*reference)), ("solimpfriction", number_text(*HARD_IMPEDANCE)))
    for joint in robot.joints:
        dof = joint.dof_index
        if tuple(own.dof_solref[dof]) != reference or tuple(own.dof_solimp[dof]) != HARD_IMPEDANCE:
            reason = "dry friction that does not creep under load"
            yield Change("joint", robot.mjcf_joint(joint.name), hard, reason)
        if own.jnt_actfrclimited[own.dof_jntid[dof]]:
            free = (("actuatorfrclimited", "false"),)
            yield Change("joint", robot.mjcf_joint(joint.name), free, "the actuator has the torque limit")


def _effect_changes(
    robot: Robot, active: Sequence[tuple[Effect, Array]], fields: Fields, recorder: _Recorder
) -> Iterator[Change]:
    """Yield the changes of each effect in turn; a later one of the same element goes on from the former."""
    before = _numbers(fields, recorder)
    yield from _law_changes(robot, None, before, "control law of the robot file")
    for effect, size in active:
        if not effect.overrides("set_model"):
            continue
        effect.set_model(size[None, :], fields, robot)
        after = _numbers(fields, recorder)
        reason = f"{effect.key}, {effect.describe(size)}"
        yield from _law_changes(robot, before, after, reason)
        yield from _joint_changes(robot, before, after, reason)
        yield from _model_changes(robot, before, after, reason)
        before = after
    fields.damping_Nms_rad = np.maximum(fields.damping_Nms_rad, 0.0)
    step_s = float(robot.model.opt.timestep)
    reason = f"less half a time step of joint damping and kd: second-order steps of {step_s:.5g} s"
    yield from _joint_changes(robot, before, _numbers(_with_powered(robot, fields), recorder), reason)


def _with_powered(robot: Robot, fields: Fields) -> Fields:
    """Return the numbers with the armature that joints have under power."""
    _, armature = powered_numbers(robot, fields, np.ones_like(fields.kp_Nm_rad))
    return replace(fields, armature_kgm2=armature)


def _numbers(fields: Fields, recorder: _Recorder) -> _Numbers:
    """Copy the numbers, with the bounds that the engine puts on them."""
    joints = {
        "kp": fields.kp_Nm_rad,
        "kd": fields.kd_Nms_rad,
        "limit": np.maximum(fields.torque_limit_Nm, 0.0),
        "damping": np.maximum(fields.damping_Nms_rad, 0.0) + fields.back_emf_Nms_rad,
        "frictionloss": np.maximum(fields.frictionloss_Nm, 0.0),
        "armature": np.maximum(fields.armature_kgm2, 0.0),
    }
    return _Numbers(
        {name: np.array(value[0]) for name, value in joints.items()},
        {name: np.array(value[0]) for name, value in recorder.fields.items()},
    )


def _law_changes(robot: Robot, before: _Numbers | None, after: _Numbers, reason: str) -> Iterator[Change]:
    """Yield the control law of each joint where it is new."""
    for j, joint in enumerate(robot.joints):
        if not joint.knows_gains:  # the model keeps what it has
            continue
        names = ("kp", "kd", "limit")
        if before is not None and all(before.joints[name][j] == after.joints[name][j] for name in names):
            continue
        kp, kd, limit = (float(after.joints[name][j]) for name in names)
        law = law_attributes(robot, joint, kp, kd, limit)
        if before is None and law == model_law(robot.model, joint.actuator_index):
            continue
        is_new = joint.actuator_index < 0 and before is None
        in_model = robot.mjcf_joint(joint.name)
        place: tuple[tuple[str, str], ...] = (("name", in_model), ("joint", in_model)) if is_new else ()
        said = f"kp {kp:.5g}, kd {kd:.5g}, torque limit {limit:.5g}: {reason}"
        kind = "new actuator" if is_new else "actuator"
        yield Change(kind, _motor(robot, joint), (*place, *law), said)


def _motor(robot: Robot, joint: RobotJoint) -> str:
    """Return the name of the actuator of a joint, or that of the joint where it has none."""
    own = "" if joint.actuator_index < 0 else robot.model.actuator(joint.actuator_index).name
    return own or robot.mjcf_joint(joint.name)


def _joint_changes(robot: Robot, before: _Numbers, after: _Numbers, reason: str) -> Iterator[Change]:
    for j, joint in enumerate(robot.joints):
        for name in ("damping", "frictionloss", "armature"):
            old, new = float(before.joints[name][j]), float(after.joints[name][j])
            if old != new:
                said = f"{name} {old:.5g} to {new:.5g}: {reason}"
                yield Change("joint", robot.mjcf_joint(joint.name), ((name, number_text(new)),), said)


def _rotor_changes(robot: Robot, rotors: Iterable[Rotor], numbers: _Numbers) -> Iterator[Change]:
    """Yield the changes that let a motor turn a rotor, with what the joint had of the motor."""
    for rotor in rotors:
        joint = robot.joints[rotor.joint]
        names = ("damping", "frictionloss", "armature")
        own = tuple((name, number_text(numbers.joints[name][rotor.joint])) for name in names)
        reason = f"the motor of {joint.name} turns {rotor.name}"
        in_model = robot.mjcf_joint(joint.name)
        yield Change("joint", rotor.name, own, reason)
        yield Change("joint", in_model, tuple((name, "0") for name in names), reason)
        yield Change("actuator", _motor(robot, joint), (("joint", rotor.name),), reason)


def _model_changes(robot: Robot, before: _Numbers, after: _Numbers, reason: str) -> Iterator[Change]:
    """Yield the changes of other fields of the model."""
    model = robot.model
    bodies: set[int] = set()
    for name, values in after.model.items():
        old = before.model.get(name, np.array(attrgetter(name)(model)))
        if name in DERIVED or np.array_equal(old, values):
            continue
        if name == "opt.gravity":
            yield Change("option", "", (("gravity", number_text(*values)),), reason)
            continue
        rows = [int(row) for row in np.flatnonzero((old != values).reshape(len(values), -1).any(axis=1))]
        if name in INERTIAL:
            bodies.update(rows)
        elif name in ATTRIBUTES:
            tag, attribute = ATTRIBUTES[name]
            for row in rows:
                new = ((attribute, number_text(*np.ravel(values[row]))),)
                yield Change(tag, _name(model, tag, row), new, reason)
        else:
            raise RobotError(f"{reason}: the patch cannot write the field {name!r}; leave this effect out")
    for body in sorted(bodies):
        numbers = (
            (attribute, after.model.get(name, attrgetter(name)(model))[body])
            for name, attribute in INERTIAL.items()
        )
        said = tuple((attribute, number_text(*np.ravel(value))) for attribute, value in numbers)
        yield Change("inertial", _name(model, "body", body), said, reason)


def _changed(robot: Robot, text: str, changes: Sequence[Change]) -> str:
    """Return the text with the changes; MuJoCo writes it anew if it does not hold each element."""
    try:
        made = change_text(text, changes)
    except RobotError:
        made = change_text(mujoco.MjSpec.from_string(text).to_xml(), changes)
    try:
        mujoco.MjModel.from_xml_string(made)
    except ValueError as error:
        raise RobotError(
            f"the patched model of {robot.name} does not compile: {' '.join(str(error).split())}"
        ) from error
    return made


def _runtime_text(
    robot: Robot, left: Sequence[tuple[Effect, Array]], rotors: Mapping[int, Rotor], fields: Fields
) -> str:
    """Return the runtime file."""
    on, off = (powered_numbers(robot, fields, np.full_like(fields.kp_Nm_rad, one)) for one in (1.0, 0.0))
    more = {"back_emf_Nms_rad": on[0] - off[0], "armature_off_kgm2": off[1] - on[1]}
    joints = []
    for j, joint in enumerate(robot.joints):
        rotor, table = rotors.get(j), {"name": joint.name, "joint": robot.mjcf_joint(joint.name)}
        table |= {"actuator": _motor(robot, joint), "mode": joint.mode.value}
        turned = {} if rotor is None else {"rotor": rotor.name, "sees_output": rotor.encoder_is_at_output}
        joints.append({**table, **turned, **{name: float(value[0, j]) for name, value in more.items()}})
    tables: dict[str, Any] = {
        "format": FORMAT,
        "model": MODEL_FILE,
        "control_period_s": float(robot.control_period_s),
        "joints": joints,
        "effects": [effect_table(effect, size.tolist()) for effect, size in left],
    }
    runtime = "simgap.patch.runtime"
    head = f"Effects of {robot.name} that {MODEL_FILE} cannot express; {runtime} applies them."
    return toml_text(tables, [head])


def _name(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of an element; MJCF text without it cannot be changed in place."""
    name = str(getattr(model, kind)(number).name)
    if not name and kind == "body" and model.body_jntnum[number]:
        return f"{BODY_OF}{model.joint(model.body_jntadr[number]).name}"
    if not name:
        raise RobotError(f"the model's {kind} number {number} has no name; give it one")
    return name
