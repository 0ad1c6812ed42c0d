"""The catalogue: effects that make sense, each of them changes something; and effects of the user's own."""

import dataclasses
import math
import re

import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, PENDULUM_XML, own_effect, robot_of, simulate
from helpers.real_robots import repository_file
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.catalogue.own_effects import load_effects
from simgap.common.errors import RobotError
from simgap.effects import effect as interface
from simgap.effects.transmission import Backlash, PeriodicError, SmoothPeriodicError
from simgap.effects.variation import Difference, unbound
from simgap.logs import JointLog, Logs, Motion, Signal

ARM = robot_of(ARM_XML)
N_TICKS = 600
TIME_S = ARM.control_period_s * np.arange(N_TICKS)


def lively(speed=6.0):
    """Commands with fast and slow parts, reversals and rests, which start at 0."""
    wave = np.sin(speed * TIME_S) * np.clip(np.sin(1.5 * TIME_S), 0, None)
    step = 0.8 * (np.floor(TIME_S / 0.8) % 2)
    return np.stack((0.5 * wave + 0.3 * step, 0.5 * wave + step, 0.6 * step - 0.5 * wave), axis=1)


def logs_of(robot, command, position, **more):
    """Return logs with these positions; further signals are given by a function of the index of the joint."""
    joints = {
        joint.name: JointLog(
            Signal(TIME_S, position[:, j]),
            command=None if command is None else Signal(TIME_S, command[:, j]),
            **{name: make(j) for name, make in more.items()},
        )
        for j, joint in enumerate(robot.joints)
    }
    return Logs((Motion("first", joints, {}), Motion("second", joints, {})))


@pytest.fixture(scope="module")
def arm_logs():
    command = lively()
    return logs_of(ARM, command, simulate(ARM, (), [[]], command, command[0])[0].T)


def names(effects):
    return {effect.name for effect in effects}


def test_every_effect_changes_the_motion_at_its_typical_size_and_at_size_0_no_bit_beside_the_others(arm_logs):
    command, heat = lively(), Signal(TIME_S, np.linspace(20, 40, N_TICKS))
    position = np.stack([arm_logs.motions[0].joints[joint.name].position.value for joint in ARM.joints], 1)
    logs = logs_of(ARM, command, position, temperature=lambda _: heat)
    effects = (*catalogue(ARM, logs), *base_effects(ARM, logs))
    assert len(effects) > 80
    counts = np.cumsum([0, *(len(effect.sizes) for effect in effects)])
    table = np.zeros((len(effects) + 1, counts[-1]))
    for k, effect in enumerate(effects):
        table[k + 1, counts[k] : counts[k + 1]] = [size.typical for size in effect.sizes]
    degC = np.full(3, 20.0)
    moved = simulate(ARM, effects, table, command, command[0], degC)
    np.testing.assert_array_equal(moved[0], simulate(ARM, (), [[]], command, command[0], degC)[0])
    changes = np.abs(moved[1:] - moved[0]).max(axis=(1, 2))
    dead = [effect.key for effect, change in zip(effects, changes, strict=True) if not change > 1e-7]
    assert not dead
    assert np.isfinite(changes).all()


def test_keys_are_unique_and_bounds_hold_typical_sizes(arm_logs):
    effects = (*catalogue(ARM, arm_logs), *base_effects(ARM, arm_logs))
    keys = [effect.key for effect in effects]
    assert len(set(keys)) == len(keys)
    for effect in effects:
        for size in effect.sizes:
            assert size.low <= 0 < size.typical <= size.high, effect.key
            assert math.isfinite(size.low)
            assert math.isfinite(size.high)
        assert effect.describe(np.array([size.typical for size in effect.sizes]))


def test_base_effects_are_candidates_only_where_the_joint_is_known(arm_logs):
    base = {"viscous friction", "Coulomb friction", "armature", "gain error"}
    assert not names(catalogue(ARM, arm_logs)) & base
    assert names(base_effects(ARM, arm_logs)) == base
    joints = tuple(dataclasses.replace(joint, is_known=True) for joint in ARM.joints)
    known = dataclasses.replace(ARM, joints=joints)
    assert base <= names(catalogue(known, arm_logs))
    assert base_effects(known, arm_logs) == ()


