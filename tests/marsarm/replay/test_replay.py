"""Replay of a log by today's flight software: every change shows."""

import json

import pytest

import sim.loop
from fsw.config import CYCLE_HZ
from fsw.cycle import step
from marsarm.replaying.replay import ReplayRequest, replay, replay_document, replay_parts
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import Recorder, run_header
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from tests.marsarm.command import marsarm
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
    done = marsarm(tmp_path, "replay", str(log), "--params", "other.toml", "--json")
    assert done.returncode == 3
    document = json.loads(done.stdout)
    assert document["evrs"][0]["recorded"]["name"] == "Booted"
    assert {"channel", "first_tick", "ticks", "greatest", "at_first"} <= document["channels"][0].keys()


def test_the_same_is_status_0(tmp_path):
    done = marsarm(tmp_path, "replay", str(FOLDER / "fault.mcap"))
    assert (done.returncode, done.stderr) == (0, "")
    assert "117 ticks, 1.8 s, 26 channels" in done.stdout


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
