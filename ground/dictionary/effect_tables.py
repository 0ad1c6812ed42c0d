"""The catalogue of effects as tables for people and as a document for programs."""

from typing import Any

from rich.table import Table

from ground.render.console import plain_console
from sim.effects.catalogue import (
    ParameterField,
    all_places,
    catalogue,
    effect_place_text,
    effect_summary,
    effect_timing,
    has_flight_parameter,
    hypotheses,
    parameters_of,
    place_fields_of,
)
from sim.effects.effect import Effect
from sim.scenario.effects import parameter_key


def effects_json() -> list[dict[str, Any]]:
    """The catalogue as a JSON document."""
    raced = {hypothesis.kind for hypothesis in hypotheses()}
    return [
        {
            "name": name,
            "text": effect_summary(kind),
            "when": effect_timing(kind),
            "place": [where.field for where in place_fields_of(kind)],
            "places": [said for place in all_places(kind) if (said := effect_place_text(kind, place))],
            "parameters": [_parameter_json(kind, parameter) for parameter in parameters_of(kind)],
            "in_flight_parameters": has_flight_parameter(kind),
            "is_hypothesis": kind in raced,
        }
        for name, kind in catalogue().items()
    ]


def _parameter_json(kind: type[Effect], parameter: ParameterField) -> dict[str, Any]:
    size = parameter.spec
    about = (
        {}
        if size is None
        else {key: getattr(size, key) for key in ("unit", "low", "high", "typical", "neutral")}
    )
    return {
        "name": parameter_key(kind, parameter.field),
        "numbers": parameter.count,
        "default": parameter.default,
        **about,
    }


def effects_table() -> None:
    """Print the catalogue: a heading, its places and a sentence for each effect, then its parameters."""
    console = plain_console()
    for name, kind in catalogue().items():
        console.print(f"\n{name}  {effect_summary(kind)}", style="bold")
        places = place_fields_of(kind)
        if places:
            sits = [f"{where.field} ({', '.join(where.members)})" for where in places]
            console.print(f"  at {', '.join(sits)}; {effect_timing(kind)}")
        parameters = parameters_of(kind)
        if parameters:
            console.print(_table(kind, parameters))


def _table(kind: type[Effect], parameters: tuple[ParameterField, ...]) -> Table:
    table = Table(show_edge=False, pad_edge=False, box=None)
    for column in ("  parameter", "unit", "limits", "neutral", "typically off by", "default"):
        table.add_column(column)
    for parameter in parameters:
        size = parameter.spec
        cells = ["", "", "", ""]
        if size is not None:
            neutral = "" if size.neutral is None else f"{size.neutral:g}"
            off_by = "" if size.neutral is None else f"{size.typical:g}"
            cells = [size.unit, f"{size.low:g} .. {size.high:g}", neutral, off_by]
        default = "" if parameter.default is None else str(parameter.default)
        table.add_row(f"  {parameter_key(kind, parameter.field)}", *cells, default)
    return table
