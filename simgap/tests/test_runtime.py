"""The runtime file and its wrapper: files that are refused, effects of one's own, commands one by one."""

import math

import mujoco
import numpy as np
import pytest

from helpers.pendulum import at_swing, motion, pendulum, simulated, waves
from simgap.catalogue.own_effects import load_effects
from simgap.common.errors import RobotError
from simgap.effects.command import AccelerationLimit, ClampHigh, ClampLow, CommandDelay, VelocityLimit
from simgap.effects.forces import LoadFriction
from simgap.logs import Logs, Signal
from simgap.patch.patch import make_patch
from simgap.patch.runtime import RuntimeEffects
from test_patch import made

ROBOT = pendulum()
TIME_s = np.arange(0.0, 3.0, 0.002)
COMMANDS = {CommandDelay: 0.0123, VelocityLimit: 2.0, AccelerationLimit: 0.3, ClampLow: 1.2, ClampHigh: 0.4}
OWN = """
from dataclasses import dataclass

from simgap.effects.effect import Family, Size
from simgap.effects.effect import JointEffect


@dataclass(frozen=True, slots=True)
class Pull(JointEffect):
    name = "pull"
    family = Family.EXTERNAL

    @property
    def sizes(self):
        return (Size("pull_Nm", 0.0, 1.0, 0.1),)

    def torque_Nm(self, size, state):
        return size[:, 0] + 0.0 * state.time_s
"""


def read(tmp_path, text, model_xml):
    (tmp_path / "runtime.toml").write_text(text)
    return RuntimeEffects.from_toml(mujoco.MjModel.from_xml_string(model_xml), tmp_path / "runtime.toml")


@pytest.mark.parametrize("kind", COMMANDS, ids=lambda kind: kind.__name__)
def test_commands_that_arrive_one_by_one_are_those_of_the_whole_motion(kind):
    effect, command = at_swing(kind, ROBOT), waves(TIME_s, seed=3)
    size, memory = np.array([[COMMANDS[kind]]]), {}
    whole = effect.shape_command(size, command[None, :], 0.002)[0]
    single = [effect.next_command(size, np.array([one]), 0.002, memory)[0] for one in command]
    assert np.array(single) == pytest.approx(whole, abs=1e-12)
    assert np.abs(whole - command).max() > 1e-3


def test_an_effect_of_ones_own_is_loaded_from_its_file(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    logs = Logs((motion(TIME_s, waves(TIME_s, 1), waves(TIME_s, 1)),))
    (pull,) = load_effects(tmp_path / "own.py", ROBOT, logs)
    patch = make_patch(ROBOT, [pull], [(0.2,)])
    assert f'file = "{tmp_path / "own.py"}"' in patch.runtime
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime, data = read(tmp_path, patch.runtime, patch.model_xml), mujoco.MjData(model)
    runtime.act(model, data, np.zeros(1))
    mujoco.mj_step(model, data, runtime.n_steps)
    assert data.qfrc_applied[0] == pytest.approx(0.2)


def test_a_wrapper_holds_what_it_does_not_change(tmp_path):
    patch = make_patch(ROBOT, *made({LoadFriction: 0.1}))
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime = read(tmp_path, patch.runtime, patch.model_xml)
    data = mujoco.MjData(model)
    gain, limited = model.actuator_gainprm.copy(), model.actuator_forcelimited.copy()
    runtime.act(model, data, np.array([0.3]))
    mujoco.mj_step(model, data, runtime.n_steps)
    assert np.array_equal(model.actuator_gainprm, gain)
    assert np.array_equal(model.actuator_forcelimited, limited)
    assert math.isclose(data.time, 0.002)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("friction_per_load =", "friction_per_weight =", "friction_per_weight; it takes friction_per_load"),
        ("simgap.effects.forces:LoadFriction", "os:system", "os is no module of simgap"),
        ("robot runtime 1", "else", "is not 'robot runtime 1'"),
        ("", "", "use the patched model"),
    ],
)
def test_a_runtime_file_of_another_format_effect_or_model_is_refused(tmp_path, old, new, said):
    patch = make_patch(ROBOT, *made({LoadFriction: 0.1}))
    assert old in patch.runtime
    with pytest.raises(RobotError, match=said):
        read(tmp_path, patch.runtime.replace(old, new), patch.model_xml if old else "<mujoco/>")


def test_a_loop_of_ones_own_has_the_gains_of_a_column_and_motors_without_torque(tmp_path):
    robot = pendulum(limit_Nm=1.5, step_s=0.002, period_s=0.01)
    effects, sizes = made({CommandDelay: 0.0123, LoadFriction: 0.1})
    command = np.repeat(waves(TIME_s[::5], seed=5), 5)
    off = np.repeat(abs(TIME_s[::5] - 1.3) < 0.3, 5)
    enabled = Signal(TIME_s, np.where(off, 0.0, 1.0))
    log = motion(TIME_s, 0.0 * TIME_s, command, gain={"swing": 0.6}, enabled=enabled)
    engine = simulated(robot, log, *zip(effects, sizes, strict=True))
    patch = make_patch(robot, effects, sizes)
    model = mujoco.MjModel.from_xml_string(patch.model_xml)
    runtime, data = read(tmp_path, patch.runtime, patch.model_xml), mujoco.MjData(model)
    shown = []
    for k in range(TIME_s.size):
        shown.append(data.qpos[0])
        if k % 5 == 0:
            runtime.act(model, data, command[[k]], gain=0.6, is_on=not off[k])
        mujoco.mj_step(model, data)
    assert shown[::5] == pytest.approx(engine[::5], abs=1e-9)
    assert np.ptp(shown) > 0.3
