"""A campaign recorded for a diagnosis, of any arm that can be simulated."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ground.common.files import atomic_path, check_new_path
from ground.common.progress import Progress
from ground.common.requests import BadRequest, check_seed, parse_effects, select_arm
from ground.diagnosis.arm.record import record_campaign
from sim.arms import effects_of_run
from sim.diagnosis_campaign import HELD_OUT_SESSIONS, SessionFailed, campaign_sessions
from sim.initialisation import true_reference
from sim.plant import PlantDiverged

APART: Final = "held-out"
"""Folder, in that of the logs, of those on which a diagnosis is tried."""


@dataclass(frozen=True, slots=True)
class RecordRequest:
    """What is asked."""

    out: Path
    arm: str = "nominal"
    effects: tuple[str, ...] = ()
    params: Path | None = None
    seed: int = 0


def check_record(request: RecordRequest) -> None:
    """Refuse what cannot be recorded, or not there; nothing is written.

    Raises:
        BadRequest, BadOutput: the message says why.
    """
    check_seed(request.seed)
    parse_effects(request.effects)
    select_arm(request.arm, request.params)
    if os.path.exists(request.out) and (not os.path.isdir(request.out) or os.listdir(request.out)):
        raise BadRequest(f"out {request.out}: is there already; name a new folder")
    check_new_path(request.out, "out")


def recorded(request: RecordRequest, progress: Progress) -> list[Path]:
    """Logs of all sessions, those held out in a folder of their own; all of them or none.

    Raises:
        BadRequest: the arm cannot carry out a session with these effects.
    """
    effects = parse_effects(request.effects)
    arm = select_arm(request.arm, request.params).with_effects(effects)
    begun = effects_of_run(effects)
    wanted, reference, paths = campaign_sessions(arm.params), true_reference(arm), []
    try:
        with atomic_path(request.out.resolve()) as part:
            for number, session in enumerate(wanted):
                progress(number, len(wanted), session.name)
                folder = part / APART if session.name in HELD_OUT_SESSIONS else part
                seed = request.seed + number
                made = record_campaign(folder, [session], arm, reference, seed, lambda *_: None, begun)
                paths += [request.out / log.relative_to(part) for log in made]
    except (SessionFailed, PlantDiverged) as error:
        raise BadRequest(f"effect: {error}; with smaller effects it may come to its end") from error
    except OSError as error:
        raise BadRequest(f"out {request.out}: cannot be written ({error.strerror or error})") from error
    progress(len(wanted), len(wanted), "recorded")
    return paths
