"""The poses of the hardstop initialisation, the torques in them, and how much room there is."""

from dataclasses import dataclass, replace

from fsw.dictionary.params import Params
from ground.common.requests import BadRequest
from ground.runs.hardstop import HardstopRequest, checked
from sim.clearance import Clearance, ClearanceModel
from sim.hardstop_loads import HardstopLoads, compute_hardstop_loads, sweep_clearance
from sim.world import World


@dataclass(frozen=True, slots=True, eq=False)
class StopPlan:
    """One place and what hangs on the arm there."""

    place: str
    params: Params
    loads: HardstopLoads
    clearance: Clearance


def plan_stops(request: HardstopRequest) -> tuple[StopPlan, ...]:
    """The plan for Mars with the turret and the one for Earth without it, whose torques are to be the same.

    Raises:
        BadRequest: the request is wrong, asks for motion too, or there is no such plan.
    """
    asked_to_move = (request.joint, request.start_deg, request.picture) != (None, None, None)
    if asked_to_move or request.repeat > 1 or not request.turret:
        raise BadRequest("plan: moves nothing, and is of both places; give nothing but --arm and --params")
    whole = checked(request).arm
    bare = checked(replace(request, scene="earth", turret=False)).arm
    return (
        _plan("mars, with turret", whole.params, World()),
        _plan("earth, without turret", bare.params, World("earth")),
    )


def _plan(place: str, params: Params, world: World) -> StopPlan:
    loads = compute_hardstop_loads(params, world.gravity_N_m_s2)
    return StopPlan(place, params, loads, sweep_clearance(params, ClearanceModel(params, world)))
