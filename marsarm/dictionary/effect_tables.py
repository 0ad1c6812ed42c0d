"""Output of the catalogue of effects: tables for people and a JSON document."""

from typing import Any

from rich.table import Table

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
from simgap.common.console import plain_console


def effects_json() -> list[dict[str, Any]]:
    """Return the catalogue as a JSON document."""
    hypothesis_kinds = {hypothesis.kind for hypothesis in hypotheses()}
    return [
        {
            "name": name,
            "text": effect_summary(kind),
            "when": effect_timing(kind),
            "place_fields": [one.field for one in place_fields_of(kind)],
            "places": [text for place in all_places(kind) if (text := effect_place_text(kind, place))],
            "parameters": [_parameter_json(kind, parameter) for parameter in parameters_of(kind)],
            "in_flight_parameters": has_flight_parameter(kind),
            "is_hypothesis": kind in hypothesis_kinds,
        }
        for name, kind in catalogue().items()
    ]


def _parameter_json(kind: type[Effect], parameter: ParameterField) -> dict[str, Any]:
    spec = parameter.spec
    about = (
        {}
        if spec is None
        else {key: getattr(spec, key) for key in ("unit", "low", "high", "typical", "neutral")}
    )
    return {
        "name": parameter_key(kind, parameter.field),
        "numbers": parameter.count,
        "default": parameter.default,
        **about,
    }


def effects_table() -> None:
    """Print the catalogue: name and summary, places and timing, and parameters of each effect."""
    console = plain_console()
    for name, kind in catalogue().items():
        console.print(f"\n{name}  {effect_summary(kind)}", style="bold")
        places = place_fields_of(kind)
        if places:
            texts = [f"{one.field} ({', '.join(one.members)})" for one in places]
            console.print(f"  at {', '.join(texts)}; {effect_timing(kind)}")
        parameters = parameters_of(kind)
        if parameters:
            console.print(_table(kind, parameters))


def _table(kind: type[Effect], parameters: tuple[ParameterField, ...]) -> Table:
    table = Table(show_edge=False, pad_edge=False, box=None)
    for column in ("  parameter", "unit", "limits", "neutral", "typically off by", "default"):
        table.add_column(column)
    for parameter in parameters:
        spec = parameter.spec
        cells = ["", "", "", ""]
        if spec is not None:
            neutral = "" if spec.neutral is None else f"{spec.neutral:g}"
            off_by = "" if spec.neutral is None else f"{spec.typical:g}"
            cells = [spec.unit, f"{spec.low:g} .. {spec.high:g}", neutral, off_by]
        default = "" if parameter.default is None else str(parameter.default)
        table.add_row(f"  {parameter_key(kind, parameter.field)}", *cells, default)
    return table
