"""The names that `import marsarm` gives: each exists, none is loaded before it is used."""

from pathlib import Path

import marsarm
from helpers.command import run_python
from simgap.common.names import list_names
from tests.marsarm.command import ROOT


def test_every_name_exists_and_comes_from_the_module_that_defines_it():
    for name in marsarm.__all__:
        value = getattr(marsarm, name)
        home = list_names("marsarm")[name]
        assert getattr(value, "__module__", home) == home, name
    assert set(marsarm.__all__) <= set(dir(marsarm))


def test_no_name_is_that_of_a_module_which_would_hide_it():
    assert not {path.stem for path in Path(marsarm.__file__).parent.iterdir()} & set(marsarm.__all__)


def test_an_import_loads_nothing_before_a_name_is_used():
    ask = "import sys, marsarm; print([name for name in ('numpy', 'mujoco', 'fsw') if name in sys.modules])"
    assert run_python(ROOT, "-c", ask).stdout == "[]\n"
