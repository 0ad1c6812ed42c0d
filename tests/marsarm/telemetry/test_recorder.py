"""Paths where a log can be written, and logging of every EVR and command."""

import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import pytest

from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import Fault
from marsarm.telemetry.errors import LogNotWritable, SchemaError
from marsarm.telemetry.events import command_entry, evr_entry
from marsarm.telemetry.json_codec import record_to_json
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import Recorder

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("missing/run.mcap", "directory .*missing does not exist; make it"),
        ("", "is a directory; give the path of a file"),
        ("nul\0.mcap", "cannot be written"),
        ("x" * 300, "cannot be written"),
        ("file/run.mcap", "does not exist"),
        ("pipe", "is not a regular file"),
    ],
    ids=["no directory", "a directory", "zero byte", "too long", "below a file", "a pipe"],
)
def test_a_path_that_cannot_be_written_is_refused_and_left_as_it_was(
    tmp_path: Path, name: str, why: str
) -> None:
    (tmp_path / "file").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LogNotWritable, match=why) as caught:
        Recorder(f"{tmp_path}/{name}", {})
    assert caught.value.path == Path(f"{tmp_path}/{name}")
    assert {p.name for p in tmp_path.rglob("*")} == {"file", "pipe"}
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_directory_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(LogNotWritable, match="Permission denied"):
        Recorder(tmp_path / "run.mcap", {})


@pytest.mark.parametrize("before", [{}, {"run.mcap": b"of a good day"}], ids=["new", "over another"])
def test_a_disk_without_room_is_refused_and_leaves_what_was_there(
    tmp_path: Path, before: dict[str, bytes]
) -> None:
    for name, data in before.items():
        (tmp_path / name).write_bytes(data)
    program = (
        "import resource, sys\n"
        "from marsarm.telemetry.errors import LogNotWritable\n"
        "from marsarm.telemetry.recorder import Recorder\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"
        "try:\n    Recorder(sys.argv[1], {})\n"
        "except LogNotWritable as error:\n    print(error)\n"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    ran = subprocess.run(
        [sys.executable, "-W", "error", "-c", program, str(tmp_path / "run.mcap")],
        env=env, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "File too large" in ran.stdout
    assert ran.stderr == ""
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == before


def test_a_log_replaces_the_one_before_it(make: Any, tmp_path: Path) -> None:
    path = make.record(tmp_path / "run.mcap", map(make.cycle_at, range(50)))
    make.record(path, [make.cycle_at(0)])
    assert len(read_log(path)["/sensors"]) == 1


def test_a_log_is_written_where_a_link_points_to(make: Any, tmp_path: Path) -> None:
    (tmp_path / "last.mcap").symlink_to("run.mcap")
    make.record(tmp_path / "last.mcap", [make.cycle_at(0)])
    assert (tmp_path / "last.mcap").is_symlink()
    assert len(read_log(tmp_path / "run.mcap")["/sensors"]) == 1


def test_closing_twice_is_closing_once(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", {})
    recorder.close()
    size = (tmp_path / "run.mcap").stat().st_size
    recorder.close()
    assert (tmp_path / "run.mcap").stat().st_size == size


def some_value(hint: Any) -> Any:
    if get_origin(hint) is tuple:
        return tuple(some_value(item) for item in get_args(hint))
    if get_origin(hint) is Literal:
        return get_args(hint)[0]
    if get_origin(hint) in (Union, UnionType):
        return some_value(get_args(hint)[0])
    values = {bool: True, int: 1, float: 0.5, str: "x"}
    return values[hint] if hint in values else next(iter(hint))


def some_event(kind: Any) -> Any:
    hints = get_type_hints(kind)
    return kind(**{f.name: some_value(hints[f.name]) for f in fields(kind)})


@pytest.mark.parametrize(
    "kind",
    [kind for kind in (*Evr.__subclasses__(), *Fault.__subclasses__()) if hasattr(kind, "text")],
    ids=lambda kind: kind.__name__,
)
def test_every_evr_goes_into_a_log(kind: Any) -> None:
    evr = some_event(kind)
    entry = evr_entry(7, evr)
    assert type(entry).decode(entry.encode()) == entry
    assert (entry.name, entry.message, list(entry.fields)) == (
        kind.__name__,
        evr.message,
        [f.name for f in fields(kind)],
    )


@pytest.mark.parametrize("kind", get_args(Command), ids=lambda kind: kind.__name__)
def test_every_command_goes_into_a_log(kind: Any) -> None:
    entry = command_entry(7, some_event(kind))
    assert type(entry).decode(entry.encode()) == entry
    assert list(entry.fields) == [f.name for f in fields(kind)]


def test_a_field_without_a_json_type_is_refused() -> None:
    with pytest.raises(SchemaError, match="object in a command or EVR"):
        record_to_json(object())
