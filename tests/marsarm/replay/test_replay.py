"""Replay of a log by today's flight software: its inputs, every change, and logs that cannot be replayed."""

import json
from dataclasses import replace

import numpy as np
import pytest

import sim.loop
from fsw.config import CYCLE_HZ
from fsw.cycle import step
from fsw.dictionary.enums import Joint
from marsarm.replaying.inputs import NotReplayable, inputs_from_log
from marsarm.replaying.replay import ReplayRequest, replay, replay_document, replay_parts
from marsarm.telemetry.events import CommandEntry
from marsarm.telemetry.format import TICK_NS, LostMessages
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recorder import Recorder, run_header
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from tests.marsarm.command import marsarm, marsarm_json
from tests.replay.remake import FOLDER, make
from tests.replay.runs import RUNS

LOG = FOLDER / "joints.mcap"
TURNS_SLOWER = "[joints.turret]\nspeed_rad_s = 0.02\n"


def replayed(tmp_path, toml: str = "", **request):
    path = tmp_path / "other.toml"
    path.write_text(toml)
    return replay(
        ReplayRequest(request.pop("log", LOG), params=path if toml else None, **request), no_progress
    )


def test_what_would_it_have_done_with_another_parameter(tmp_path):
    (joints,) = (one for one in RUNS if one.name == "joints")
    log = make(joints, tmp_path)
    report = replayed(tmp_path, TURNS_SLOWER, log=log)
    assert report.changed_params == ("joints.turret.speed_rad_s: 0.03490658503988659 is 0.02 now",)
    channels = {one.channel: one for one in report.differences.channels}
    assert channels["/drive.setpoint_rate_rad_s"].first_tick > 190
    assert report.differences.evrs[0].event.name == "Booted"
    document = replay_document(report)
    assert document["identical"] is False
    ticks = [one.first_tick for one in report.differences.channels]
    assert ticks == sorted(ticks)
    first = channels["/drive.setpoint_rate_rad_s"].first_tick
    note = f"driven otherwise from tick {first} ({first / CYCLE_HZ:.2f} s) on"
    for found in (report, replayed(tmp_path, TURNS_SLOWER, log=log, channel="/joint.*")):
        assert any(note in line for line in replay_parts(found))
        assert note in replay_document(found)["notes"][-1]
    document = marsarm_json(tmp_path, "replay", str(log), "--params", "other.toml", status=3)
    assert document["evrs"][0]["recorded"]["name"] == "Booted"
    assert {"channel", "first_tick", "ticks", "greatest", "at_first"} <= document["channels"][0].keys()


def test_the_same_is_status_0(tmp_path):
    done = marsarm(tmp_path, "replay", str(FOLDER / "fault.mcap"))
    assert (done.returncode, done.stderr) == (0, "")
    assert "132 ticks, 2.1 s, 39 channels" in done.stdout


def test_a_channel_that_nobody_has_is_refused(tmp_path):
    with pytest.raises(BadRequest, match=r"channel: nothing is called 'motor'; .*there are /drive\.setpoint"):
        replayed(tmp_path, channel="motor")
    with pytest.raises(BadRequest, match=r"did you mean /joint\.motor_rad\?"):
        replayed(tmp_path, channel="/joint.moter_rad")


@pytest.mark.parametrize("pattern", ["/joint.backlash*", "/joint/backlash*"])
def test_only_channels_that_match_in_either_spelling_are_compared(tmp_path, pattern):
    assert replayed(tmp_path, channel=pattern).differences.channels_compared == 3


def test_a_software_error_in_the_replay_is_a_difference(tmp_path, monkeypatch):
    def broken(config, state, sensors, commands):
        if state.tick == 100:
            raise KeyError("nobody thought of that")
        return step(config, state, sensors, commands)

    monkeypatch.setattr(sim.loop, "step", broken)
    report = replayed(tmp_path)
    added = [one for one in report.differences.evrs if one.recorded is None]
    assert [(one.event.tick, one.event.name) for one in added] == [(100, "SoftwareError")]
    assert "nobody thought of that" in added[0].replayed.message
    assert report.differences.ticks == (read_log(LOG)["/sensors"].size, 101)
    changed = {one.channel: one.first_tick for one in report.differences.channels}
    assert changed["/drive.power_on"] == changed["/drive.brake_release"] == 100
    assert min(changed.values()) == 100
    assert any("SoftwareError" in line for line in replay_parts(report))


