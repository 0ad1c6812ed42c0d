"""What was found, as files: effects for the simulator, and parameters for flight software."""

from collections.abc import Mapping
from pathlib import Path

from fsw.dictionary.params import Params
from ground.common.files import atomic_write
from ground.common.params_toml import params_toml
from ground.diagnosis.arm.simulator import raced, switched_on, told
from ground.diagnosis.result import Result
from ground.diagnosis.told import others
from sim.effects.catalogue import effect_name, has_flight_parameter
from sim.effects.effect import Effect
from sim.params import BadParams, check_params, nominal_params
from sim.scenario.effect_file import effect_file_text
from sim.scenario.effects import effect_text


class NothingToWrite(Exception):
    """There is nothing that such a file could say; the message says why."""


def found_effects(result: Result, kinds: Mapping[str, type[Effect]] | None = None) -> tuple[Effect, ...]:
    """The effects of a diagnosis, of the catalogue or of these, each of the size that was found.

    Raises:
        NothingToWrite: the verdict names none.
    """
    said = result.diagnosis
    if said.verdict in ("none", "unknown"):
        raise NothingToWrite(f"the verdict is {said.verdict}, so there is no effect to switch on")
    made = {told(one): one for one in raced(kinds)}
    named = [(result.ready.found.hypotheses[one.hypothesis], one.values) for one in said.findings]
    return tuple(switched_on(made[hypothesis], hypothesis, values) for hypothesis, values in named)


def save_patch(result: Result, path: Path) -> None:
    """Write the file that switches on what was found, for --effect and for a scenario.

    Raises:
        NothingToWrite: the verdict names no effect.
        BadOutput: the file cannot be written.
    """
    effects = found_effects(result)
    with atomic_write(path, "patch") as file:
        file.write(effect_file_text(effects, _said(result)).encode())


def new_params(base: Params, effects: tuple[Effect, ...]) -> Params:
    """Flight parameters that know what was found, as far as they have a word for it.

    Raises:
        NothingToWrite: they have none for any of it, or flight software would not take them.
    """
    params = base
    for effect in effects:
        params = effect.on_params(params)
    if params == base:
        names = ", ".join(effect_text(effect) for effect in effects)
        raise NothingToWrite(f"flight parameters have no word for {names}")
    try:
        check_params(params, "flight software would not take them")
    except BadParams as error:
        raise NothingToWrite(str(error)) from error
    return params


def save_new_params(result: Result, base: Params, path: Path) -> None:
    """Write the parameter file for --params: all that is not nominal in `base` and in what was found.

    Raises:
        NothingToWrite: there are no new parameters.
        BadOutput: the file cannot be written.
    """
    effects = found_effects(result)
    params = new_params(base, effects)
    silent = [effect_name(type(effect)) for effect in effects if not has_flight_parameter(type(effect))]
    said = [
        "Flight parameters that know what a diagnosis found; those that are not here are nominal.",
        *(f"Effect: {effect_text(effect)}" for effect in effects),
        *(f"They have no word for {name}." for name in silent),
    ]
    with atomic_write(path, "new-params") as file:
        file.write(params_toml(nominal_params(), params, said).encode())


def _said(result: Result) -> list[str]:
    """What was found and what it was not told from, a sentence a line."""
    names = [hypothesis.name for hypothesis in result.ready.found.hypotheses]
    lines = ["What a diagnosis found; switch it on with --effect and the name of this file."]
    for finding in result.diagnosis.findings:
        own = names[finding.hypothesis]
        alike = [names[one] for one in finding.confusable if one != finding.hypothesis]
        rest = [names[one] for one, _ in others(finding)]
        lines += [f"{own} is not told from {one}." for one in alike]
        lines += [f"In the stead of {own} may stand {one}." for one in rest]
    return lines