def test_a_parameter_may_fall_by_more_than_the_number_of_the_model(arm_logs):
    for one in base_effects(ARM, arm_logs):
        changes = Difference(one.place, unbound(one)).sizes
        assert all(change.low <= -size.high for change, size in zip(changes, one.sizes, strict=True))


def test_priors_of_base_effects_allow_ten_typical_sizes_and_the_nominal_value(arm_logs):
    base = base_effects(ARM, arm_logs)
    for size in (size for effect in base for size in effect.sizes):
        assert size.prior_std == max(10 * size.typical, -size.low)
    assert all(math.isinf(size.prior_std) for one in catalogue(ARM, arm_logs) for size in one.sizes)


def test_command_effects_need_commands(arm_logs):
    silent = logs_of(ARM, None, lively())
    commanded = {"command delay", "velocity limit", "command clamp, low"}
    commanded |= {"dead zone", "torque limit", "backlash"}
    assert commanded <= names(catalogue(ARM, arm_logs))
    assert not commanded & names(catalogue(ARM, silent))
    assert "gain error" not in names(base_effects(ARM, silent))


@pytest.mark.parametrize(("range_K", "is_offered"), [(2.0, False), (12.0, True)])
def test_temperature_needs_a_range(range_K, is_offered):
    heat = Signal(TIME_S, np.linspace(30, 30 + range_K, N_TICKS))
    effects = catalogue(ARM, logs_of(ARM, lively(), lively(), temperature=lambda _: heat))
    assert ("temperature-dependent friction" in names(effects)) == is_offered


def twisted(angle_rad):
    """Return the second encoders of joints with a wave of one period in a turn."""
    return lambda j: Signal(TIME_S, angle_rad[:, j] + 1e-3 * np.sin(angle_rad[:, j]))


def test_a_second_encoder_gives_periodic_errors_and_puts_the_first_at_the_motor(arm_logs):
    effects = catalogue(ARM, logs_of(ARM, lively(), lively(), secondary=twisted(lively())))
    assert "periodic joint error" in names(effects)
    zeros = Signal(TIME_S, np.zeros(N_TICKS))
    without = catalogue(ARM, logs_of(ARM, lively(), lively(), secondary=lambda _: zeros))
    assert "periodic joint error" not in names(without)
    assert not any(one.encoder_is_at_output for one in effects if isinstance(one, Backlash))
    assert all(one.encoder_is_at_output for one in catalogue(ARM, arm_logs) if isinstance(one, Backlash))


@pytest.mark.parametrize(("share", "orders"), [(1.0, {1, 2}), (0.6, {2}), (0.2, set())])
def test_a_wave_is_offered_where_the_joint_turns_through_half_a_period(share, orders):
    command = share * np.pi * (lively() - lively().min(axis=0)) / np.ptp(lively(), axis=0)
    effects = catalogue(ARM, logs_of(ARM, command, command, secondary=twisted(command)))
    assert {one.order for one in effects if isinstance(one, PeriodicError)} == orders


def test_a_plane_is_offered_where_commands_go_below_the_lowest_measured_height():
    robot = robot_of(PENDULUM_XML)
    command = np.linspace(1.2, 0.0, N_TICKS)[:, None]
    stopped = np.maximum(command, np.arccos(0.25 / 0.3))
    known = catalogue(robot, logs_of(robot, command, stopped))
    plane = [one for one in known if one.family is interface.Family.CONTACT]
    assert len(plane) == 1
    assert plane[0].lowest_m == pytest.approx(-0.3, abs=1e-6)
    assert plane[0].sizes[0].high == pytest.approx(0.05 + 0.01 + 0.15, abs=1e-3)
    free = catalogue(robot, logs_of(robot, command, command))
    assert not [one for one in free if one.family is interface.Family.CONTACT]


