"""Define the verbs `effects` and `dictionary`."""

from typing import Annotated

import typer

from simgap.common.errors import BadRequest
from simgap.common.verb import JsonOption, VerbResult, print_result, report_user_errors, verb


@verb
def effects() -> VerbResult:
    """List the effects of the plant: meaning, possible places, and parameters.

    To use one, give --effect to run, place or hardstop, or write an `effect` table in a scenario.

    Example: marsarm run contact-science --effect coulomb-friction:elbow:torque_Nm=25
    """
    from marsarm.dictionary.effect_tables import effects_json, effects_table

    return VerbResult({"effects": effects_json()}, effects_table)


def dictionary(
    pattern: Annotated[
        str | None,
        typer.Argument(
            help="Name of a command, EVR, topic, field or parameter; * stands for any letters.",
            metavar="GLOB",
        ),
    ] = None,
    as_json: JsonOption = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print it as a Markdown page.")] = False,
) -> None:
    """List every command, event report, channel and parameter, with type, unit, limits and meaning.

    The list is made from the classes that flight software runs on. Truth channels of the plant are marked.

    Example: marsarm dictionary 'joints.elbow.*'
    """
    from marsarm.dictionary.entries import build_dictionary, filter_dictionary
    from marsarm.dictionary.tables import dictionary_json, dictionary_markdown, dictionary_tables

    with report_user_errors(as_json):
        if as_json and markdown:
            raise BadRequest("dictionary: --json and --markdown exclude each other; give one of the two")
        whole = build_dictionary()
        part = whole if pattern is None else filter_dictionary(whole, pattern)
    if markdown:
        print(dictionary_markdown(part), end="")
    else:
        print_result(dictionary_json(part), as_json, lambda: dictionary_tables(part))
