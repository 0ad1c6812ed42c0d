"""Inputs of a replay from a log, and refusal of logs that cannot be replayed."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.replaying.inputs import NotReplayable, inputs_from_log
from marsarm.telemetry.events import CommandEntry
from marsarm.telemetry.format import TICK_NS, LostMessages
from marsarm.telemetry.read import Log, read_log
from tests.replay.remake import FOLDER

LOG = read_log(FOLDER / "no-number.mcap")
TICKS = len(LOG["/sensors"])


def with_header(**values: str | None) -> Log:
    header = {key: value for key, value in (LOG.header | values).items() if value is not None}
    return replace(LOG, header=header)


def with_params(group: str, **values: object) -> Log:
    params = json.loads(LOG.header["params"])
    params[group] |= values
    return with_header(params=json.dumps(params))


def with_sensor_ticks(ticks: np.ndarray) -> Log:
    packets = {**LOG.packets, "/sensors": LOG["/sensors"][: len(ticks)]}
    times = {**LOG.time_ns, "/sensors": (ticks * TICK_NS).astype(np.uint64)}
    return replace(LOG, packets=packets, time_ns=times)


def with_commands(*entries: CommandEntry) -> Log:
    return replace(LOG, commands=entries)


def without_field(name: str) -> Log:
    sensors = LOG["/sensors"]
    kept = [field for field in sensors.dtype.names if field != name]
    return replace(LOG, packets={**LOG.packets, "/sensors": sensors[kept]})


def with_boot(**values: object) -> Log:
    boot = json.loads(LOG.header["boot"])
    boot["reference"] |= values
    return with_header(boot=json.dumps(boot))


REFUSED = {
    "a log without a start": (with_header(boot=None, params=None), "its header has no params, boot, so its"),
    "other parameters": (with_params("motion", settle_time_s=0.26), "do not match their own digest"),
    "torn parameters": (with_header(params="{"), "params: is not JSON (Expecting property name"),
    "parameters of another kind": (with_header(params="[]"), "params: [] is not the fields of a Params"),
    "no boot": (with_header(boot="[]"), "boot: must be mode and reference"),
    "no such mode": (with_header(boot='{"mode": "ASLEEP", "reference": null}'), "boot.mode: 'ASLEEP'"),
    "a reference of four joints": (with_boot(zero_rad=[0.0] * 4), "boot.reference.zero_rad: has shape (4,)"),
    "no such command": (with_commands(CommandEntry(0, "Jump", "{}")), "command: 'Jump' is not known"),
    "torn arguments": (with_commands(CommandEntry(0, "Stop", "{")), "Expecting property name"),
    "no sensors": (replace(LOG, packets={}), "has no /sensors, so there is nothing to replay; give"),
    "a late beginning": (with_sensor_ticks(np.arange(5, 9)), "begins at tick 5; the state of flight"),
    "one tick": (replace(with_sensor_ticks(np.arange(1)), truncated=True), "no tick that is surely complete"),
    "no currents": (without_field("current_A"), "/sensors.current_A is missing"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_log_that_cannot_be_replayed_is_refused_with_a_sentence(case):
    log, message = REFUSED[case]
    with pytest.raises(NotReplayable) as caught:
        inputs_from_log(log)
    assert str(caught.value).startswith(f"log {LOG.path}: ")
    assert message in str(caught.value)


def test_sensors_of_another_shape_are_refused():
    sensors = LOG["/sensors"]
    four = np.zeros(len(sensors), [("current_A", "<f8", (4,)), ("cycle", "<i8")])
    names = [name for name in sensors.dtype.names if name not in four.dtype.names]
    whole = np.zeros(len(sensors), four.dtype.descr + [(n, *_descr(sensors.dtype[n])) for n in names])
    with pytest.raises(
        NotReplayable, match=r"current_A is float64\(4,\); flight software reads float64\(5,\)"
    ):
        inputs_from_log(replace(LOG, packets={"/sensors": whole}))


def _descr(dtype: np.dtype) -> tuple:
    return (dtype.base, dtype.shape)


def test_a_whole_log_is_replayed_to_its_end():
    inputs = inputs_from_log(LOG)
    assert inputs.ticks == TICKS
    assert inputs.notes == ()
    assert [len(commands) for commands in inputs.commands.values()] == [1]


SHORT = {
    "cut short": (replace(LOG, truncated=True), "the log was cut short", TICKS - 1),
    "a missing tick": (
        with_sensor_ticks(np.concatenate([np.arange(20), np.arange(30, 50)])),
        "something after tick 19 is missing",
        19,
    ),
}


@pytest.mark.parametrize(("log", "why", "ticks"), SHORT.values(), ids=SHORT)
def test_a_log_is_replayed_to_the_last_tick_that_is_surely_whole(log, why, ticks):
    inputs = inputs_from_log(log)
    assert inputs.ticks == ticks
    note = f"{why}: replayed up to tick {ticks - 1}, the last that is surely complete"
    assert inputs.notes == (note,)


@pytest.mark.parametrize(
    ("topic", "after_tick", "ticks"),
    [
        ("/command", None, None),
        ("/command", 40, 40),
        (None, 30, 30),
        ("/sensors", 20, 20),
        ("/evr", 5, TICKS),
    ],
)
def test_a_recovered_log_is_replayed_up_to_the_first_lost_input(topic, after_tick, ticks):
    lost = LostMessages(topic, 1, None if after_tick is None else after_tick * TICK_NS, None)
    recovered = replace(LOG, lost=(lost,))
    if ticks is None:
        with pytest.raises(NotReplayable, match="no tick that is surely complete"):
            inputs_from_log(recovered)
    else:
        inputs = inputs_from_log(recovered)
        assert inputs.ticks == ticks
        assert inputs.notes[0] == f"recovered: {lost.sentence}"


def test_parameters_that_were_not_known_then_are_todays_and_reported():
    params = json.loads(LOG.header["params"])
    del params["joints"]["wrist"]["speed_rad_s"]
    inputs = inputs_from_log(with_header(params=json.dumps(params)))
    assert inputs.params.joints.wrist.speed_rad_s > 0
    assert inputs.notes[0].startswith("params.joints.wrist.speed_rad_s was not known then")


def test_sensors_are_what_was_recorded_in_memory_of_their_own():
    inputs = inputs_from_log(LOG)
    sensors = inputs.sensors_at(70)
    assert type(sensors.cycle) is int
    assert np.isnan(sensors.current_A[Joint.WRIST])
    assert sensors.encoder_count.tolist() == LOG["/sensors"]["encoder_count"][70].tolist()
    assert sensors.encoder_count.base is None
