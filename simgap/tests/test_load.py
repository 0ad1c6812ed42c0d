"""Loading of logs: every format gives the same signals by motion, and what is fitted never judges."""

import numpy as np
import pytest

from helpers.robot_folder import COLUMNS, changed, write_csv, write_npz, write_parquet, write_robot
from simgap.checks.records import RemarkKind
from simgap.checks.signals import find_wraps
from simgap.common.errors import RobotError
from simgap.files.columns import cut_at_pauses
from simgap.loading import load
from simgap.robot import Robot


@pytest.fixture
def robot(tmp_path):
    return Robot.from_toml(write_robot(tmp_path))


@pytest.mark.parametrize("write", [write_parquet, write_csv, write_npz])
def test_values_are_in_si_units_at_the_joint_in_every_format(tmp_path, robot, write):
    slow, fast = load(robot, write(tmp_path)).motions
    assert (slow.name, fast.name) == ("slow", "fast")
    assert (slow.conditions, fast.conditions) == ({"gain": 2.0}, {"gain": 3.0})
    assert (slow.gain, fast.gain) == ({"shoulder": 2.0, "elbow": 1.0}, {"shoulder": 3.0, "elbow": 1.0})
    shoulder, elbow = slow.joints["shoulder"], slow.joints["elbow"]
    np.testing.assert_allclose(shoulder.position.time_s, [0.0, 0.01, 0.02])
    np.testing.assert_allclose(shoulder.position.value, 0.5 - np.pi * np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(shoulder.command.value, np.radians([0.0, 9.0, 18.0]))
    np.testing.assert_allclose(elbow.position.value, 2 * np.pi / 50 * np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(elbow.torque.value, [0.0, 5.0, 10.0])
    assert elbow.velocity is None
    assert fast.joints["elbow"].torque.value.size == 4


def test_a_signal_keeps_its_own_rate_where_cells_are_empty(tmp_path, robot):
    path = write_parquet(tmp_path, m2=[1.0, None, 3.0, 4.0, None, None, 7.0])
    slow, fast = load(robot, path).motions
    np.testing.assert_allclose(slow.joints["elbow"].torque.time_s, [0.0, 0.02])
    np.testing.assert_allclose(fast.joints["elbow"].torque.value, [0.2, 0.35])
    assert fast.joints["elbow"].position.value.size == 4


def test_an_array_may_have_times_of_its_own(tmp_path):
    change = ('{ column = "m2", unit', '{ column = "m2", time_column = "tm", unit')
    no_motion = ('columns = ["motion"]\n\n[conditions.gain]\ncolumn = "gain"', "")
    robot = write_robot(tmp_path, change, no_motion, ('gain_column = "gain"\n', ""))
    path = write_npz(tmp_path, t=np.arange(7.0), m2=np.ones(3), tm=np.array([2.0, 4.0, 6.0]))
    (motion,) = load(robot, path).motions
    assert motion.name == "log"
    np.testing.assert_allclose(motion.joints["elbow"].torque.time_s, [0.002, 0.004, 0.006])


def test_rows_of_a_motion_need_not_follow_one_another(tmp_path, robot):
    order = [0, 3, 1, 4, 2, 5, 6]
    path = write_parquet(tmp_path, **{name: [one[k] for k in order] for name, one in COLUMNS.items()})
    slow, fast = load(robot, path).motions
    np.testing.assert_allclose(slow.joints["elbow"].torque.value, [0.0, 5.0, 10.0])
    assert fast.joints["elbow"].torque.value.size == 4


def test_times_count_from_the_start_of_the_motion(tmp_path, robot):
    path = write_parquet(tmp_path, t=[1e12 + one for one in COLUMNS["t"]])
    slow, _ = load(robot, path).motions
    np.testing.assert_allclose(slow.joints["elbow"].position.time_s, [0.0, 0.01, 0.02], atol=1e-6)


def test_two_columns_together_name_a_motion(tmp_path):
    robot = write_robot(tmp_path, ('["motion"]', '["motion", "gain"]'))
    assert [one.name for one in load(robot, write_parquet(tmp_path)).motions] == ["slow 2", "fast 3"]


@pytest.mark.parametrize(
    ("line", "names"),
    [('repeat_column = "again"', ["x", "x"]), ('repeats = [["slow", "fast"]]', ["slow", "slow"])],
)
def test_motions_that_repeat_one_another_share_a_text_or_are_named(tmp_path, line, names):
    robot = write_robot(tmp_path, ("[motion]", f"[motion]\n{line}"))
    found = load(robot, write_parquet(tmp_path, again=["x"] * 7)).motions
    assert [one.repeat_of for one in found] == names


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('repeats = [["slow", "fats"]]', "repeats: 'fats' is no motion, condition or file .* 'fast'"),
        ('repeats = [["slow"]]', "repeats"),
        ('repeats = [["slow", "fast"], ["fast", "slow"]]', "repeats: 'fast' stands there twice"),
        ('repeats = [["slow", "fast"]]\nrepeat_column = "again"', "repeat_column and repeats exclude"),
    ],
)
def test_repeats_that_are_wrong_are_refused(tmp_path, line, message):
    with pytest.raises(RobotError, match=message):
        load(write_robot(tmp_path, ("[motion]", f"[motion]\n{line}")), write_parquet(tmp_path))