def test_links_that_change_no_torque_are_left_out(arm_logs):
    effects = catalogue(ARM, arm_logs)
    without_gravity = robot_of(ARM_XML.replace("<option ", '<option gravity="0 0 0" '))
    assert "gravity direction" in names(effects)
    assert "gravity direction" not in names(catalogue(without_gravity, arm_logs))
    zeros = {one.place for one in effects if one.name == "joint zero"}
    assert zeros == {"lift", "elbow"}  # gravity and inertia are the same at any angle of a vertical axis


def test_held_out_motions_give_no_bounds(arm_logs):
    fast = 3 * lively(30.0)
    held = dataclasses.replace(logs_of(ARM, fast, fast).motions[0], name="held")
    wider = Logs((*arm_logs.motions, held), frozenset({"held"}))
    assert [one.sizes for one in catalogue(ARM, wider)] == [one.sizes for one in catalogue(ARM, arm_logs)]


def test_orders_of_a_smooth_error_have_narrower_priors_the_higher_they_are():
    sizes = SmoothPeriodicError("lift", 1e-3).sizes
    assert len(sizes) == 96
    widths = [size.prior_std for size in sizes[::2]]
    np.testing.assert_allclose(widths, 1e-3 / np.arange(1, 49))


def kinds():
    """All classes of effects that the catalogue and its parts import."""
    package = f"{interface.__package__}."
    mine = [kind for kind in set(_below(interface.Effect)) if kind.__module__.startswith(package)]
    return {kind for kind in mine if isinstance(kind.name, str)}


def _below(kind):
    for one in kind.__subclasses__():
        yield one
        yield from _below(one)


def test_the_page_lists_every_effect_with_its_family_and_its_sizes(arm_logs):
    page = repository_file("docs/robot-effects.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if line.startswith("| ") and line.count("|") == 5]
    cells = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    rows = {name: rest for name, *rest in cells}
    offered = {one.name: one for one in (*catalogue(ARM, arm_logs), *base_effects(ARM, arm_logs))}
    all_names = {kind.name: kind for kind in kinds()}
    assert set(all_names) == set(rows) - {"effect", "---"}
    for name, kind in all_names.items():
        family, sizes, *_ = rows[name]
        assert family == kind.family, name
        if name in offered and name != "periodic joint error of many orders":
            listed = re.findall(r"`(\w+)`", sizes)
            assert listed == [size.name for size in offered[name].sizes], name
        for other in re.split(r"; ", rows[name][-1]):
            assert other == "" or other in all_names, f"{name}: {other} is no effect"


EXAMPLE = "examples/robot/detent.py"
SIGNAL = Signal(np.linspace(0, 2, 200), np.sin(np.linspace(0, 6, 200)))
LOGS = Logs((Motion("m", {joint.name: JointLog(SIGNAL, command=SIGNAL) for joint in ARM.joints}, {}),))


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
    text = own_effect() + effects
    with pytest.raises(RobotError, match="Mine at 'base': torque_Nm acts at a joint; give it one of"):
        load_effects(write(tmp_path, text), ARM, LOGS)


def test_a_function_of_the_file_chooses_the_places(tmp_path):
    text = own_effect() + (
        "\ndef effects(robot, logs):\n"
        "    from simgap.effects.effect import joint_scales\n"
        "    return [Mine.at(robot, 'lift', joint_scales(robot, logs.fit))]\n"
    )
    assert [one.key for one in load_effects(write(tmp_path, text), ARM, LOGS)] == ["lift: mine"]


def test_files_of_one_name_in_two_folders_stay_apart(tmp_path):
    for k in (1, 2):
        (tmp_path / str(k)).mkdir()
        write(tmp_path / str(k), own_effect().replace('"mine"', f'"mine {k}"'))
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
        (own_effect("()"), "the sizes of Mine are (); give a tuple"),
        (own_effect("None.x"), "the sizes of Mine fail, AttributeError"),
        (own_effect('(Size("a", 0.1, 1.0, 0.5),)'), "right is low <= 0 < typical <= high"),
        (own_effect(hook="pass"), "Mine changes nothing; override one of"),
        (own_effect().replace('name = "mine"', ""), "Mine lacks its name or its"),
        (own_effect() + OTHER, "2 effects have the key 'pan: mine'"),
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
