"""Arms that can be simulated, by name, with their random manufacturing tolerances; and flight parameters."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from fsw.dictionary.params import Params
from sim.arm_model.description import BadArm
from sim.arm_model.load import ArmModel, arm_names, default_arm, default_name, has_description, load_arm
from sim.params import BadParams, merge_tables, params_from_table, params_table, read_params_toml

if TYPE_CHECKING:  # a nominal arm has no effects, which take 0.1 s to load
    from sim.effects.effect import Effect

MAX_SEED_DIGITS: Final = 9
ARM_PATTERN: Final = re.compile(r"nominal|(?:as-built|calibrated):[0-9]+")


class UnknownArm(ValueError):
    """Name that is not an arm."""


@dataclass(frozen=True, slots=True)
class BuiltArm:
    """Arm: its differences from the drawing, and its flight parameters."""

    name: str
    """Name that leads back to it; see `own_name`."""
    effects: "tuple[Effect, ...]"
    params: Params
    model: ArmModel = field(default_factory=default_arm)
    """Drawing that the arm is built from."""

    def with_effects(self, effects: "Iterable[Effect]") -> "BuiltArm":
        """Return the arm with effects that it has before a run; EffectMisfit if it has no such place."""
        from sim.effects.effect import check_effects

        effects = tuple(effects)
        check_effects(effects, self.params)
        return replace(self, effects=(*self.effects, *(effect for effect in effects if effect.built_in)))


def arm_named(name: str, params: Params | None = None) -> BuiltArm:
    """Make the arm of this name: `nominal`, `as-built:SEED` or `calibrated:SEED`, of the default drawing.

    `MODEL/NAME`, or `MODEL` alone for `MODEL/nominal`, is an arm of another drawing: the name of one that
    comes with the project, or a folder with an `arm.toml`.

    Raises:
        UnknownArm: the name has none of these forms, or the drawing is wrong.
    """
    known = _parse_name(name)
    model, flight_params = known.model, params or known.model.params
    named = known.own_name if known.folder is None else name  # a folder is found by its name only
    if known.kind == "nominal":
        return BuiltArm(named, (), flight_params, model)
    from sim.effects.effect import params_with_effects
    from sim.tolerances import draw_calibration_errors, draw_tolerances, is_calibrated

    effects = draw_tolerances(model, known.seed)
    if known.kind == "calibrated":
        errors = draw_calibration_errors(model, known.seed)
        known_effects = filter(is_calibrated, effects)
        flight_params = params_with_effects((*known_effects, *errors), flight_params)
    return BuiltArm(named, effects, replace(flight_params, arm_name=known.own_name), model)


def own_name(name: str) -> str:
    """Return the name of an arm in its parameters, the same for all that lead to it; UnknownArm if none does.

    It is the name of the drawing, unless that is the default one, and kind and seed: `m2020/as-built:7`.
    """
    return _parse_name(name).own_name


@dataclass(frozen=True, slots=True)
class _ArmName:
    """Parts of the name of an arm."""

    model: ArmModel
    folder: str | None
    """Folder of the drawing; None if it comes with the project."""
    kind: str
    seed: int

    @property
    def own_name(self) -> str:
        """Return the name in parameters."""
        drawing = "" if self.model.name == default_name() else f"{self.model.name}/"
        return f"{drawing}{self.kind}" + ("" if self.kind == "nominal" else f":{self.seed}")


def _parse_name(name: str) -> _ArmName:
    folder, slash, last = name.rpartition("/")
    is_kind = ARM_PATTERN.fullmatch(last) is not None
    model = name if not is_kind else folder if slash else default_name()
    if not has_description(model):
        raise UnknownArm(
            f"arm {name!r} is not known; write nominal, as-built:SEED or calibrated:SEED, or put a drawing "
            f"and / before it: {', '.join(arm_names())}, or a folder with an arm.toml"
        )
    kind, _, seed = (last if is_kind else "nominal").partition(":")
    if len(seed) > MAX_SEED_DIGITS:
        raise UnknownArm(
            f"arm {kind}: its seed has {len(seed)} digits; give one with {MAX_SEED_DIGITS} at most"
        )
    is_ours = model in arm_names()
    try:
        drawing = default_arm() if model == default_name() else load_arm(model)
        if not is_ours:
            from sim.arm_check import check_arm  # takes 0.1 s to load; a test checks the arms of the project

            check_arm(drawing)
    except (BadArm, BadParams) as error:
        raise UnknownArm(str(error)) from error
    return _ArmName(drawing, None if is_ours else model, kind, int(seed or 0))


def effects_of_run(effects: "Iterable[Effect]") -> "tuple[Effect, ...]":
    """Return the effects that begin with a run, not with the making of the arm."""
    return tuple(effect for effect in effects if not effect.built_in)


def nominal_params() -> Params:
    """Return the parameters of the drawing of the default arm."""
    return default_arm().params


def params_over_nominal(path: Path) -> Params:
    """Read a TOML file with any part of the parameters, over the default arm; BadParams if it is wrong."""
    return params_over(nominal_params(), path)


def params_over(params: Params, path: Path) -> Params:
    """Read a TOML file with any part of the parameters, over `params`; BadParams if it is wrong."""
    return params_from_table(merge_tables(params_table(params), read_params_toml(path)), str(path))
