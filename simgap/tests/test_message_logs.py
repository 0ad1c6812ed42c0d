"""Logs of messages: joints by name, bags, damaged files, flipped bits, clocks, numbers that are none."""

import json
import re
import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from mcap.writer import CompressionType

from helpers.message_logs import BY_PLACE, BY_TOPIC, START_NS, joint_state, rows, write_bag, write_mcap
from helpers.robot_folder import MODEL, write_robot
from simgap.checks.audit import audit
from simgap.checks.records import RemarkKind
from simgap.common.errors import RobotError
from simgap.files.log_file import open_log, open_whole
from simgap.files.mcap_log import BadMessage, make_decoder
from simgap.files.robot_file import CsvTable
from simgap.loading import load
from simgap.robot import Robot


@pytest.fixture(params=[BY_TOPIC, BY_PLACE], ids=["topic", "place"])
def robot(tmp_path, request):
    return write_robot(tmp_path, text=request.param)


def check(logs, n=5):
    (motion,) = logs.motions
    shoulder, elbow = motion.joints["shoulder"], motion.joints["elbow"]
    np.testing.assert_allclose(shoulder.position.value, np.arange(n))
    np.testing.assert_allclose(elbow.position.value, -np.arange(n))
    np.testing.assert_allclose(shoulder.position.time_s, 0.01 * np.arange(n))
    np.testing.assert_allclose(shoulder.command.value, 10.0 * np.arange(n))
    assert shoulder.velocity is None
    assert elbow.torque is None


FORMS = {
    "chunks": {},
    "cdr": {"definition": "ros2msg"},
    "no_chunks": {"use_chunking": False},
    "lz4": {"compression": CompressionType.LZ4},
    "plain": {"compression": CompressionType.NONE},
    "no_summary": {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False},
}


@pytest.mark.parametrize("form", FORMS)
def test_joints_are_read_by_name_from_every_form_of_mcap(robot, tmp_path, form):
    check(load(robot, write_mcap(tmp_path / "log.mcap", rows(), **FORMS[form])))


def test_each_signal_has_the_times_of_its_messages(robot, tmp_path):
    messages = [one for k, one in enumerate(rows()) if k % 4 != 3]  # every second command
    (motion,) = load(robot, write_mcap(tmp_path / "run.mcap", messages)).motions
    assert motion.name == "run"
    shoulder = motion.joints["shoulder"]
    np.testing.assert_allclose(shoulder.position.time_s, 0.01 * np.arange(5))
    np.testing.assert_allclose(shoulder.command.time_s, [0.0, 0.02, 0.04])
    np.testing.assert_allclose(shoulder.command.value, [0.0, 20.0, 40.0])


@pytest.mark.parametrize("definition", ["float64 x", "odd/Kind x"])
def test_a_message_that_is_cut_short_or_of_an_unknown_type_is_refused(definition):
    with pytest.raises(BadMessage, match="a message of a/B does not fit its definition"):
        make_decoder("cdr", "ros2msg", "a/B", definition.encode())(b"\0\1\0\0")


def test_messages_of_an_unknown_encoding_and_motions_in_a_column_are_refused(robot, tmp_path):
    said = "topic '/joint_.*' is encoded as cdr with omgidl; write json, or a message of ROS"
    with pytest.raises(RobotError, match=said):
        load(robot, write_mcap(tmp_path / "log.mcap", rows(), definition="omgidl"))
    robot.write_text(f'{robot.read_text()}\n[motion]\ncolumns = ["/joint_command.name"]\n')
    with pytest.raises(RobotError, match="a log of messages has no rows; in "):
        load(robot, write_mcap(tmp_path / "log.mcap", rows()))


