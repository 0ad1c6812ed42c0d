"""Flight parameters of the drawing of an arm, and of TOML files over them."""

from pathlib import Path

from fsw.dictionary.params import Params
from sim.arm_model.load import default_arm
from sim.params_table import merge_tables, params_from_table, params_table, read_params_toml


def nominal_params() -> Params:
    """Return the parameters of the drawing of the default arm."""
    return default_arm().params


def params_over_nominal(path: Path) -> Params:
    """Read a TOML file with any part of the parameters; the others are those of the default arm.

    Raises:
        BadParams: the file cannot be read, or names or values in it are wrong.
    """
    return params_over(nominal_params(), path)


def params_over(params: Params, path: Path) -> Params:
    """Read a TOML file with any part of the parameters; the others come from `params`.

    Raises:
        BadParams: the file cannot be read, or names or values in it are wrong.
    """
    return params_from_table(merge_tables(params_table(params), read_params_toml(path)), str(path))
