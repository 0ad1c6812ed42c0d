"""The verb `effects` and the option --effect, as a user types them."""

import json
from pathlib import Path

from sim.effects.catalogue import catalogue
from tests.marsarm.command import marsarm


def test_the_catalogue_is_one_document(tmp_path: Path) -> None:
    done = marsarm(tmp_path, "dictionary", "--effects", "--json")
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