@pytest.mark.parametrize(
    ("column", "said"),
    [
        ("/joint_state.position[0]", "has no column '/joint_state', which robot file or mapping names"),
        ("/joint_states.place[0]", "'/joint_states.place[0]': there is no 'place' in a message"),
        ("/joint_states.position[7]", "has no column '/joint_states.position[7]', which robot file or map"),
        ("/joint_states.name[0]", "'/joint_states.name[shoulder]' has str; name a number in it"),
        ("/joint_states.position 0", "there is no 'position 0' in a message, which has"),
        ("/joint_states.position[0", "is no field; write a topic and a field"),
    ],
)
def test_a_field_that_is_not_there_is_named(tmp_path, column, said):
    robot = write_robot(tmp_path, ("/joint_states.position[0]", column), text=BY_PLACE)
    with pytest.raises(RobotError, match=re.escape(said)):
        load(robot, write_mcap(tmp_path / "log.mcap", rows(), "ros2msg"))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (b'{"sec": null}', "column '/command.deg' is empty; a signal needs numbers"),
        (b'{"sec": [1]}', "'/command.deg' has list; name a number in it"),
        (b"1" + 400 * b"0", "'/command.deg', motion 'log': is no finite number at 0 s"),
        (100_000 * b"[", "a message is nested too deeply; write fields of a few levels"),
    ],
)
def test_a_message_without_a_usable_number_is_refused(tmp_path, value, said):
    command = 'command = { column = "/command.deg", unit = "deg" }'
    robot = write_robot(tmp_path, ('command_topic = "/joint_command"', command), text=BY_TOPIC)
    messages = [*rows()[::2], ("/command", START_NS, b'{"deg": %s}' % value)]
    with pytest.raises(RobotError, match=re.escape(said)):
        load(robot, write_mcap(tmp_path / "log.mcap", messages))


@pytest.mark.parametrize("name", ["log.bag", "log"])
def test_joints_are_read_by_name_from_bags(robot, tmp_path, name):
    check(load(robot, write_bag(tmp_path / name, rows())))


def test_a_database_of_a_bag_may_be_named_alone(robot, tmp_path):
    write_bag(tmp_path / "log", rows())
    check(load(robot, tmp_path / "log" / "log.db3"))


def test_messages_of_other_publishers_are_passed_over(robot, tmp_path):
    finger = ("/joint_states", START_NS - 1_000, joint_state(0, ("finger",)))
    logs = load(robot, write_mcap(tmp_path / "log.mcap", [finger, *rows()]))
    np.testing.assert_allclose(logs.motions[0].joints["shoulder"].position.value, np.arange(5))


def test_joints_that_have_numbers_as_names_are_read_by_name(tmp_path):
    messages = [("/motors", k, {"name": ["1", "0"], "position": [10.0, 20.0]}) for k in range(3)]
    path = write_mcap(tmp_path / "log.mcap", messages)
    name = "/motors.position[1]"
    assert [one.lowest for one in open_whole(path).describe() if one.name == name] == [10.0]
    log = open_log(path, [name], [], CsvTable())
    assert log.numbers(name).value.tolist() == [10.0] * 3
    assert not log.names_at(name)


def test_a_place_of_another_joint_is_refused_with_the_right_column(tmp_path):
    robot = write_robot(tmp_path, ("position[0]", "position[2]"), ("[1]", "[0]"), text=BY_PLACE)
    three = ("shoulder", "elbow", "finger")
    messages = [(topic, time_ns, joint_state(0, three)) for topic, time_ns, _ in rows()]
    said = r"'/joint_states.position\[0\]' is that of 'shoulder' in the messages"
    with pytest.raises(RobotError, match=said):
        load(robot, write_mcap(tmp_path / "log.mcap", messages))


@pytest.mark.parametrize(
    ("write", "name"), [(write_mcap, "log.mcap"), (write_bag, "log.bag"), (write_bag, "log")]
)
def test_a_clock_that_steps_back_is_refused_with_topic_and_message(robot, tmp_path, write, name):
    messages = rows()
    messages[6:] = [(topic, time_ns - 10**9, content) for topic, time_ns, content in messages[6:]]
    with pytest.raises(RobotError, match=r"topic '/joint_.*': the clock steps back .* at message 4"):
        load(robot, write(tmp_path / name, messages))


def test_a_signal_that_never_is_a_number_is_absent_and_told(tmp_path):
    never = write_mcap(tmp_path / "log.mcap", rows(velocity=[np.nan, np.nan]))
    logs = load(write_robot(tmp_path, text=BY_TOPIC), never)
    check(logs)
    (velocity, torque) = logs.losses
    columns = "/joint_states.velocity[shoulder], /joint_states.velocity[elbow]"
    assert f"there is no velocity of shoulder, elbow: {columns} never has a number" in velocity
    assert "there is no torque of shoulder, elbow" in torque


def test_a_number_that_is_none_among_others_is_refused_with_message_and_time(robot, tmp_path):
    messages = rows()
    messages[4][2]["position"][0] = np.nan
    with pytest.raises(RobotError, match=r"is no finite number at 0.02 s, message 3 of its topic"):
        load(robot, write_mcap(tmp_path / "log.mcap", messages))


