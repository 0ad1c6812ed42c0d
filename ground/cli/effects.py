"""The verb `effects`; thin."""

from ground.cli.options import JsonOption, show


def effects(as_json: JsonOption = False) -> None:
    """List the effects that the plant knows: what each is, where it can sit, and its parameters.

    Switch one on with --effect of run, place or hardstop, or with [[effect]] in a scenario.

    Example: marsarm run contact-science --effect coulomb-friction:elbow:torque_Nm=25
    """
    from ground.dictionary.effect_tables import effects_json, effects_table

    show({"effects": effects_json()}, as_json, effects_table)
