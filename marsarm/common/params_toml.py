"""Flight parameters written as the TOML that --params reads."""

from collections.abc import Iterator, Sequence
from typing import Any

from fsw.dictionary.params import Params
from sim.params_table import params_table


def params_toml(base: Params, params: Params, comments: Sequence[str]) -> str:
    """Write the parameters that differ from `base` as TOML, below these comment lines, with their drawing."""
    table = params_table(params)
    changed = _changed_values(params_table(base), table) | {"model": table["model"]}
    return "\n".join([*(f"# {line}" for line in comments), "", *_lines(changed, ()), ""])


def full_params_toml(params: Params, comments: Sequence[str]) -> str:
    """Write all parameters as TOML, below these comment lines."""
    return "\n".join([*(f"# {line}" for line in comments), "", *_lines(params_table(params), ()), ""])


def _changed_values(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """Select the values that differ; a leaf table is complete or left out."""
    changed: dict[str, Any] = {}
    for key, value in new.items():
        if not isinstance(value, dict) or _is_leaf(value):
            if value != old[key]:
                changed[key] = value
        elif inner := _changed_values(old[key], value):
            changed[key] = inner
    return changed


def _is_leaf(table: dict[str, Any]) -> bool:
    """Check for a point mass or a link transform, which is written as an inline table."""
    return set(table) in ({"mass_kg", "com_m"}, {"theta_rad", "d_m", "beta_rad", "b_m", "alpha_rad", "a_m"})


def _lines(table: dict[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    tables = {key: value for key, value in table.items() if isinstance(value, dict) and not _is_leaf(value)}
    values = {key: value for key, value in table.items() if key not in tables}
    if values and path:
        yield f"[{'.'.join(path)}]"
    for key, value in values.items():
        yield f"{key} = {_toml(value)}"
    if values:
        yield ""
    for key, inner in tables.items():
        yield from _lines(inner, (*path, key))


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, tuple):
        if value and isinstance(value[0], tuple | dict):
            return "[\n" + "".join(f"    {_toml(row)},\n" for row in value) + "]"
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
