"""Out-of-catalogue effects from a folder of Python files."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.simulator import make_effect, to_hypothesis
from marsarm.diagnosis.problem import Hypothesis
from marsarm.diagnosis.sampling import DetectableEffect
from sim.effects import catalogue
from sim.effects.effect import Effect
from sim.params import nominal_params
from sim.scenario.effects import BadEffect, effect_classes_in_file, effect_text, parse_effect_text
from simgap.common.errors import BadRequest

EFFECTS_FOLDER: Final = Path(__file__).resolve().parents[2] / "validation" / "out_of_catalogue_effects"


@dataclass(frozen=True, slots=True, eq=False)
class UncataloguedEffect:
    """Out-of-catalogue effect at a place."""

    hypothesis: Hypothesis
    catalogue_entry: catalogue.EffectHypothesis

    def spec(self, values: Array) -> str:
        """Return the text that switches the effect on, with the name of its file in the folder."""
        text = effect_text(make_effect(self.catalogue_entry, self.hypothesis, values))
        return text.removeprefix(f"{EFFECTS_FOLDER}/")


@cache
def list_uncatalogued() -> Mapping[tuple[str, str], UncataloguedEffect]:
    """List all out-of-catalogue effects by effect and place; BadRequest if there are no files."""
    files = sorted(EFFECTS_FOLDER.glob("*/*.py"))
    if not files:
        raise BadRequest(f"{EFFECTS_FOLDER}: holds no effects; cases are made in a clone of the repository")
    kinds = {kind.__name__: kind for file in files for kind in effect_classes_in_file(str(file))}
    found = (UncataloguedEffect(to_hypothesis(made), made) for made in catalogue.hypotheses(kinds))
    return {(one.hypothesis.effect, one.hypothesis.place): one for one in found}


def list_samplable() -> list[DetectableEffect]:
    """List all out-of-catalogue effects for sampling; their typical size stands for the detection limit.

    The limit itself takes a minute of CPU for each of several hundred effects and places.
    """
    return [DetectableEffect(one.hypothesis, 1.0, None) for one in list_uncatalogued().values()]


def resolve_effect(spec: str) -> Effect:
    """Return the effect of a text, in the catalogue or in the folder."""
    try:
        text = str(EFFECTS_FOLDER / spec) if ".py:" in spec else spec
        return parse_effect_text(text, nominal_params().tool_names)
    except BadEffect as error:
        raise BadRequest(str(error)) from error