def test_a_flag_is_1_or_0_also_as_a_word(tmp_path):
    enabled = '[joints.elbow]\nenabled = { column = "on", unit = "flag" }\n'
    robot, path = write_robot(tmp_path, ("[joints.elbow]\n", enabled)), write_csv(tmp_path)
    words = ["on", "true", "false", "true", "true", "true", "true", "true"]
    rows = zip(path.read_text().splitlines(), words, strict=True)
    path.write_text("\n".join(map(",".join, rows)))
    slow, _ = load(robot, path).motions
    np.testing.assert_array_equal(slow.joints["elbow"].enabled.value, [1, 0, 1])


def test_a_counter_that_wraps_lies_where_the_model_has_the_joint_and_is_told(tmp_path):
    counter = 'column = "q1", unit = "count", counts_per_turn = 4096'
    position = 'column = "q1", unit = "deg", factor = -1.0, zero_rad = 0.5'
    robot = Robot.from_toml(write_robot(tmp_path, (position, counter)))
    logs = load(robot, write_parquet(tmp_path, q1=[4000, 4090, 84, 4000, 4010, 4020, 4030]))
    slow, fast = (one.joints["shoulder"].position.value for one in logs.motions)
    np.testing.assert_allclose(slow, 2 * np.pi / 4096 * np.array([-96, -6, 84]), atol=1e-12)
    np.testing.assert_allclose(fast, 2 * np.pi / 4096 * np.array([-96, -86, -76, -66]), atol=1e-12)
    assert [one.unwrapped for one in logs.motions] == [{"shoulder": 1}, {"shoulder": 0}]
    (remark,) = find_wraps(robot, logs.motions)
    assert (remark.kind, remark.motions) == (RemarkKind.COUNTER, ("slow", "fast"))
    assert remark.text == "the counter wraps once; it is unwrapped"


def test_a_share_of_a_range_is_an_angle(tmp_path):
    share = 'unit = "fraction", at_0_rad = -0.2, at_1_rad = 1.8'
    robot = write_robot(tmp_path, ('column = "c1", unit = "deg"', f'column = "c1", {share}'))
    slow, _ = load(robot, write_parquet(tmp_path, c1=[0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0])).motions
    np.testing.assert_allclose(slow.joints["shoulder"].command.value, [-0.2, 0.8, 1.8])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"q1": [0.0, np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]}, "'q1', motion 'slow': is no finite number at 0.01"),
        ({"q1": [0.0, 0.0, 0.0, 0.0, 0.0, np.inf, 0.0]}, "'q1', motion 'fast': is no finite number at 0.02"),
        ({"q1": ["1", *["a"] * 6]}, "column 'q1' has 'a' in row 2; a signal needs numbers"),
        ({"q1": [None] * 7}, "column 'q1' is empty; a signal needs numbers"),
        ({"q1": [None, None, None, 0.0, 0.0, 0.0, 0.0]}, "column 'q1' has no value in motion 'slow'"),
        ({"t": [0.0, 2.0, 1.0, 0.0, 1.0, 2.0, 3.0]}, "motion 'slow': the time of 't' runs backwards from"),
        ({"t": [0.0, 1.0, 1.0, 0.0, 1.0, 2.0, 3.0]}, "motion 'slow': the time of 't' repeats: 1 row has"),
        ({"t": [0.0, None, 1.0, 0.0, 1.0, 2.0, 3.0]}, "time column 't' has rows without a time; remove them"),
        ({"gain": [2, 2, 1, 3, 3, 3, 3]}, "column 'gain' changes within motion 'slow'; divide the motion"),
        ({"gain": [0, 0, 0, 3, 3, 3, 3]}, "column 'gain', motion 'slow': is 0; a gain is above 0"),
        ({"gain": [np.nan] * 3 + [3.0] * 4}, "column 'gain', motion 'slow': a row has no number; write one"),
        ({"motion": ["slow"] * 3 + [""] * 4}, "column 'motion' is empty in row 4; name the motion"),
        ({"motion": ["slow"] * 3 + [None] * 4}, "column 'motion' is empty in row 4; name the motion"),
        ({"motion": [["slow"]] * 7}, "column 'motion' has lists of 1: write the place of an item, such as"),
        ({name: [] for name in COLUMNS}, "has no rows; name a log with samples"),
    ],
)
def test_bad_rows_are_refused_in_one_sentence(tmp_path, robot, changes, said):
    path = write_parquet(tmp_path, **changes)
    with pytest.raises(RobotError) as error:
        load(robot, path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)


