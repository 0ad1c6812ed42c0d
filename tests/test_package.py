"""Wheels and source distributions of both products hold all files, and work installed, from anywhere."""

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
from importlib.metadata import version
from pathlib import Path
from shutil import copyfile, copytree
from zipfile import ZipFile

import numpy as np
import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("fsw", "sim", "simgap", "marsarm")
FILES = ", ".join(f"{name}.__file__" for name in PACKAGES)


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """Build the source distributions, and the wheels from them."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, ".ci/package.py", folder], cwd=ROOT, check=True, capture_output=True)
    return folder


def files_below(folder: Path, place: str) -> set[str]:
    """List the files of a folder that belong to the project, below another name."""
    return {
        f"{place}/{path.relative_to(folder).as_posix()}"
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def wheel_of(built: Path, product: str) -> Path:
    """Return the wheel of a product."""
    (wheel,) = built.glob(f"{product}-*.whl")
    return wheel


def test_the_wheel_holds_every_file_of_the_packages_and_all_models(built):
    models = files_below(ROOT / "models", "sim/models")
    assert len(models) >= 11
    expected = {
        "marsarm": models.union(*(files_below(ROOT / name, name) for name in ("fsw", "sim", "marsarm"))),
        "simgap": files_below(ROOT / "simgap/src/simgap", "simgap"),
    }
    for product, files in expected.items():
        names = ZipFile(wheel_of(built, product)).namelist()
        assert {name for name in names if ".dist-info/" not in name} == files


def test_the_source_distributions_hold_what_belongs_to_each_product(built):
    packed = {}
    for product in ("marsarm", "simgap"):
        (archive,) = built.glob(f"{product}-*.tar.gz")
        with tarfile.open(archive) as opened:
            packed[product] = {name.partition("/")[2] for name in opened.getnames()}
    ours = packed["marsarm"]
    assert {"CITATION.cff", "CHANGELOG.md", "LICENSE", "requirements.lock", "docs/python.md"} <= ours
    assert {f"examples/{path.name}" for path in (ROOT / "examples").glob("*.py")} <= ours
    assert not any(name.startswith(("tests/", "simgap/")) for name in ours)
    tests = {path for path in files_below(ROOT / "simgap/tests", "tests") if path.endswith(".py")}
    assert {"LICENSE", "README.md", *tests} <= packed["simgap"]


class Installed:
    """Environment outside of the repository, at first with nothing installed."""

    def __init__(self, folder: Path, installer: str) -> None:
        self.home = folder / "home"
        self.work = folder / "elsewhere"
        for path in (self.home, self.work):
            path.mkdir(parents=True)
        venv.create(folder / "venv", symlinks=True)
        self.bin = folder / "venv" / "bin"
        pip = [installer, "-m", "pip", "--python", str(self.bin / "python"), "--disable-pip-version-check"]
        self._pip = pip
        # Python compiles what is imported; to compile all that is installed takes longer than to install it.
        self._install = [*pip, "install", "--no-compile"]

    def install_locked(self, *wheels: Path) -> None:
        """Install without an index: the packages of the lock file are those of this interpreter."""
        install = [*self._install, "--isolated", "--no-index", "--no-deps", *map(str, wheels)]
        subprocess.run(install, cwd=self.work, check=True, capture_output=True)
        (packages,) = self.bin.parent.glob("lib/*/site-packages")
        # The path of a .pth file: .pth files there, such as that of the repository itself, are not read.
        (packages / "lock.pth").write_text(str(Path(np.__file__).parents[1]) + "\n")

    def add(self, *what: str) -> str:
        """Install from wheels and a package index; return the reason if that fails."""
        install = [*self._install, "--retries", "0", "--timeout", "15", "--only-binary", ":all:", *what]
        done = subprocess.run(install, cwd=self.work, capture_output=True, text=True, check=False)
        return "" if done.returncode == 0 else done.stderr.strip().rpartition("\n")[2]

    def find_conflict(self) -> str:
        """Return what pip says of requirements that are not met."""
        done = subprocess.run([*self._pip, "check"], capture_output=True, text=True, check=False)
        return "" if done.returncode == 0 else done.stdout

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a program of the environment in a folder outside of the repository."""
        outside = {name: os.environ[name] for name in ("PATH", "OPENBLAS_NUM_THREADS") if name in os.environ}
        return subprocess.run(
            [str(self.bin / words[0]), *words[1:]], cwd=self.work, env=outside | {"HOME": str(self.home)},
            capture_output=True, text=True, timeout=3000, check=False,
        )  # fmt: skip

    def run_json(self, *words: str) -> dict:
        """Run `marsarm` with these words, and return its document."""
        done = self.run("marsarm", *words, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)