def test_a_log_cut_short_replays_as_far_as_it_goes(tmp_path):
    (no_number,) = (one for one in RUNS if one.name == "no-number")
    loop, log = no_number.loop(), tmp_path / "run.mcap"
    with Recorder(log, run_header(loop, "nominal", 0, {}, ()), chunk_cycles=1) as recorder:
        for record in no_number.cycles(loop):
            recorder.write(record)
    written = log.read_bytes()
    log.write_bytes(written[: len(written) // 2])
    report = replayed(tmp_path, log=log)
    assert report.differences.identical
    assert 10 < report.differences.ticks[0] < 80
    assert report.notes[0].startswith("the log was cut short: replayed up to tick")


RECORDED = read_log(FOLDER / "no-number.mcap")
TICKS = len(RECORDED["/sensors"])


def with_header(**values: str | None) -> Log:
    header = {key: value for key, value in (RECORDED.header | values).items() if value is not None}
    return replace(RECORDED, header=header)


def edited(key: str, group: str, **values: object) -> Log:
    """Return the log with other values in a group of an entry of its header."""
    entry = json.loads(RECORDED.header[key])
    entry[group] |= values
    return with_header(**{key: json.dumps(entry)})


def with_sensor_ticks(ticks: np.ndarray) -> Log:
    packets = {**RECORDED.packets, "/sensors": RECORDED["/sensors"][: len(ticks)]}
    times = {**RECORDED.time_ns, "/sensors": (ticks * TICK_NS).astype(np.uint64)}
    return replace(RECORDED, packets=packets, time_ns=times)


def with_command(name: str, fields: str) -> Log:
    return replace(RECORDED, commands=(CommandEntry(0, name, fields),))


def without_field(name: str) -> Log:
    sensors = RECORDED["/sensors"]
    kept = [field for field in sensors.dtype.names if field != name]
    return replace(RECORDED, packets={**RECORDED.packets, "/sensors": sensors[kept]})


REFUSED = {
    "a log without a start": (with_header(boot=None, params=None), "its header has no params, boot, so its"),
    "other parameters": (edited("params", "motion", settle_time_s=0.26), "do not match their own digest"),
    "torn parameters": (with_header(params="{"), "params: is not JSON (Expecting property name"),
    "parameters of another kind": (with_header(params="[]"), "params: [] is not the fields of a Params"),
    "no boot": (with_header(boot="[]"), "boot: must be mode and reference"),
    "no such mode": (with_header(boot='{"mode": "ASLEEP", "reference": null}'), "boot.mode: 'ASLEEP'"),
    "a reference of four joints": (
        edited("boot", "reference", zero_rad=[0.0] * 4),
        "boot.reference.zero_rad: has shape (4,)",
    ),
    "no such command": (with_command("Jump", "{}"), "command: 'Jump' is not known"),
    "torn arguments": (with_command("Stop", "{"), "Expecting property name"),
    "no sensors": (replace(RECORDED, packets={}), "has no /sensors, so there is nothing to replay; give"),
    "a late beginning": (with_sensor_ticks(np.arange(5, 9)), "begins at tick 5; the state of flight"),
    "one tick": (replace(with_sensor_ticks(np.arange(1)), truncated=True), "no tick that is surely complete"),
    "no currents": (without_field("current_A"), "/sensors.current_A is missing"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_log_that_cannot_be_replayed_is_refused_with_a_sentence(case):
    log, message = REFUSED[case]
    with pytest.raises(NotReplayable) as caught:
        inputs_from_log(log)
    assert str(caught.value).startswith(f"log {RECORDED.path}: ")
    assert message in str(caught.value)


def test_sensors_of_another_shape_are_refused():
    sensors = RECORDED["/sensors"]
    four = np.zeros(len(sensors), [("current_A", "<f8", (4,)), ("cycle", "<i8")])
    names = [name for name in sensors.dtype.names if name not in four.dtype.names]
    whole = np.zeros(
        len(sensors), four.dtype.descr + [(n, sensors.dtype[n].base, sensors.dtype[n].shape) for n in names]
    )
    with pytest.raises(
        NotReplayable, match=r"current_A is float64\(4,\); flight software reads float64\(5,\)"
    ):
        inputs_from_log(replace(RECORDED, packets={"/sensors": whole}))


def test_a_whole_log_is_replayed_to_its_end():
    inputs = inputs_from_log(RECORDED)
    assert inputs.ticks == TICKS
    assert inputs.notes == ()
    assert [len(commands) for commands in inputs.commands.values()] == [1]


SHORT = {
    "cut short": (replace(RECORDED, truncated=True), "the log was cut short", TICKS - 1),
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
    recovered = replace(RECORDED, lost=(lost,))
    if ticks is None:
        with pytest.raises(NotReplayable, match="no tick that is surely complete"):
            inputs_from_log(recovered)
    else:
        inputs = inputs_from_log(recovered)
        assert inputs.ticks == ticks
        assert inputs.notes[0] == f"recovered: {lost.sentence}"


def test_parameters_that_were_not_known_then_are_todays_and_reported():
    params = json.loads(RECORDED.header["params"])
    del params["joints"]["wrist"]["speed_rad_s"]
    inputs = inputs_from_log(with_header(params=json.dumps(params)))
    assert inputs.params.joints.wrist.speed_rad_s > 0
    assert inputs.notes[0].startswith("params.joints.wrist.speed_rad_s was not known then")


def test_sensors_are_what_was_recorded_in_memory_of_their_own():
    inputs = inputs_from_log(RECORDED)
    sensors = inputs.sensors_at(70)
    assert type(sensors.cycle) is int
    assert np.isnan(sensors.current_A[Joint.WRIST])
    assert sensors.encoder_count.tolist() == RECORDED["/sensors"]["encoder_count"][70].tolist()
    assert sensors.encoder_count.base is None
