"""Steps of an unfinished diagnosis or comparison in a folder, from which the same one goes on, bit for bit.

Both are deterministic, so the k-th step of a run is the k-th step of another run with the same inputs.
A step is a file. The name of the folder is the digest of all inputs and of the code, so that steps of other
logs, options or versions are not found. Residuals are kept as they are: to simulate them anew in another
batch could change their last bit.
"""

import hashlib
import inspect
import json
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, TypeVar, cast
from zipfile import BadZipFile

import mujoco
import numpy as np
import scipy

from simgap.arrays import Array
from simgap.effects.effect import Effect
from simgap.logs import Motion, Usable
from simgap.robot import Robot

Progress = Callable[[float, str], None]

OVERRUN: Final = 0.1
"""Share of its candidates that a round has left once it has more than were expected."""


class Meter:
    """Counts candidates. The share never falls."""

    def __init__(self, progress: Progress = lambda share, text: None) -> None:
        """Start at 0."""
        self._progress = progress
        self._share, self._is_silent = 0.0, False
        self._done, self._begin = 0, 0
        self._expected, self._after = 0, 0.0
        self._ended_done, self._ended_expected = 0, 0

    @property
    def counts(self) -> list[float]:
        """Return all counts, with which `restore` goes on."""
        rounds = (self._begin, self._expected, self._after, self._ended_done, self._ended_expected)
        return [self._share, self._done, *rounds]

    def restore(self, counts: Sequence[float]) -> None:
        """Take the counts of an earlier run, and report nothing before `go_on`."""
        self._is_silent = True
        self._share, done, begin, expected, self._after, ended_done, ended_expected = counts
        self._done, self._begin, self._expected = int(done), int(begin), int(expected)
        self._ended_done, self._ended_expected = int(ended_done), int(ended_expected)

    def go_on(self) -> None:
        """Report again: what an earlier run has done took no time, and ends here."""
        if self._is_silent:
            self._is_silent = False
            self.advance("going on", 0)

    def begin_base(self, expected: int, after: float) -> None:
        """Begin with the base parameters: expected candidates, and rounds as large expected after them."""
        self._expected, self._after = expected, after

    def begin_round(self, expected: int, after: float) -> None:
        """Begin a round of screening and refits: expected candidates, and rounds expected after it.

        Later rounds are scaled by what earlier ones took.
        """
        if self._begin:
            self._ended_done += self._done - self._begin
            self._ended_expected += self._expected
        self._begin, self._expected, self._after = self._done, expected, after

    def end_rounds(self) -> None:
        """Begin what follows the last round; it takes the rounds that were expected after it."""
        self.begin_round(round(self._after * self._expected), 0.0)

    def advance(self, text: str, count: int) -> None:
        """Count candidates."""
        self._done += count
        if self._expected:
            ratio = self._ended_done / self._ended_expected if self._ended_expected else 1.0
            usual, spent = ratio * self._expected, self._done - self._begin
            left = max(usual - spent, OVERRUN * spent) + self._after * usual
            self._share = max(self._share, self._done / (self._done + left))
        if not self._is_silent:
            self._progress(self._share, text)


T = TypeVar("T")
STEPS: Final = "diagnosis-steps-"
"""Begin of the name of the folder of a diagnosis or comparison."""
PACKAGE: Final = Path(__file__).parents[1]
GOES_ON: Final = "the same command goes on after its last complete step"
"""Note of an interruption."""
EXPIRED_s: Final = 7 * 86400.0
"""Time after which steps are deleted: a user who still wants the result has repeated the command."""


class Checkpoint:
    """Steps that are kept while a block runs; a context manager.

    They are deleted at the end of the block, also by an error, which would come again. An interruption leaves
    them. Where they cannot be written, as on a full disk, the diagnosis goes on without.
    """

    def __init__(self, folder: Path | None = None, effects: Sequence[Effect] = ()) -> None:
        """Name the folder, and delete steps of others beside it that nobody wants any more.

        The folder is STEPS with the digest of the inputs; None: nothing is kept. All effects that compete are
        given, because a step names them by their keys.
        """
        self._folder, self._number, self._is_full = folder, 0, False
        self._effects = {effect.key: effect for effect in effects}
        if folder is None:
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for other in folder.parent.glob(f"{STEPS}*"):  # beside them may be files of the user
                if other != folder and time.time() - other.stat().st_mtime > EXPIRED_s:
                    shutil.rmtree(other, ignore_errors=True)
        except OSError:
            self._folder = None

    def __enter__(self) -> "Checkpoint":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._folder is not None and (kind is None or issubclass(kind, Exception)):
            shutil.rmtree(self._folder, ignore_errors=True)
        elif self._folder is not None and error is not None:
            error.add_note(GOES_ON)

    def step(self, meter: Meter, name: str, work: Callable[[], T]) -> T:
        """Return the result of the next step, as it was kept or by carrying it out.

        It consists of effects, arrays and records of them. The meter goes on from where it was after the
        step.
        """
        number, self._number = self._number, self._number + 1
        if self._folder is None:
            return work()
        path = self._folder / f"{number:04d}-{name}.npz"
        try:
            result, self._number, counts = self._read(path)
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):  # absent, or torn by a loss of power
            meter.go_on()
            made = work()
            if not self._is_full:
                self._write(path, made, meter)
            return made
        meter.restore(counts)
        return cast("T", result)

    def _read(self, path: Path) -> tuple[Any, int, list[float]]:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            document = json.loads(str(file["document"]))
            arrays = [file[f"arr_{k}"] for k in range(len(file.files) - 1)]
        return unpack(document["result"], arrays, self._effects), document["next"], document["meter"]

    def _write(self, path: Path, result: object, meter: Meter) -> None:
        arrays: list[Array] = []
        document = {"result": pack(result, arrays), "next": self._number, "meter": meter.counts}
        part = path.with_suffix(f".{os.getpid()}.part")  # an equal run at the same time writes the same steps
        try:
            with part.open("wb") as file:
                np.savez(file, *arrays, document=np.array(json.dumps(document)))
            part.replace(path)
        except OSError:
            self._is_full = True
            with suppress(OSError):
                part.unlink()