def test_numbers_that_are_none_before_the_first_are_left_out_and_told(robot, tmp_path):
    messages = rows()
    for _, _, content in messages[:3:2]:
        content["position"] = [np.nan, np.nan]
    logs = load(robot, write_mcap(tmp_path / "log.mcap", messages))
    shoulder = logs.motions[0].joints["shoulder"].position
    np.testing.assert_allclose(shoulder.value, [2.0, 3.0, 4.0])
    np.testing.assert_allclose(shoulder.time_s, [0.02, 0.03, 0.04])
    assert any("is no number before its value 3; 2 are left out" in one for one in logs.losses)


@pytest.mark.parametrize("name", ["log.mcap", "log.bag", "log"])
@pytest.mark.parametrize("early_s", [0, 2])
def test_a_pause_is_told_with_the_windows_that_cut_it(robot, tmp_path, name, early_s):
    messages = rows(20)
    late = [(topic, time_ns + 10**9, content) for topic, time_ns, content in messages[20:]]
    early = [("/other", START_NS - early_s * 10**9, messages[0][2])]
    write = write_mcap if name == "log.mcap" else write_bag
    path = write(tmp_path / name, early + messages[:20] + late)
    read = Robot.from_toml(robot)
    (remark,) = [one for one in audit(read, load(read, path)).remarks if one.kind is RemarkKind.PAUSE]
    low, high = (([0, 0.09], [1.1, 1.19]), ([2, 2.09], [3.1, 3.19]))[early_s // 2]
    windows = f"windows_s = {{ part1 = {low}, part2 = {high} }}"
    assert windows in remark.text
    robot.write_text(f"{robot.read_text()}\n[motion]\n{windows}\n")
    assert [one.joints["elbow"].position.value.size for one in load(robot, path).motions] == [10, 10]


def test_a_database_that_is_no_bag_says_what_to_name(robot, tmp_path):
    with closing(sqlite3.connect(tmp_path / "log.db3")) as database:
        database.execute("CREATE TABLE messages(id INTEGER)")
    with pytest.raises(RobotError, match=r"cannot be read: .*; name the folder .* `ros2 bag reindex FOLDER`"):
        load(robot, tmp_path / "log.db3")


def test_a_folder_of_a_bag_without_its_list_says_what_writes_it(robot, tmp_path):
    write_bag(tmp_path / "log", rows())
    (tmp_path / "log" / "metadata.yaml").unlink()
    with pytest.raises(RobotError, match=r"has no metadata.yaml; `ros2 bag reindex .*log` writes it"):
        load(robot, tmp_path / "log")


def test_a_file_that_was_cut_is_used_and_the_loss_told(robot, tmp_path):
    path = write_mcap(tmp_path / "log.mcap", rows(20))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    logs = load(robot, path)
    n = logs.motions[0].joints["shoulder"].position.value.size
    assert 2 <= n < 20
    assert any("is cut; the first" in one and "are used" in one for one in logs.losses)
    for n in (100, 5):
        path.write_bytes(path.read_bytes()[:n])
        with pytest.raises(RobotError, match="cannot be read: it is cut before its first message"):
            load(robot, path)


def test_a_damaged_chunk_is_refused_with_its_place_and_time(robot, tmp_path):
    path = write_mcap(tmp_path / "log.mcap", rows(), compression=CompressionType.NONE)
    data = path.read_bytes()
    path.write_bytes(data.replace(b'"position": [1', b'"position": [7', 1).replace(b"[-1.0", b"[-5.0", 1))
    with pytest.raises(RobotError, match=r"the chunk that begins at 1700000000.0\d+ s is damaged"):
        load(robot, path)


def test_a_log_is_cut_into_motions_by_windows(robot, tmp_path):
    text = f"{robot.read_text()}\n[motion.windows_s]\nfirst = [0.0, 0.03]\nsecond = [0.05, 0.08]\n"
    robot.write_text(text)
    first, second = load(robot, write_mcap(tmp_path / "log.mcap", rows(20))).motions
    assert (first.name, second.name) == ("first", "second")
    np.testing.assert_allclose(first.joints["shoulder"].position.value, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(second.joints["elbow"].position.value, [-5.0, -6.0, -7.0, -8.0])
    np.testing.assert_allclose(second.joints["elbow"].position.time_s, [0.0, 0.01, 0.02, 0.03])
    robot.write_text(text.replace("[0.05, 0.08]", "[5.0, 8.0]"))
    with pytest.raises(RobotError, match="has no value in motion 'second'"):
        load(robot, tmp_path / "log.mcap")


def test_a_bag_that_was_not_closed_and_json_of_another_form_are_refused(robot, tmp_path):
    path = write_bag(tmp_path / "log.bag", rows())
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(RobotError, match=r"log\.bag: cannot be read: "):
        load(robot, path)
    other = write_mcap(tmp_path / "log.mcap", [("/joint_states", START_NS, json.loads("[1, 2]"))])
    with pytest.raises(RobotError):
        load(robot, other)


def test_a_topic_gives_a_slide_in_its_own_units(tmp_path):
    slide = MODEL.replace('name="shoulder" axis', 'name="shoulder" type="slide" axis')
    robot = write_robot(tmp_path, model=slide, text=BY_TOPIC)
    check(load(robot, write_mcap(tmp_path / "log.mcap", rows())))


N_ROWS = 120
TABLE = {f"j{k}": np.random.default_rng(k).normal(size=N_ROWS).cumsum() for k in (1, 2)}
TABLE = {"t": np.arange(N_ROWS) * 0.01} | TABLE
JOINTS = ("/joint_states.position[shoulder]", "/joint_states.position[elbow]")


def write_json_lines(path):
    table = np.transpose(list(TABLE.values())).tolist()
    row = (json.dumps(dict(zip(TABLE, one, strict=True))) for one in table)
    path.write_text("\n".join(row) + "\n")


def write_sqlite(path):
    write_bag(path.parent / "bag", rows(N_ROWS))
    path.write_bytes((path.parent / "bag" / "bag.db3").read_bytes())


@dataclass(frozen=True)
class LogFormat:
    name: str
    write: object
    columns: tuple[str, ...] = tuple(TABLE)
    has_checksum: bool = True


FORMATS = (
    LogFormat("log.csv", lambda path: pacsv.write_csv(pa.table(TABLE), path), has_checksum=False),
    LogFormat("log.jsonl", write_json_lines, has_checksum=False),
    LogFormat("log.npz", lambda path: np.savez_compressed(path, **TABLE)),
    LogFormat("log.parquet", lambda path: pq.write_table(pa.table(TABLE), path, write_page_checksum=True)),
    LogFormat("log.mcap", partial(write_mcap, messages=rows(N_ROWS)), JOINTS),
    LogFormat(
        "unchunked.mcap",
        partial(write_mcap, messages=rows(N_ROWS), use_chunking=False, enable_data_crcs=True),
        JOINTS,
    ),
    LogFormat("log.bag", partial(write_bag, messages=rows(N_ROWS)), JOINTS, False),
    LogFormat("bzip2.bag", partial(write_bag, messages=rows(N_ROWS), is_packed=True), JOINTS),
    LogFormat("log.db3", write_sqlite, JOINTS, False),
)


def read_all(form, path):
    """Read times and numbers of the columns, and what is told of the log."""
    log = open_log(path, form.columns, (), CsvTable())
    columns = [log.numbers(name) for name in form.columns]
    return [(one.value, one.time_s, one.is_present) for one in columns], log.losses


def is_same(found, written):
    """Tell whether all columns have the same numbers at the same times."""
    pairs = [pair for columns in zip(found, written, strict=True) for pair in zip(*columns, strict=True)]
    return all(
        a is b or (a is not None and b is not None and np.array_equal(a, b, equal_nan=True)) for a, b in pairs
    )


def judge(form, path, written):
    """Read a damaged log; any error but that of the user is a bug."""
    with suppress(RobotError):
        open_whole(path).describe()
    try:
        found, losses = read_all(form, path)
    except RobotError as error:
        return "refused" if "\n" not in str(error) else "two lines"
    return "harmless" if is_same(found, written) else "told" if losses else "other numbers"


@pytest.mark.parametrize(
    ("tries", "form"),
    [
        pytest.param(tries, form, marks=[pytest.mark.slow] if tries > 15 else [], id=f"{form.name}-{tries}")
        for tries, form in product((15, 100), FORMATS)
    ],
)
def test_a_flipped_bit_changes_no_number_without_a_word(form, tries, tmp_path):
    path, random = tmp_path / form.name, np.random.default_rng(tries)
    form.write(path)
    data, (written, _) = path.read_bytes(), read_all(form, path)
    judged = []
    for at, bit in zip(random.integers(len(data), size=tries), random.integers(8, size=tries), strict=True):
        damaged = bytearray(data)
        damaged[at] ^= 1 << bit
        path.write_bytes(damaged)
        judged.append(judge(form, path, written))
    assert "refused" in judged
    more = set() if form.has_checksum else {"other numbers"}
    assert set(judged) <= {"refused", "harmless", "told"} | more