def test_a_column_that_is_missing_is_named_with_the_nearest(tmp_path):
    robot = write_robot(tmp_path, ('column = "m2"', 'column = "m_2"'))
    said = "has no column 'm_2', which robot file or mapping names; did you mean 'm2'"
    for write in (write_parquet, write_csv, write_npz):
        with pytest.raises(RobotError, match=said):
            load(robot, write(tmp_path))


def test_arrays_of_other_lengths_than_their_times_are_refused(tmp_path, robot):
    with pytest.raises(RobotError, match="column 'm2' has 3 values, its times 7; name a time_column"):
        load(robot, write_npz(tmp_path, m2=np.ones(3)))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"again": np.ones(5)}, "column 'again' has 5 values, 'motion' has 7; give both the same length"),
        ({"gain": np.ones(5)}, "column 'gain' has 5 values, 'motion' has 7; give both the same length"),
        ({"motion": np.full(8, "a")}, "column 't' has 7 values, 'motion' has 8; give both the same length"),
        ({"motion": np.full((7, 2), "a")}, "column 'motion' has lists of 2: write the place of"),
    ],
)
def test_an_array_of_labels_has_one_dimension_and_the_length_of_the_rows(tmp_path, changes, said):
    robot = write_robot(tmp_path, ("[motion]", '[motion]\nrepeat_column = "again"'))
    with pytest.raises(RobotError) as error:
        load(robot, write_npz(tmp_path, **{"again": np.ones(7)} | changes))
    assert said in str(error.value)


def test_motions_of_one_name_in_two_files_have_the_name_of_the_file(tmp_path, robot):
    friday = write_parquet(tmp_path, "friday", motion=["slow"] * 3 + ["q"] * 4)
    paths = [write_parquet(tmp_path, "monday"), friday]
    found = load(robot, paths, held_out=["friday"])
    assert names(found.motions) == ["monday:slow", "fast", "friday:slow", "q"]
    assert names(found.judged) == ["friday:slow", "q"]
    assert names(load(robot, paths, held_out=["monday:slow"]).judged) == ["monday:slow"]
    assert names(load(robot, paths, held_out=["slow"]).judged) == ["monday:slow", "friday:slow"]


def test_files_of_one_name_are_told_apart_by_their_folders(tmp_path):
    robot = write_robot(tmp_path, ('columns = ["motion"]\n', ""))
    rows = {name: one[:3] for name, one in COLUMNS.items()}
    for folder in ("run1", "run2"):
        (tmp_path / folder).mkdir()
    paths = [write_parquet(tmp_path / folder, **rows) for folder in ("run1", "run2")]
    found = load(robot, paths, held_out=["run2/log"])
    assert (names(found.fit), names(found.judged)) == (["run1/log"], ["run2/log"])
    with pytest.raises(RobotError, match=r"run1/log\.parquet: is given twice; give each log once"):
        load(robot, [paths[0], paths[0]])


@pytest.mark.parametrize("name", ["log.parquet", "log.csv", "log.npz", "log.mcap"])
def test_a_file_that_is_damaged_absent_or_empty_is_refused(tmp_path, robot, name):
    path = tmp_path / name
    with pytest.raises(RobotError, match="there is no such log"):
        load(robot, path)
    for content in (b"", bytes(range(256))):
        path.write_bytes(content)
        with pytest.raises(RobotError, match=str(path)):
            load(robot, path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (f"{'a' * 300}.csv", "there is no such log"),
        ("folder.csv", r"folder\.csv: is no regular file; name a log"),
        ("log.mat", r"is no log by its suffix; name a file that ends in one of \.parquet"),
    ],
)
def test_a_name_that_is_too_long_a_folder_and_a_file_of_another_kind_are_refused(tmp_path, robot, name, said):
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "log.mat").write_text("x")
    with pytest.raises(RobotError, match=said):
        load(robot, tmp_path / name)


