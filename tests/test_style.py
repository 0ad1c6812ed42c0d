"""Checks of .ci/style.py: each kind of problem is refused in its line, and what is in order passes."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

CI = Path(__file__).resolve().parents[1] / ".ci"
MODULE = '"""Return nothing."""\n'
FUNCTION = "def turn(angle: Array) -> Array:\n"


SPEC = spec_from_file_location("style", CI / "style.py")
STYLE = module_from_spec(SPEC)
SPEC.loader.exec_module(STYLE)


def problems(folder: Path, place: str, text: str) -> list[tuple[int, str]]:
    """Check a text as the file of this place."""
    path = folder / Path(place).name
    path.write_text(text)
    return list(STYLE.check_module(place, path))


KINEMATICS = "fsw/kinematics/a.py"
OF_ANGLE = FUNCTION + '    """Turn it.\n\n    Args:\n        angle: Angle{}.\n    """\n'


@pytest.mark.parametrize(
    ("place", "text", "line", "expected"),
    [
        ("sim/a.py", '"""What nothing is."""\n', 1, "opens with 'What'"),
        ("sim/a.py", '"""`how` it is."""\n', 1, "opens with 'how'"),
        ("sim/a.py", MODULE + "def long():\n" + "    pass\n" * 60, 2, "long has 61 lines, 60 at most"),
        (KINEMATICS, MODULE + FUNCTION + '    """Turn it."""\n', 2, "Args does not name angle"),
        (KINEMATICS, MODULE + OF_ANGLE.format(" [rad]"), 2, "Args gives no shape of angle"),
        (KINEMATICS, MODULE + OF_ANGLE.format(", shape (5,)"), 2, "Args gives no unit of angle"),
        (KINEMATICS, MODULE + FUNCTION + '    """Turn it."""\n', 2, "shape that is returned"),
        (
            "sim/a.py",
            MODULE + "def show(j: JointEstimate) -> None:\n"
            '    """Show it.\n\n    Args:\n        j: Estimate of the joints.\n    """\n',
            2,
            "Args only restates j; leave it out",
        ),
    ],
)
def test_a_problem_is_told_with_its_line(tmp_path, place, text, line, expected):
    assert any(at == line and expected in problem for at, problem in problems(tmp_path, place, text))


def test_what_is_in_order_passes(tmp_path):
    text = (
        '    """Turn it.\n\n    Args:\n        angle: Angle [rad], shape (5,).\n\n'
        '    Returns:\n        Turned angle [rad], shape (5,).\n    """\n'
    )
    assert problems(tmp_path, "fsw/kinematics/a.py", MODULE + FUNCTION + text) == []
