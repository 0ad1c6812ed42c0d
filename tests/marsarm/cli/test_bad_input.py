"""Wrong input of every verb: one sentence, the right status, nothing written, no file left behind.

The table holds wrong files of each kind, numbers, and options that contradict each other.
"""

import json
import os
import re
import shlex
from pathlib import Path

import pytest

from helpers.command import LIBRARY_WORDS, snapshot
from marsarm.telemetry.format import FORMAT
from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.recorder import Recorder
from tests.marsarm.command import SHORT_RUN, largest_file, marsarm
from tests.marsarm.telemetry.lab import cycle_at

SEVERAL = re.compile(r"\d+ things are wrong, one in each line:")

BROKEN_EFFECT = """\
from dataclasses import dataclass

from sim.effects.effect import Effect


@dataclass(frozen=True, slots=True)
class Boom(Effect):
    \"\"\"Divides by zero.\"\"\"

    size: float = 1.0

    def on_hardware(self, hardware):
        return hardware / 0
"""
FAR_PLACE = """\
type = "PLACE_TOOL"
tool = "apxs"
position_m = [3.4, 0.0, -0.2]
approach = [0.0, 0.0, 1.0]
"""
TEXTS = {
    "short_run.toml": SHORT_RUN,
    "beyond_run.toml": SHORT_RUN.replace("= 95", "= 390"),
    "wrong_run.toml": SHORT_RUN.replace("angle_deg", "angle").replace('"turret"', '"tower"'),
    "far_run.toml": SHORT_RUN.replace("[[check]]", f"[[command]]\n{FAR_PLACE}\n[[check]]"),
    "tilted_run.toml": SHORT_RUN.replace(
        "[[command]]", '[[command]]\ntype = "SET_TILT"\nroll_deg = 10\npitch_deg = 0\n\n[[command]]'
    ),
    "good.toml": "[joints.elbow]\nspeed_rad_s = 0.01\n",
    "fast.toml": "[joints.elbow]\nspeed_rad_s = 5.0\n",
    "through.toml": "[poses]\nunstow_via_rad = [[-3.0, 0.0, 0.0, 0.0, 0.0]]\n",
    "arm7.toml": 'arm_name = "as-built:7"\n',
    "empty.toml": "",
    "half.toml": "[motion\n",
    "huge.toml": f"[motion]\ntakeup_rad = 1{'0' * 400}\n",
    "foreign.toml": "[links.arm2.transform]\na_m = 0.3\n",
    "bad_command.toml": "title = 'a'\n[[command]]\ntype = 'FLY'\n[[check]]\ntype = 'done'\n",
    "boom.py": BROKEN_EFFECT,
    "exits.py": "raise SystemExit(0)\n",
    "ragged.csv": "a,b\n1\n2,3,4\n",
    "few.csv": "a,b\n1,2\n",
    "cut.parquet": "PAR1xx",
    "empty.mcap": "",
    "text.mcap": "hello",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of files that no verb can use, and of one good log."""
    folder = tmp_path_factory.mktemp("bad")
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    (folder / "bytes.csv").write_bytes(b"a,b\n\xff\xfe\x00\x01,2\n")
    with (folder / "sparse.toml").open("wb") as file:
        file.truncate(1 << 30)
    os.mkfifo(folder / "pipe.mcap")
    for suffix in ("toml", "mcap"):
        (folder / f"folder.{suffix}").mkdir()
        (folder / f"loop.{suffix}").symlink_to(f"loop.{suffix}")
    (folder / "dangling.png").symlink_to("nowhere/there.png")
    (folder / "link.mcap").symlink_to("good.toml")
    with Recorder(folder / "run.mcap", {"seed": "1", "arm": "nominal"}) as recorder:
        for tick in range(8):
            recorder.write(cycle_at(tick))
    with Recorder(folder / "header.mcap", {"seed": "1", "arm": "nominal"}):
        pass
    data = (folder / "run.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(data[:40])
    begin, _ = read_records(data).chunks[0]
    (folder / "flipped.mcap").write_bytes(
        data[: begin + 80] + bytes([data[begin + 80] ^ 8]) + data[begin + 81 :]
    )
    version = b"version\x01\0\0\0" + FORMAT.encode()
    (folder / "later.mcap").write_bytes(data.replace(version, version[:-1] + b"9"))
    (folder / "full").mkdir()
    (folder / "full" / "a.txt").write_text("something")
    return folder


CASES = {
    # usage
    "nosuch": "No such command",
    "place --foo": "No such option: --foo; `",
    "place --targt 2 0 0": "No such option: --targt; did you mean --target?; `",
    "place --target 1 2": "requires 3 arguments",
    "place --seed much": "'--seed': takes 1 whole number",
    "log info": "Missing argument 'LOG'",
    # numbers
    "place --target nan 0 0": "not three finite numbers",
    "place --target 1e9 0 0": "farther than 20 m",
    "place --normal 0 0 0": "has no direction",
    "place --tilt-roll nan": "is not finite",
    "place --seed -1": "seed: -1 is below 0",
    "hardstop --temperature -300": "temperature: -300",
    "reach --warming nan": "warming",
    "budget --poses 10": "poses: 10 is not within",
    "monte-carlo --arms 99999999999999999999": "arms: 99999999999999999999 is not within",
    "calibrate --arm nominal --tracker 0 0": "tracker: its noise",
    f"place --arm {300 * 'a'}": "is not known; write nominal",
    "arm full": "arm 'full': this folder has no arm.toml",
    f"arm --build {300 * 'a'}": "is not known; there are m2020, msl",
    "log info run.mcap --from 3 --to 2": "from: 3.0 s is not before --to 2.0 s",
    "log info run.mcap --from nan": "is no log time",
    "place --target 9 9 9": "out of reach",
    "place --target 1.3 -1 -0.1 --normal 0 1 0": "joint elevation: about 12",
    "place --target 0 0 -0.8": "inside the rover",
    "place --tilt-roll 25 --tilt-pitch 25": "34.8 deg",
    # contradictions
    "ik": "position and approach: give both",
    "place --params good.toml --log ./good.toml": "the file of params",
    "place --params link.mcap --log good.toml": "the file of params",
    "monte-carlo --results a.jsonl --report a.jsonl": "this is the file of",
    "calibrate": "give --arm ARM",
    "calibrate --data few.csv --verify 3": "give no --data",
    "log import few.csv empty.toml few.csv": "this is the file of table too",
    "log import few.csv empty.toml out.txt": "OUT out.txt: its name must end in .mcap",
    # names
    "run contact-sciense": "did you mean contact-science?",
    "run nosuch.toml": "nosuch.toml: cannot be read",
    "hardstop --joint knee": "there are azimuth",
    "place --tool hammer": "cannot be placed",
    "budget --tool spoon": "tool: 'spoon' is not known; there are drill",
    "monte-carlo --case venus": "case: 'venus' is not known; there are accuracy",
    "run short_run.toml --effect warming:warming_K=9e9": "warming_K: 9e+09 is outside -200 .. 200",
    "gap record --out new --effect rusty-gear": "'rusty-gear' is not known",
    "gap record --out new --motion a.toml --sessions poses": "motion, sessions: they exclude each other",
    "gap record --out new --sessions poses-levl-*": "sessions: nothing is called 'poses-levl-*'",
    # parameters
    "place --params nosuch.toml": "nosuch.toml: cannot be read (No such file or directory)",
    "place --params half.toml": "is not TOML",
    "place --params huge.toml": "takeup_rad",
    "place --params folder.toml": "is not a regular file",
    "reach --params loop.toml": "cannot be read (Too many levels of symbolic links)",
    "hardstop --params sparse.toml": "has 1073741824 bytes",
    "place --params foreign.toml": "no built arm is so far from its drawing",
    "arm '' --build": "arm '' is not known",
    "log info run.mcap --from 100 --to 200": "has nothing in the time from 100.0 s to 200.0 s",
    "place --params fast.toml": "joints.elbow.speed_rad_s",
    "place --params through.toml": "from the stowed to the ready pose",
    "run short_run.toml --params arm7.toml": "of the arm as-built:7, not of nominal",
    # scenarios and effects
    "run": "give a name or a file; `marsarm run --list`",
    "run wrong_run.toml": "wrong_run.toml: command[1].joint: 'tower' is not known",
    "run wrong_run.toml --json": "command[1].angle: has no unit; write angle_rad or angle_deg",
    "run beyond_run.toml": "beyond_run.toml: command 1, MOVE_JOINT: joint turret: 390.0 deg",
    "run far_run.toml": "far_run.toml: command 2, PLACE_TOOL: apxs: the target: ",
    "run tilted_run.toml": "command 1, SET_TILT: the IMU reads gravity 0.1745 rad from there, at most",
    "run bad_command.toml": "'FLY' is not known",
    "place --effect boom.py:Boom --no-picture": "boom.py:13: TypeError",
    "place --effect exits.py:Boom": "exits.py:1: cannot be run: SystemExit",
    # logs
    "log info nosuch.mcap": "cannot be read (No such file or directory)",
    "log info empty.mcap": "an empty file",
    "view few.csv": "for diagnose, export or Python, not for view or replay",
    "log info text.mcap": "not an MCAP file",
    "log info pipe.mcap": "is not a regular file",
    "log info cut.mcap": "cut short before its header",
    "log info flipped.mcap": "a chunk does not match its CRC",
    "log info later.mcap --json": "log format 9",
    "log info run.mcap /joint.motor_rad[5]": "has no channel /joint.motor_rad[5]; did you mean",
    "replay run.mcap": "its header has no params",
    "replay run.mcap --params half.toml": "log run.mcap",
    "log export header.mcap tables": "holds no message; there is nothing to export",
    "log recover header.mcap good.mcap": "nothing can be saved",
    "log recover run.mcap run.mcap": "this is the file of BAD too",
    "log info run.mcap /nosuch": "has no channel /nosuch",
    "diagnose nosuch": "no such log or folder",
    "diagnose full": "holds no .mcap file",
    "diagnose run.mcap --patch one.toml --new-params one.toml": "this is the file of patch too",
    "diagnose run.mcap": "log run.mcap",
    "diagnose run.mcap --arm as-built:5": "logs are compared with a drawing, not with one arm",
    "diagnose run.mcap --catalogue nosuch": "is no effect that a diagnosis can identify",
    # tables
    "calibrate --data nosuch.csv": "there is no such log",
    "calibrate --data bytes.csv": "line 2 is not text in UTF-8",
    "calibrate --data ragged.csv": "columns missing",
    "calibrate --data cut.parquet": "cannot be read: Parquet file size",
    "log import few.csv empty.toml out.mcap": "channels: is missing",
    # outputs
    "view none.mcap": "none.mcap",
    f"place --picture {300 * 'p'}.png": "too long",
    "monte-carlo --results results.csv": "its name must end in .jsonl",
    "place --log nosuch/run.mcap": "there is no folder nosuch",
    "place --log folder.mcap": "this is a folder",
    "place --picture dangling.png": "this is a link to nowhere/there.png",
    "run contact-science --log loop.mcap": "loop.mcap",
    "gap record --out full": "name a new or empty one",
    "gap record --out nosuch/logs": "there is no folder nosuch",
    "log export run.mcap run.mcap": "is a file; give a folder",
    "log export run.mcap tables --topic /jiont": "has no topic /jiont; it has /command, /drive",
    f"log export run.mcap {300 * 'a'}": "cannot be written (File name too long)",
    "log export run.mcap /proc/tables": "this folder cannot be made",
    "log recover run.mcap good.txt": "must end in .mcap",
}
"""Part of the sentence, by command."""


@pytest.mark.parametrize("command", CASES)
def test_wrong_input_gets_one_sentence_and_leaves_nothing(folder, command):
    before = snapshot(folder)
    done = marsarm(folder, *shlex.split(command))
    assert CASES[command] in done.stderr
    assert done.returncode == 2
    assert not done.stdout if "--json" not in command else json.loads(done.stdout)["error"]
    first, *more = done.stderr.splitlines()
    assert not more or SEVERAL.fullmatch(first) or first.endswith(":"), done.stderr
    assert not LIBRARY_WORDS.search(done.stderr)
    assert snapshot(folder) == before


@pytest.mark.parametrize("command", ["log recover run.mcap good.mcap", "log export run.mcap tables"])
def test_a_full_disk_gets_one_sentence_and_leaves_nothing(folder, command):
    before = snapshot(folder)
    with largest_file(100):
        done = marsarm(folder, *shlex.split(command))
    assert done.returncode == 2
    assert re.fullmatch(r"(GOOD|out) [^\n]*: cannot be written \(File too large\)\n", done.stderr)
    assert snapshot(folder) == before
