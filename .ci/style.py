"""Check what ruff does not know: docstrings and the length of functions.

`python .ci/style.py [FOLDER ..]` prints a line for each problem, and fails if there is any.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGES: Final = ("fsw", "sim", "simgap/src/simgap", "marsarm", "validation", "examples")
NUMERIC: Final = (
    *("fsw/kinematics", "fsw/estimate", "marsarm/calibration", "marsarm/diagnosis"),
    *(
        f"simgap/src/simgap/{name}"
        for name in (
            *("serial_arm", "simulation/simulation", "selection", "residuals/noise"),
            *("residuals/simulation_residuals", "assemble", "diagnosis"),
        )
    ),
)
"""Folders whose public functions say shapes and units."""
SAID_ONCE: Final = (
    *(f"fsw/kinematics/{name}.py" for name in ("transforms", "closed_form", "roots")),
    *(f"marsarm/diagnosis/{name}.py" for name in ("diagnose", "model", "problem", "selection")),
    *(
        f"marsarm/diagnosis/arm/{name}.py"
        for name in ("case", "case_simulator", "feature_set", "features", "finite_differences", "rest_poses")
    ),
    *(
        f"marsarm/calibration/{name}.py"
        for name in (
            "arm_parameters",
            "calibrate",
            "campaign",
            "campaign_data",
            "residual_model",
            "verify",
        )
    ),
    *(
        f"simgap/src/simgap/{name}.py"
        for name in (
            *("assemble", "residuals/noise", "serial_arm/calibrate", "serial_arm/chain", "serial_arm/fit"),
            *("serial_arm/model", "selection/acceptance", "selection/chance"),
            *("selection/elimination", "selection/fit", "selection/joint_fits"),
            *("selection/screening", "selection/selection", "selection/sharing"),
        )
    ),
)
"""Modules whose own docstring says the shapes and units of all their functions."""
ARRAYS: Final = re.compile(r"\b(Array|Flags|Integers|Indices|NDArray|Pose)\b")
SHAPE: Final = re.compile(r"\((?:\d+|[a-z]\w*|\.\.\.)(?:, ?(?:\d+|[a-z]\w*|\.\.\.))*,?\)")
UNITS: Final = "rad|deg|m|mm|N|Nm|kg|s|A|C|K|Hz|urad|s2|share|ratio|factor"
NAME_UNIT: Final = re.compile(rf"_(?:{UNITS})(?:_|$)")
TEXT_UNIT: Final = re.compile(
    r"\b(rad|radians?|deg|degrees|m|metres?|mm|N|newtons?|N m|kg|s|seconds|A|unitless|unit vectors?"
    r"|rotations?|units?|counts?|indices|index|flags?|whitened|true|whether|angles?)\b"
)
OPENINGS: Final = ("What", "Of", "Where", "Whether", "How", "Who")
MAX_FUNCTION: Final = 60
ARTICLES: Final = frozenset(("a", "an", "the", "of", "or", "and", "its"))
NAMES: Final = frozenset(re.findall(r"`(\w+)`", (ROOT / "fsw/__init__.py").read_text(encoding="utf-8")))
"""Names whose shapes and units `fsw/__init__.py` says once."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


def main(folders: list[str]) -> int:
    """Check the files below these folders, or the whole project."""
    chosen = tuple(folders) or ("",)
    problems: list[str] = []
    modules = sorted(path for name in PACKAGES for path in (ROOT / name).rglob("*.py"))
    for path in modules:
        place = path.relative_to(ROOT).as_posix()
        if place.startswith(chosen):
            found = dict.fromkeys(check_module(place, path))
            problems += [f"{place}:{line}: {text}" for line, text in found]
    print("\n".join(problems) or f"style: {len(modules)} modules in order")
    return 1 if problems else 0


def check_module(place: str, path: Path) -> Iterator[tuple[int, str]]:
    """Check one module.

    Yields:
        The line and the sentence of each problem.
    """
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | Function):
            yield from check_opening(node)
        if isinstance(node, Function):
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            if length - docstring_lines(node) > MAX_FUNCTION:
                yield node.lineno, f"{node.name} has {length} lines, {MAX_FUNCTION} at most"
            yield from check_restated(node)
    if place.startswith(NUMERIC) and place not in SAID_ONCE:
        classes = [one for one in tree.body if isinstance(one, ast.ClassDef) and not one.name.startswith("_")]
        for node in (*tree.body, *(one for kind in classes for one in kind.body)):
            if isinstance(node, Function) and not node.name.startswith("_"):
                yield from check_arguments(node)


