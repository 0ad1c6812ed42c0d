"""Effects from files that are not of the house."""

import hashlib
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from sim.effects.catalogue import effects_in
from sim.effects.effect import Effect
from sim.scenario.names import did_you_mean, one_of


class NotAnEffect(ValueError):
    """A file or a class in it that is no effect; the message says what would be right."""


def effects_in_file(path: str) -> tuple[type[Effect], ...]:
    """All effects of a Python file, which is run; NotAnEffect if it cannot be."""
    return tuple(effects_in(_module(Path(path))))


def effect_class(path: str, name: str) -> type[Effect]:
    """The class of this name in a Python file, which is run.

    Raises:
        NotAnEffect: there is no such file or class, the file cannot be run, or the class is no effect.
    """
    module = _module(Path(path))
    known = [kind.__name__ for kind in effects_in(module)]
    kind = vars(module).get(name)
    if not name:
        raise NotAnEffect(
            f"effect {path}: names no class; write {path}:CLASS:PLACE:PARAMETER=VALUE,...; {one_of(known)}"
        )
    if kind is None:
        raise NotAnEffect(f"effect {path}:{name}: there is no such class; {did_you_mean(name, known)}")
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise NotAnEffect(
            f"effect {path}:{name}: is no effect; derive it from Effect, EachCycle, EachMove or Timed of "
            f"sim.effects.effect; {one_of(known)}"
        )
    if "__dataclass_fields__" not in vars(kind):
        raise NotAnEffect(
            f"effect {path}:{name}: is no dataclass; write @dataclass(frozen=True, slots=True) above it"
        )
    return kind


def _module(path: Path) -> ModuleType:
    """The file as a module of its own, run once for each content that it has."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise NotAnEffect(
            f"effect {path}: cannot be read ({error.strerror}); give the path of a Python file"
        ) from error
    name = f"outside_{hashlib.sha256(bytes(path.resolve()) + content).hexdigest()}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise NotAnEffect(f"effect {path}: is no Python file; its name ends in .py")
    module = module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look for the module of their class
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise NotAnEffect(f"effect {path}: cannot be run: {type(error).__name__}: {error}") from error
    return module
