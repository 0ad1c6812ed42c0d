"""Effects of the user's own: the example of the page, and files that are refused in one sentence."""

import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, robot_of, simulate
from helpers.real_robots import repository_file
from simgap.catalogue.own_effects import load_effects
from simgap.common.errors import RobotError
from simgap.logs import JointLog, Logs, Motion, Signal

EXAMPLE = "examples/robot/detent.py"
ARM = robot_of(ARM_XML)
TIME_S = np.linspace(0, 2, 200)
SIGNAL = Signal(TIME_S, np.sin(3 * TIME_S))
LOGS = Logs((Motion("m", {joint.name: JointLog(SIGNAL, command=SIGNAL) for joint in ARM.joints}, {}),))
IMPORTS = """
from dataclasses import dataclass
from simgap.effects.effect import Effect, Family, Size
from simgap.effects.effect import JointEffect
"""
KIND = (
    IMPORTS
    + """
@dataclass(frozen=True, slots=True)
class Mine(JointEffect):
    name = "mine"
    family = Family.EXTERNAL
    @property
    def sizes(self):
        return {sizes}
    {hook}
"""
)
SIZE = '(Size("push_Nm", 0.0, 1.0, 0.1),)'
HOOK = "def torque_Nm(self, size, state): return size[:, 0]"


def write(folder, text, name="mine.py"):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_the_example_is_put_at_each_joint_and_moves_it():
    effects = load_effects(repository_file(EXAMPLE), ARM, LOGS)
    assert [effect.key for effect in effects] == [f"{j.name}: magnetic detents" for j in ARM.joints]
    command = 0.3 * np.sin(np.linspace(0, 6, 300))[:, None] * np.ones(3)
    rest, moved = simulate(ARM, effects, [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]], command, command[0])
    assert np.abs(moved - rest)[1].max() > 0.01


def test_a_torque_at_a_place_that_is_no_joint_is_refused(tmp_path):
    effects = "def effects(robot, logs): return [Mine('base', 0, robot.joints[0], None)]\n"
    text = KIND.format(sizes=SIZE, hook=HOOK) + effects
    with pytest.raises(RobotError, match="Mine at 'base': torque_Nm acts at a joint; give it one of"):
        load_effects(write(tmp_path, text), ARM, LOGS)


def test_a_function_of_the_file_chooses_the_places(tmp_path):
    text = KIND.format(sizes=SIZE, hook=HOOK) + (
        "\ndef effects(robot, logs):\n"
        "    from simgap.effects.effect import joint_scales\n"
        "    return [Mine.at(robot, 'lift', joint_scales(robot, logs.fit))]\n"
    )
    assert [one.key for one in load_effects(write(tmp_path, text), ARM, LOGS)] == ["lift: mine"]


def test_files_of_one_name_in_two_folders_stay_apart(tmp_path):
    for k in (1, 2):
        (tmp_path / str(k)).mkdir()
        write(tmp_path / str(k), KIND.format(sizes=SIZE, hook=HOOK).replace('"mine"', f'"mine {k}"'))
    names = [load_effects(tmp_path / str(k) / "mine.py", ARM, LOGS)[0].name for k in (1, 2)]
    assert names == ["mine 1", "mine 2"]


OTHER = "\n@dataclass(frozen=True, slots=True)\nclass Other(Mine):\n    pass\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x = 1", "no effect; give a subclass of JointEffect or a function"),
        ("import nothing_of_this_name", "cannot be run: ModuleNotFoundError: No module named"),
        ("def broken(:", "cannot be run: SyntaxError"),
        ("def effects(robot, logs):\n    return 1 / 0", "cannot be made, ZeroDivisionError: division by"),
        ("def effects(robot, logs):\n    return [3]", "returned 3, which is not an Effect"),
        (KIND.format(sizes="()", hook=HOOK), "the sizes of Mine are (); give a tuple"),
        (KIND.format(sizes="None.x", hook=HOOK), "the sizes of Mine fail, AttributeError"),
        (KIND.format(sizes='(Size("a", 0.1, 1.0, 0.5),)', hook=HOOK), "right is low <= 0 < typical <= high"),
        (KIND.format(sizes=SIZE, hook="pass"), "Mine changes nothing; override one of"),
        (KIND.format(sizes=SIZE, hook=HOOK).replace('name = "mine"', ""), "Mine lacks its name or its"),
        (KIND.format(sizes=SIZE, hook=HOOK) + OTHER, "2 effects have the key 'pan: mine'"),
    ],
)
def test_a_wrong_file_is_one_sentence(tmp_path, text, sentence):
    with pytest.raises(RobotError) as refused:
        load_effects(write(tmp_path, text), ARM, LOGS)
    message = str(refused.value)
    assert sentence in message
    assert message.startswith(str(tmp_path))
    assert "\n" not in message


def test_a_missing_file_and_another_kind_of_file_are_one_sentence(tmp_path):
    for name in ("none.py", f"{'a' * 300}.py"):
        with pytest.raises(RobotError, match="no such file"):
            load_effects(tmp_path / name, ARM, LOGS)
    with pytest.raises(RobotError, match=r"its name ends in \.py"):
        load_effects(write(tmp_path, "x = 1", "mine.txt"), ARM, LOGS)