def check_opening(node: ast.Module | ast.ClassDef | Function) -> Iterator[tuple[int, str]]:
    """Check that a docstring does not open with a question word.

    Yields:
        The line and the sentence of the problem.
    """
    text = ast.get_docstring(node) or ""
    first = re.split(r"[\s,;:]", text.strip("`"), maxsplit=1)[0].strip("`")
    if first.capitalize() in OPENINGS:
        yield (getattr(node, "lineno", 1), f"the docstring opens with {first!r}; begin with a verb or a noun")


def check_arguments(node: Function) -> Iterator[tuple[int, str]]:
    """Check that a function of arrays describes these, with shapes and units, and what it returns.

    Yields:
        The line and the sentence of each problem.
    """
    kinds = types_of_arguments(node)
    returned = ast.unparse(node.returns) if node.returns else "None"
    if not any(ARRAYS.search(kind) for kind in (*kinds.values(), returned)):
        return
    text = ast.get_docstring(node) or ""
    if any(isinstance(one, ast.Name) and one.id == "property" for one in node.decorator_list):
        if "Array" in returned and not SHAPE.search(text):
            yield node.lineno, f"{node.name}: the docstring gives no shape"
        return
    said = sections(text)
    for name, kind in kinds.items():
        entry = said["Args"].get(name)
        if entry is None and name in NAMES:
            continue
        if entry is None and ARRAYS.search(kind) and "Pose" not in kind:
            yield node.lineno, f"{node.name}: Args does not name {name}"
        elif entry is not None and ARRAYS.search(kind) and "Pose" not in kind:
            if not SHAPE.search(entry):
                yield node.lineno, f"{node.name}: Args gives no shape of {name}"
            if not NAME_UNIT.search(name) and not TEXT_UNIT.search(entry):
                yield node.lineno, f"{node.name}: Args gives no unit of {name}"
    in_summary = "Pose" in returned or SHAPE.search(text.partition("\n")[0])
    if ARRAYS.search(returned) and not (in_summary or said["Returns"] or said["Yields"]):
        yield node.lineno, f"{node.name}: neither summary nor Returns gives the shape that is returned"


def check_restated(node: Function) -> Iterator[tuple[int, str]]:
    """Check that no entry of Args only restates the name and the type of its argument.

    Yields:
        The line and the sentence of each problem.
    """
    kinds = types_of_arguments(node)
    for name, entry in sections(ast.get_docstring(node) or "")["Args"].items():
        if restates(name, kinds.get(name, ""), entry):
            yield node.lineno, f"{node.name}: Args only restates {name}; leave it out"


def restates(name: str, kind: str, entry: str) -> bool:
    """Return whether each word of an entry is one of the name or of the type, in singular or plural."""
    if not re.fullmatch(r"[\w\s-]*\.?", entry):  # a unit, a shape, a value or a second clause
        return False
    known = set(split_words(f"{name} {kind}"))
    return {word.removesuffix("s") for word in split_words(entry)} <= {
        word.removesuffix("s") for word in known | ARTICLES
    }


def split_words(text: str) -> list[str]:
    """Split text and identifiers into words in small letters: `JointEstimate` has two."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+|\d+", text)]


def types_of_arguments(node: Function) -> dict[str, str]:
    """Return the annotation of each argument but `self` and `cls`; empty where there is none."""
    arguments = [a for a in (*node.args.args, *node.args.kwonlyargs) if a.arg not in ("self", "cls")]
    return {a.arg: ast.unparse(a.annotation) if a.annotation else "" for a in arguments}


def sections(text: str) -> dict[str, dict[str, str]]:
    """Split a Google docstring: by section, then by the name before the colon."""
    found: dict[str, dict[str, str]] = {"Args": {}, "Returns": {}, "Yields": {}}
    section, name = "", ""
    for line in text.splitlines():
        head = re.fullmatch(r"(Args|Returns|Yields|Raises):", line.strip())
        if head and not line.startswith(" "):
            section, name = head[1], ""
        elif section in found and line.strip():
            item = re.match(r"    (\w+): ?(.*)", line)
            if item and section == "Args":
                name = item[1]
                found[section][name] = item[2]
            else:
                found[section][name] = f"{found[section].get(name, '')} {line.strip()}"
    return found


def docstring_lines(node: Function) -> int:
    """Count the lines of a docstring."""
    first = node.body[0]
    if ast.get_docstring(node) is None or not isinstance(first, ast.Expr):
        return 0
    return (first.end_lineno or first.lineno) - first.lineno + 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
