"""Python files of users, which are run as modules."""

import hashlib
import os
import sys
import traceback
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Final

from simgap.common.errors import RobotError

MODULE_PREFIX: Final = "outside_"
"""Start of the names of modules that are made of the files of users."""


def load_module(path: Path) -> ModuleType:
    """Run a file of the user as a module, once for each of its contents; RobotError if it fails."""
    if not os.path.isfile(path):  # unlike Path.is_file, False for any bad name; reading a pipe blocks
        raise RobotError(f"{path}: no such file; give the path of a Python file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror})") from error
    name = f"{MODULE_PREFIX}{hashlib.sha256(bytes(path.resolve()) + content).hexdigest()}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    if spec is None:
        raise RobotError(f"{path}: is no Python file; its name ends in .py")
    module = module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look up the module of their class
    try:
        # Not by its loader, which takes compiled code for up to a second after a change of the file.
        exec(compile(content, str(module.__file__), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        what = " ".join(f"{type(error).__name__}: {error}".split())
        raise RobotError(f"{path}{_line_of(error, path)}: cannot be run: {what}") from error
    return module


def user_files() -> set[str]:
    """Return the files of users that were run as modules, by the names that a traceback gives them."""
    return {str(module.__file__) for name, module in [*sys.modules.items()] if name.startswith(MODULE_PREFIX)}


def _line_of(error: BaseException, path: Path) -> str:
    """Return the last line of a file that an exception passed through, as `:12`; empty if it has none."""
    if isinstance(error, SyntaxError):
        return f":{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    passed = [frame.lineno for frame in frames if Path(frame.filename) == path.absolute()]
    return f":{passed[-1]}" if passed else ""
