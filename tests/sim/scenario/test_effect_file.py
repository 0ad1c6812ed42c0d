"""Effect files: written effects read back, and errors name the key."""

import pytest

from sim.effects.catalogue import hypotheses
from sim.scenario.effects import BadEffect, effect_file_text, read_effect_file
from tests.tools import TOOLS


@pytest.mark.parametrize(
    "effects", [(), tuple(one.typical(1.0 / 3.0) for one in hypotheses())], ids=["none", "all"]
)
def test_effects_come_back_exactly(tmp_path, effects):
    path = tmp_path / "found.toml"
    path.write_text(effect_file_text(effects, ["comment"]))
    assert read_effect_file(path, TOOLS) == effects


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[[effect]]\ntype = "coulomb-frictoin"\n', "effect[1].type: effect 'coulomb-frictoin' is not"),
        ('arm = "nominal"\n', "found.toml: arm: does not belong in a file of effects; there is only"),
        ("[[effect]\n", "found.toml: is not TOML"),
        ("effect = 3\n", "found.toml: effect: is no list of tables"),
        (None, "cannot be read"),
    ],
)
def test_what_is_wrong_is_told_with_its_key(tmp_path, text, expected):
    path = tmp_path / "found.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadEffect) as refused:
        read_effect_file(path, TOOLS)
    assert expected in str(refused.value)
