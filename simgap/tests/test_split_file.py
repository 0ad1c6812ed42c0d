"""Splits: what is fitted never judges, and a name that matches nothing is an error."""

import pytest

from helpers.robot_folder import write_parquet, write_robot
from simgap.common.errors import RobotError
from simgap.loading import load
from simgap.robot import Robot

SPLIT = """default = "first"
[parts]
a = ["slow"]
b = ["3"]
[splits.first]
fit = ["a"]
held_out = ["b"]
[splits.second]
held_out = ["a"]
"""


def logs(folder, *changes, **options):
    """Load with a split file that has changes."""
    text = SPLIT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "split.toml").write_text(text)
    path = write_robot(folder, ('model = "model.xml"', 'model = "model.xml"\nsplit = "split.toml"'))
    return load(path, write_parquet(folder), **options)


def names(motions):
    return [one.name for one in motions]


def test_the_default_split_counts(tmp_path):
    found = logs(tmp_path)
    assert (names(found.fit), names(found.judged)) == (["slow"], ["fast"])


def test_another_split_may_be_named(tmp_path):
    found = logs(tmp_path, split="second")
    assert (names(found.fit), names(found.judged)) == (["fast"], ["slow"])


def test_motions_may_be_held_out_by_motion_condition_or_file(tmp_path):
    assert names(logs(tmp_path, held_out=["slow"]).judged) == ["slow"]
    assert names(logs(tmp_path, held_out=["3"]).judged) == ["fast"]
    with pytest.raises(RobotError, match="all motions are held out, so that nothing is fitted"):
        logs(tmp_path, held_out=["log"])


def test_a_motion_in_no_part_of_a_split_takes_no_part(tmp_path):
    write_parquet(tmp_path, "third", motion=["third"] * 7, t=list(range(7)), gain=[7] * 7)
    logs(tmp_path)
    found = load(tmp_path / "robot.toml", [tmp_path / "log.parquet", tmp_path / "third.parquet"])
    assert names(found.motions) == ["slow", "fast"]


def test_without_a_split_all_motions_are_fitted(tmp_path):
    found = load(Robot.from_toml(write_robot(tmp_path)), write_parquet(tmp_path))
    assert (names(found.fit), found.held_out) == (["slow", "fast"], frozenset())


def test_a_split_without_a_split_file_is_an_error(tmp_path):
    write_robot(tmp_path)
    write_parquet(tmp_path)
    with pytest.raises(RobotError, match="split 'first': the robot file names no split file"):
        load(tmp_path / "robot.toml", tmp_path / "log.parquet", split="first")


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (("b = ", "c = "), {}, "splits.first: there is no part 'b'; there are a, c"),
        (('default = "first"', 'default = "frist"'), {}, "there is no split 'frist'; did you mean 'first'?"),
        (('["3"]', '["4"]'), {}, "part b: '4' is no motion, condition or file of these logs"),
        (('["3"]', '["3", "slow"]'), {}, "split 'first': motion 'slow' is both fitted and held out"),
        (('["a"]\nheld', '["a", "b"]\nheld'), {}, "motion 'fast' is both fitted and held out"),
        (('["3"]', "[]"), {}, "parts.b: "),
        (('["3"]', '["3"]'), {"split": "sceond"}, "has none of this name; did you mean 'second'?"),
        (('["3"]', '["3"]'), {"held_out": ["flow"]}, "held out: 'flow' is no motion, condition or file of"),
    ],
)
def test_what_is_wrong_with_a_split_is_one_sentence(tmp_path, change, options, said):
    with pytest.raises(RobotError) as error:
        logs(tmp_path, change, **options)
    assert said in str(error.value)
    assert "\n" not in str(error.value)
