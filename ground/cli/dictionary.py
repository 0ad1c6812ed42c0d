"""The verb `dictionary`; thin."""

from typing import Annotated

import typer

from ground.cli.options import EXIT_BAD_INPUT, JsonOption, fail, print_result


def effects(as_json: JsonOption = False) -> None:
    """List the effects that the plant knows: what each is, where it can sit, and its parameters.

    Switch one on with --effect of run, place or hardstop, or with [[effect]] in a scenario.

    Example: marsarm run contact-science --effect coulomb-friction:elbow:torque_Nm=25
    """
    from ground.dictionary.effect_tables import effects_json, effects_table

    print_result({"effects": effects_json()}, as_json, effects_table)


def dictionary(
    pattern: Annotated[
        str | None,
        typer.Argument(
            help="Only what is called so: command, EVR, topic, field or parameter; * is any letters.",
            metavar="GLOB",
        ),
    ] = None,
    as_json: JsonOption = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print it as a Markdown page.")] = False,
) -> None:
    """Every command, event report, channel and parameter, with type, unit, limits and what it means.

    Made from the classes that flight software runs on. The plant's truth channels are in it and are marked.

    Example: marsarm dictionary 'joints.elbow.*'
    """
    from ground.common.requests import BadRequest
    from ground.dictionary.entries import build_dictionary as whole_dictionary
    from ground.dictionary.entries import filter_dictionary
    from ground.dictionary.tables import dictionary_json, dictionary_markdown, dictionary_tables

    if as_json and markdown:
        fail(
            "dictionary: --json and --markdown exclude each other; give one of the two",
            EXIT_BAD_INPUT,
            as_json,
        )
    whole = whole_dictionary()
    try:
        part = whole if pattern is None else filter_dictionary(whole, pattern)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    if markdown:
        print(dictionary_markdown(part), end="")
    else:
        print_result(dictionary_json(part), as_json, lambda: dictionary_tables(part))
