"""Checks of .ci/style.py: each kind of problem is refused in its line, and what is in order passes."""

import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

CI = Path(__file__).resolve().parents[1] / ".ci"
RETIRED = tomllib.loads((CI / "retired.toml").read_text())
MODULE = '"""Return nothing."""\n'
PHRASE = " ".join(("hangs", "on"))
"""Retired phrase; this file is checked too."""
FUNCTION = "def turn(angle: Array) -> Array:\n"


def load_style():
    """Load the script as a module."""
    spec = spec_from_file_location("style", CI / "style.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


STYLE = load_style()


def problems(folder: Path, place: str, text: str) -> list[tuple[int, str]]:
    """Check a text as the file of this place."""
    path = folder / Path(place).name
    path.write_text(text)
    check = {".py": STYLE.check_module, ".toml": STYLE.check_toml, ".md": STYLE.check_page}[path.suffix]
    return list(check(place, path, RETIRED))


@pytest.mark.parametrize(
    ("place", "text", "line", "expected"),
    [
        ("sim/a.py", MODULE + "rival = 1\n", 2, "rival is a retired name"),
        ("sim/a.py", MODULE + "def seek(): ...\n", 2, "seek is a retired name"),
        ("sim/a.py", MODULE + "def find(*, ladder): ...\n", 2, "ladder is a retired name"),
        ("sim/duel.py", MODULE, 1, "module:duel is a retired name"),
        ("sim/a.py", MODULE + 'found = {"log": 1,\n    "odds": 2}\n', 3, "odds is a retired name"),
        ("tests/a.py", MODULE + 'found = document["worth_it"]\n', 2, "worth_it is a retired name"),
        ("sim/a.py", MODULE + "class Case:\n    floor: float\n", 3, "floor is a retired name"),
        ("models/a.toml", "[arm]\nwave_rad = 1.0\n", 2, "wave_rad is a retired name"),
        ("models/a.toml", "[[arm.uncertain]]\n", 1, "uncertain is a retired name"),
        ("docs/a.md", "# Keys\nThe key `effects.odds` is a number.\n", 2, "odds is a retired name"),
        ("docs/a.md", f"It {PHRASE} friction.\n", 1, "is a retired phrase"),
        ("sim/a.py", MODULE + f'raise ValueError("it {PHRASE} friction")\n', 2, "is a retired phrase"),
        ("sim/a.py", '"""What nothing is."""\n', 1, "opens with 'What'"),
        ("sim/a.py", '"""`how` it is."""\n', 1, "opens with 'how'"),
        ("sim/a.py", MODULE + "loop.rival = 1\n", 2, "rival is a retired name"),
        (
            "fsw/kinematics/a.py",
            MODULE + 'class Arm:\n    def turn(self, angle: Array) -> None:\n        """Turn it."""\n',
            3,
            "Args does not name angle",
        ),
        ("sim/a.py", MODULE + "\n" * 401, 1, "402 lines, 400 at most"),
        ("sim/a.py", MODULE + "def long():\n" + "    pass\n" * 60, 2, "long has 61 lines, 60 at most"),
        ("fsw/kinematics/a.py", MODULE + FUNCTION + '    """Turn it."""\n', 2, "Args does not name angle"),
        (
            "fsw/kinematics/a.py",
            MODULE + FUNCTION + '    """Turn it.\n\n    Args:\n        angle: Angle [rad].\n    """\n',
            2,
            "Args gives no shape of angle",
        ),
        (
            "fsw/kinematics/a.py",
            MODULE + FUNCTION + '    """Turn it.\n\n    Args:\n        angle: Angle, shape (5,).\n    """\n',
            2,
            "Args gives no unit of angle",
        ),
        ("fsw/kinematics/a.py", MODULE + FUNCTION + '    """Turn it."""\n', 2, "has no Returns"),
    ],
)
def test_a_problem_is_told_with_its_line(tmp_path, place, text, line, expected):
    assert any(at == line and expected in problem for at, problem in problems(tmp_path, place, text))


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ("sim/a.py", MODULE + 'where = {"log_odds": 1}\n'),
        ("sim/old_names.py", MODULE + 'OLD = {"half_gap_rad": "half_backlash_rad"}\n'),
        ("models/a.toml", "[uncertainty]\nperiodic_rad = 1.0  # wave_rad was the name\n"),
        ("docs/a.md", "The verb `gap` records; the key is `log_odds`.\n"),
        (
            "fsw/kinematics/a.py",
            MODULE + FUNCTION + '    """Turn it.\n\n    Args:\n        angle: Angle [rad], shape (5,).\n\n'
            '    Returns:\n        Turned angle [rad], shape (5,).\n    """\n',
        ),
    ],
)
def test_what_is_in_order_passes(tmp_path, place, text):
    assert problems(tmp_path, place, text) == []