def environment(folder: Path) -> Installed:
    """Make an environment; one may be without pip, as in the Makefile."""
    for python in (sys.executable, "python3"):
        asked = subprocess.run([python, "-m", "pip", "--version"], capture_output=True, check=False)
        if asked.returncode == 0:
            return Installed(folder, python)
    pytest.skip("there is no pip, which installs the wheel")


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory) -> Installed:
    """Install both wheels."""
    made = environment(tmp_path_factory.mktemp("installed"))
    made.install_locked(wheel_of(built, "simgap"), wheel_of(built, "marsarm"))
    return made


def test_an_environment_with_mujoco_takes_simgap_alone_which_passes_its_tests_and_then_both_wheels(
    built, tmp_path
):
    made = environment(tmp_path)
    simgap, marsarm = (wheel_of(built, name).as_uri() for name in ("simgap", "marsarm"))
    ask = "import mujoco; print(mujoco.__version__)"
    problem = made.add("mujoco>=4.0,<4.1")
    before = made.run("python", "-c", ask).stdout
    problem = problem or made.add(f"simgap[test] @ {simgap}")
    if problem:
        pytest.skip(f"mujoco or what simgap needs cannot be installed here: {problem}")
    copytree(ROOT / "simgap" / "tests", made.work / "tests")
    copyfile(ROOT / "simgap" / "pyproject.toml", made.work / "pyproject.toml")
    short = ("tests/test_names.py", "tests/test_sentences.py", "tests/command/test_check.py")
    done = made.run("python", "-m", "pytest", "-q", "-m", "not slow", *short)
    assert done.returncode == 0, done.stdout
    others = "import sys, simgap.command.check; print({'marsarm', 'matplotlib'} & set(sys.modules))"
    assert made.run("python", "-c", others).stdout == "set()\n"
    assert made.run("python", "-c", "import marsarm").returncode == 1
    problem = made.add(f"marsarm @ {marsarm}")
    if problem:
        pytest.skip(f"what marsarm needs cannot be installed here: {problem}")
    assert made.find_conflict() == ""
    assert made.run("python", "-c", ask).stdout == before
    for program in ("simgap", "marsarm"):
        assert made.run(program, "--version").stdout == f"{program} {version(program)}\n"


def test_the_installed_packages_are_those_of_the_wheel_and_of_the_lock_file(installed):
    homes = installed.run("python", "-c", f"import {', '.join(PACKAGES)}; print({FILES})").stdout.split()
    assert all(Path(home).is_relative_to(installed.bin.parent) for home in homes)
    locked = dict(re.findall(r"^([\w-]+)==(\S+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE))
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    names = [re.match(r"[\w-]+", one)[0] for one in needed if not one.startswith("simgap")]
    ask = f"from importlib.metadata import version; print(*[version(name) for name in {names}])"
    assert installed.run("python", "-c", ask).stdout.split() == [locked[name] for name in names]


def test_the_command_and_the_module_print_the_version(installed):
    for program in ("marsarm", "simgap"):
        for words in ((program,), ("python", "-m", program)):
            assert installed.run(*words, "--version").stdout == f"{program} {version(program)}\n"


RUN = """
from marsarm import Joint, MoveJoint, nominal_params, record_commands, start_loop
ready_rad = nominal_params().poses.ready_rad
move = MoveJoint(Joint.ELBOW, ready_rad[Joint.ELBOW] + 0.1)
print(record_commands("run.mcap", start_loop("as-built:7", start_rad=ready_rad), move).outcome)
"""


def test_the_installed_names_record_a_run_and_the_commands_play_and_replay_it(installed):
    done = installed.run("python", "-c", RUN)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr
    installed.run_json("view", "run.mcap", "--html", "run.html")
    assert 100_000 < (installed.work / "run.html").stat().st_size < 5_000_000
    assert installed.run_json("replay", "run.mcap")["identical"] is True
    installed.run_json("arm", "m2020", "--picture", "layout.png")
    assert (installed.work / "layout.png").read_bytes().startswith(b"\x89PNG")
