"""The scripts of examples/ and the notebooks: each runs as a user runs it, and prints its result."""

import ast
import json
import re
import sys
from pathlib import Path

import matplotlib.image
import pytest

from helpers.command import run_python
from validation.documents import read_steps

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted({path.stem for path in (ROOT / "examples").glob("*.py")} - {"samples"})  # it draws nothing
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
PAGE = (ROOT / "docs" / "python.md").read_text()
README = (ROOT / "simgap" / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
ALLOWED = {"simgap", "marsarm", "matplotlib", "mujoco", "numpy"}


def print_of(words: list[str], folder: Path, backend: str) -> str:
    """Run Python in a folder, without a display, and return what it prints."""
    done = run_python(folder, "-W", "error", *words, PYTHONPATH=str(ROOT), MPLBACKEND=backend)
    assert done.returncode == 0, done.stderr
    return done.stdout


def run_example(name: str, folder: Path) -> str:
    """Run a script in a folder that is empty or has a shorter copy of it, and return what it prints."""
    copy = folder / f"{name}.py"
    printed = print_of([str(copy if copy.exists() else ROOT / "examples" / copy.name)], folder, "agg")
    picture = matplotlib.image.imread(folder / f"{name}.png")
    assert picture.shape[1] == 800
    assert picture[..., :3].std() > 0.01
    return printed


def cells_of(notebook: str) -> list[str]:
    """Return the code cells of a notebook."""
    cells = json.loads((ROOT / "docs" / "notebooks" / f"{notebook}.ipynb").read_text())["cells"]
    return ["".join(one["source"]) for one in cells if one["cell_type"] == "code"]


def outputs_of(notebook: str) -> list[str]:
    """Return what the cells of a notebook have printed when it was stored."""
    cells = json.loads((ROOT / "docs" / "notebooks" / f"{notebook}.ipynb").read_text())["cells"]
    return [text for one in cells for output in one.get("outputs", []) for text in output.get("text", [])]


def numbers(pattern: str, text: str) -> list[float]:
    """Return the numbers of the groups of a pattern that occurs in a text."""
    found = re.search(pattern, text)
    assert found is not None, text
    return [float(group) for group in found.groups()]


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_uses_public_names_only_and_stands_on_the_page_with_its_picture(name):
    tree = ast.parse((ROOT / "examples" / f"{name}.py").read_text())
    used = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    used |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert {module.partition(".")[0] for module in used} - set(sys.stdlib_module_names) <= ALLOWED
    assert f"](../examples/{name}.py)" in PAGE
    assert f"](examples/{name}.png)" in PAGE
    assert (ROOT / "docs" / "examples" / f"{name}.png").is_file()


@pytest.mark.slow
def test_the_closed_loop_places_an_instrument(tmp_path):
    printed = run_example("closed_loop", tmp_path)
    assert printed.endswith("outcome: done\n")
    assert "contact on apxs" in printed


@pytest.mark.slow
def test_an_effect_of_ones_own_changes_the_motor_current(tmp_path):
    (change_A,) = numbers(r"by ([\d.]+) A", run_example("own_effect", tmp_path))
    assert change_A > 0.1 / 3  # 10 N m


@pytest.mark.slow
def test_a_monitor_of_ones_own_stops_the_arm_near_its_bound(tmp_path):
    printed = run_example("own_monitor", tmp_path)
    (free_m,) = numbers(r"without the monitor: done .* lowest (\S+) m", printed)
    (stopped_m,) = numbers(r"with the monitor: stopped .* lowest (\S+) m", printed)
    assert free_m < -0.7
    assert -0.56 < stopped_m < -0.55


@pytest.mark.slow
def test_a_monte_carlo_samples_as_many_arms_as_it_says(tmp_path):
    script = (ROOT / "examples" / "monte_carlo.py").read_text()
    (tmp_path / "monte_carlo.py").write_text(script.replace("arms=100", "arms=12"))
    printed = run_example("monte_carlo", tmp_path)
    assert "12 arms, 0 failed" in printed
    median_mm, largest_mm = numbers(r"median (\S+) mm, largest (\S+) mm", printed)
    assert 0.5 < median_mm < largest_mm < 6.0


@pytest.mark.slow
def test_a_diagnosis_finds_the_link_and_its_length(tmp_path):
    printed = run_example("arm_diagnosis", tmp_path)
    assert "link-length at arm3.x" in printed
    (length_m,) = numbers(r"length_m=([\d.]+)", printed)
    assert length_m == pytest.approx(0.006, rel=0.1)


def run_notebook(name: str, folder: Path, before: str = "", *after: str) -> str:
    """Run the cells of a notebook where it would stand in a clone, and return what is printed."""
    for shared in ("models", "examples"):
        (folder / shared).symlink_to(ROOT / shared)
    place = folder / "docs" / "notebooks"
    place.mkdir(parents=True)
    program = "\n".join([before, *cells_of(name), *after])
    return print_of(["-c", program], place, "template")  # which shows no figure


@pytest.mark.slow
def test_the_notebook_of_the_arm_runs_and_prints_its_result(tmp_path):
    printed = r"identical: True\njoints\.elbow\.gear_stiffness_Nm_rad: 100000\.0 is 80000\.0 now"
    assert re.search(printed, run_notebook("arm", tmp_path))
    assert re.search(printed, "".join(outputs_of("arm")))


DIAGNOSE_ONCE = """
import pickle
import simgap
diagnose_anew, made = simgap.diagnose, {}
def diagnose_once(robot, motions, **options):
    asked = pickle.dumps((motions, options))
    if asked not in made:
        made[asked] = diagnose_anew(robot, motions, **options)
    return made[asked]
simgap.diagnose = diagnose_once
"""
"""The notebook and the page ask for the same diagnosis, which takes half a minute."""


@pytest.mark.slow
def test_the_notebook_of_a_gap_and_the_blocks_of_the_pages_run_and_print_the_result(tmp_path):
    blocks = [one.text for one in read_steps() if one.kind == "python" and "from simgap" in one.text]
    assert len(blocks) == 2
    found = run_notebook("gap", tmp_path, DIAGNOSE_ONCE, *blocks, 'print(len(made), "diagnoses")')
    (verdict,) = re.findall(r"^```\n(Where: .*?)^```", README, re.DOTALL | re.MULTILINE)
    assert verdict.startswith("Where: elbow.\nWhat: command delay at elbow (delay_s = 0.0299")
    assert " ".join(found.split()).count(" ".join(verdict.split())) == 2
    stored = "".join(outputs_of("gap"))
    assert [line for line in stored.splitlines() if line not in found] == []
    assert found.endswith("\n2 diagnoses\n")  # of base parameters alone, and of effects


def test_every_example_and_every_notebook_has_a_test():
    text = Path(__file__).read_text()
    assert all(f'run_example("{name}", tmp_path)' in text for name in SCRIPTS)
    assert all(f'run_notebook("{path.stem}", tmp_path' in text for path in NOTEBOOKS)


def test_the_names_in_the_snippets_and_tables_of_the_page_exist():
    import marsarm

    trees = [ast.parse(snippet) for snippet in SNIPPETS]
    nodes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    imported = {alias.name for node in nodes for alias in node.names}
    verbs = {
        name for row in re.findall(r"^\| (`.*)\|$", PAGE, re.MULTILINE) for name in re.findall(r"`(\w+)", row)
    }
    assert len(SNIPPETS) == 2
    assert len(verbs) == 14
    assert imported | verbs <= set(marsarm.__all__)