def pack(value: object, arrays: list[Array]) -> Any:
    """Make a JSON document of numbers, texts, arrays, effects, and records, lists and tuples of them.

    Args:
        arrays: Gets the arrays of the result, (...) of any units; the document has their places.
    """
    if isinstance(value, Effect):
        return {"effect": value.key}
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple):
        return {"tuple": [pack(one, arrays) for one in value]}
    if isinstance(value, list):
        return [pack(one, arrays) for one in value]
    if is_dataclass(value):
        parts = [pack(getattr(value, one.name), arrays) for one in fields(value)]
        return {"record": [type(value).__module__, type(value).__name__], "fields": parts}
    return value


def unpack(document: Any, arrays: Sequence[Array], effects: Mapping[str, Effect]) -> Any:
    """Make the result of a document, the inverse of `pack`; KeyError if an effect or a record is not there.

    Args:
        arrays: Arrays of the result, (...) of any units.
    """
    if isinstance(document, list):
        return [unpack(one, arrays, effects) for one in document]
    if not isinstance(document, dict):
        return document
    if "effect" in document:
        return effects[document["effect"]]
    if "array" in document:
        return arrays[document["array"]]
    if "tuple" in document:
        return tuple(unpack(document["tuple"], arrays, effects))
    module, name = document["record"]
    record = vars(sys.modules[module])[name] if module.startswith("simgap.") else None
    if not (isinstance(record, type) and is_dataclass(record)):
        raise KeyError(name)
    return record(*unpack(document["fields"], arrays, effects))


def digest_code() -> str:
    """Return the digest of the diagnosis and of the libraries that it computes with, as hexadecimal text."""
    versions = (np.__version__, scipy.__version__, mujoco.__version__, sys.version, platform.machine())
    digest = hashlib.sha256(repr(versions).encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def find_steps(
    cache: str | Path,
    robot: Robot,
    motions: Sequence[Motion],
    held_out: Sequence[Motion],
    usable: Usable | None,
    effects: Sequence[Effect],
    seed: int,
) -> Path | None:
    """Return the folder of the steps of these inputs in a cache; None if the code of an effect is unknown."""
    try:
        digest = hashlib.sha256()
        digest.update(f"{len(motions)}".encode())
        for part in _inputs(robot, (*motions, *held_out), usable, effects, seed):
            digest.update(hashlib.sha256(part).digest())
    except (OSError, TypeError):
        return None
    return Path(cache) / f"{STEPS}{digest.hexdigest()}"


def _inputs(
    robot: Robot, motions: Sequence[Motion], usable: Usable | None, effects: Sequence[Effect], seed: int
) -> Iterator[bytes]:
    yield digest_code().encode()
    compiled = np.empty(mujoco.mj_sizeModel(robot.model), np.uint8)
    mujoco.mj_saveModel(robot.model, None, compiled)
    yield compiled.tobytes()
    yield repr((robot.model_xml, robot.joints, robot.control_period_s, robot.tool_site, seed)).encode()
    yield repr(robot.file and robot.file.conditions).encode()
    for motion in motions:
        settings = sorted(motion.gain.items()), sorted(motion.conditions.items())
        yield repr((motion.name, *settings, motion.repeat_of)).encode()
        for name, log in motion.joints.items():
            for one in fields(log):
                signal = getattr(log, one.name)
                yield f"{name} {one.name} {signal is not None}".encode()
                if signal is not None:
                    yield signal.time_s.tobytes()
                    yield signal.value.tobytes()
    for where, flags in (usable or {}).items():
        yield repr(where).encode()
        yield flags.tobytes()
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        for effect in effects:
            yield repr(effect).encode()
            for kind in type(effect).__mro__:
                if kind.__module__ not in ("abc", "builtins"):
                    yield Path(inspect.getfile(kind)).read_bytes()
