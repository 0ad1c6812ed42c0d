"""The verb `effects` and the option --effect, as a user types them."""

import json
from pathlib import Path

from sim.effects.catalogue import catalogue
from tests.marsarm.command import marsarm, marsarm_process


def test_the_catalogue_is_one_document(tmp_path: Path) -> None:
    done = marsarm_process(tmp_path, "dictionary", "--effects", "--json")
    assert done.returncode == 0, done.stderr
    listed = {one["name"]: one for one in json.loads(done.stdout)["effects"]}
    assert set(listed) == set(catalogue())
    bending = listed["link-bending"]
    assert bending["place_fields"] == ["frame", "axis"]
    assert bending["places"][-1] == "arm5.z"
    (parameter,) = bending["parameters"]
    assert (parameter["name"], parameter["unit"]) == ("compliance_rad_Nm", "rad/(N m)")
    assert (parameter["neutral"], parameter["low"], parameter["typical"]) == (0.0, 0.0, 5e-6)
    assert bending["in_flight_parameters"]
    assert bending["is_hypothesis"]
    assert not listed["sensor-fault"]["is_hypothesis"]


def test_an_effect_that_is_wrong_is_refused_before_anything_moves(tmp_path: Path) -> None:
    words = ("--effect", "coulomb-friction:elbo:torque_Nm=1", "--effect", "warming:warming_K=9e9", "--json")
    for verb in (("run", "contact-science"), ("place",), ("hardstop", "--joint", "elbow")):
        done = marsarm(tmp_path, *verb, *words)
        assert done.returncode == 2
        opening, *said = json.loads(done.stdout)["error"].splitlines()
        assert opening == "2 things are wrong, one in each line:"
        assert said[0].startswith(
            "effect coulomb-friction: place: joint 'elbo' is not known; did you mean elbow?"
        )
        assert said[1] == "effect warming: warming_K: 9e+09 is outside -200 .. 200"
    assert not list(tmp_path.iterdir())