SPLIT = """default = "first"
[parts]
a = ["slow"]
b = ["gain=3"]
[splits.first]
fit = ["a"]
held_out = ["b"]
[splits.second]
held_out = ["a"]
"""


def logs(folder, *changes, **options):
    """Load with a split file that has changes."""
    (folder / "split.toml").write_text(changed(SPLIT, *changes))
    path = write_robot(folder, ('model = "model.xml"', 'model = "model.xml"\nsplit = "split.toml"'))
    return load(path, write_parquet(folder), **options)


def names(motions):
    return [one.name for one in motions]


@pytest.mark.parametrize(
    ("options", "fit", "judged"), [({}, "slow", "fast"), ({"split": "second"}, "fast", "slow")]
)
def test_the_default_split_counts_or_one_that_is_named(tmp_path, options, fit, judged):
    found = logs(tmp_path, **options)
    assert (names(found.fit), names(found.judged)) == ([fit], [judged])


def test_motions_may_be_held_out_by_motion_condition_or_file(tmp_path):
    assert names(logs(tmp_path, held_out=["slow"]).judged) == ["slow"]
    assert names(logs(tmp_path, held_out=["gain=3"]).judged) == ["fast"]
    with pytest.raises(RobotError, match="all motions are held out, so that nothing is fitted"):
        logs(tmp_path, held_out=["log"])


def test_a_motion_in_no_part_of_a_split_takes_no_part(tmp_path):
    write_parquet(tmp_path, "third", motion=["third"] * 7, t=list(range(7)), gain=[7] * 7)
    logs(tmp_path)
    found = load(tmp_path / "robot.toml", [tmp_path / "log.parquet", tmp_path / "third.parquet"])
    assert names(found.motions) == ["slow", "fast"]
    assert found.losses == ("1 motion is left out, because no part of the split 'first' has it: third",)


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (("b = ", "c = "), {}, "splits.first: there is no part 'b'; there are a, c"),
        (('default = "first"', 'default = "frist"'), {}, "there is no split 'frist'; did you mean 'first'?"),
        (('["gain=3"]', '["gain=4"]'), {}, "part b: 'gain=4' is no motion, condition or file of these logs"),
        (('["gain=3"]', '["gain=3", "slow"]'), {}, "split 'first': motion 'slow' is both fitted and held"),
        (('["a"]\nheld', '["a", "b"]\nheld'), {}, "motion 'fast' is both fitted and held out"),
        (('["gain=3"]', "[]"), {}, "parts.b: "),
        (('["gain=3"]', '["gain=3"]'), {"split": "sceond"}, "has none of this name; did you mean 'second'?"),
        (('["gain=3"]', '["gain=3"]'), {"held_out": ["flow"]}, "held out: 'flow' is no motion, condition"),
    ],
)
def test_what_is_wrong_with_a_split_is_one_sentence(tmp_path, change, options, said):
    with pytest.raises(RobotError) as error:
        logs(tmp_path, change, **options)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_an_hour_between_two_parts_is_told_with_the_windows_that_cut_it(tmp_path):
    early = COLUMNS["t"][:3]
    no_motion = ('columns = ["motion"]\n\n[conditions.gain]\ncolumn = "gain"\n', "")
    robot = write_robot(tmp_path, no_motion, ('gain_column = "gain"\n', ""))
    path = write_parquet(tmp_path, t=[*early, *(3.6e6 + np.array(COLUMNS["t"][3:]))])
    windows = "windows_s = { part1 = [0, 0.02], part2 = [3600, 3600.03] }"
    with pytest.raises(RobotError) as error:
        load(robot, path)
    said = "has 100 a second with 1 gap of up to 3600 s: cut it there, in [motion] "
    assert said + windows in str(error.value)
    robot.write_text(robot.read_text().replace("[motion]\n", f"[motion]\n{windows}\n"))
    assert [one.joints["elbow"].position.value.size for one in load(robot, path).motions] == [3, 4]


def test_parts_in_which_no_joint_settles_are_no_windows():
    found = cut_at_pauses(0.0, [(0.01, 2.0), (6.004, 7.0), (7.2, 9.0)], 12.0)
    assert found == {"part1": [2.0, 6.01], "part2": [9.0, 12.0]}
