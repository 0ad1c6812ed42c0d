"""The names that `import simgap` gives: each exists, none is loaded before it is used."""

from pathlib import Path

import pytest

import simgap
from helpers.command import run_python, run_simgap
from simgap.common.names import list_names


def test_every_name_exists_and_comes_from_the_module_that_defines_it():
    for name in simgap.__all__:
        value = getattr(simgap, name)
        home = list_names("simgap")[name]
        assert getattr(value, "__module__", home) in (home, "numpy"), name
    assert set(simgap.__all__) <= set(dir(simgap))


def test_no_name_is_that_of_a_module_which_would_hide_it():
    assert not {path.stem for path in Path(simgap.__file__).parent.iterdir()} & set(simgap.__all__)


def test_an_import_loads_nothing_before_a_name_is_used():
    ask = "import sys, simgap; print([name for name in ('numpy', 'mujoco', 'scipy') if name in sys.modules])"
    assert run_python(None, "-c", ask).stdout == "[]\n"


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'simgap' has no attribute 'Robbot'"):
        _ = simgap.Robbot


def test_the_version_is_told(tmp_path):
    assert run_simgap(tmp_path, "--version").stdout.startswith("simgap ")
