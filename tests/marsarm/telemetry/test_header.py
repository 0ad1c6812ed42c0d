"""Header of a log: software, processor and start conditions of flight software."""

import hashlib
import json
from functools import cache

import pytest

from fsw.dictionary.commands import MoveJoint, Stop
from fsw.dictionary.enums import Joint
from marsarm.telemetry.header import commands_header, flight_header, model_digest, run_header
from sim.arms import arm_named
from sim.effects.gears import CoulombFriction
from sim.effects.geometry import Warming
from sim.loop import ClosedLoop, Setup
from sim.setting import World

KEYS = {
    *("marsarm", "mujoco", "numpy", "python", "cpu", "git", "arm", "seed", "request", "effects"),
    *("params", "params_sha256", "mjcf_sha256", "commands", "commands_sha256", "boot"),
}


def loop_of(name: str = "nominal", world: World | None = None) -> ClosedLoop:
    arm = arm_named(name)
    return ClosedLoop(Setup(arm, world or World(), arm.params.poses.stowed_rad, 3))


@cache
def nominal() -> ClosedLoop:
    """Return a loop that no test may advance."""
    return loop_of()


def test_a_header_holds_everything_as_text():
    header = run_header(nominal(), "nominal", 3, {"tool": "apxs"}, (Stop(),))
    assert header.keys() == KEYS
    assert all(isinstance(value, str) for value in header.values())
    assert json.loads(header["boot"])["mode"] == "STOWED"
    assert header["params_sha256"] == nominal().config.params_sha256
    assert json.loads(header["cpu"])[-1].startswith("OpenBLAS ")
    assert (header["seed"], json.loads(header["request"])) == ("3", {"tool": "apxs"})


def test_a_header_names_the_effects_that_were_switched_on():
    effects = (CoulombFriction(Joint.ELBOW, 25.0), Warming(10.0))
    header = run_header(nominal(), "nominal", 3, {}, (), effects)
    assert json.loads(header["effects"]) == [
        "coulomb-friction:elbow:torque_Nm=25.0",
        "warming:warming_K=10.0",
    ]


def test_the_flight_header_has_nothing_of_the_plant():
    """The flight header has no arm, seed, request, effects or digest of the model."""
    flown = flight_header(nominal(), (Stop(),))
    assert KEYS - flown.keys() == {"arm", "seed", "request", "effects", "mjcf_sha256"}


def test_the_plants_digest_knows_the_world_and_the_arm():
    loops = (nominal(), loop_of(world=World(tilt_roll_rad=1e-9)), loop_of("as-built:1"))
    assert len({model_digest(loop.plant.model) for loop in loops}) == 3


def test_a_digest_is_that_of_the_commands_as_written():
    header = commands_header((MoveJoint(Joint.WRIST, 0.1),))
    written = [{"type": "MoveJoint", "fields": {"joint": "WRIST", "angle_rad": 0.1, "backlash": "on"}}]
    assert json.loads(header["commands"]) == written
    assert header["commands_sha256"] == hashlib.sha256(header["commands"].encode()).hexdigest()


def test_a_run_under_way_has_no_header_any_more():
    loop = loop_of()
    loop.cycle()
    with pytest.raises(ValueError, match="the run is at tick 1"):
        run_header(loop, "nominal", 3, {}, ())
