"""A diagnosis as it is asked for on the command line."""

import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params
from ground.common.requests import BadRequest, check_seed, parse_effects
from ground.diagnosis.arm.simulator import raced
from sim.effects.catalogue import catalogue, effect_name
from sim.effects.effect import Effect
from sim.params import BadParams, nominal_params, params_over_nominal
from sim.scenario.names import shorten

NEAREST: Final = 3
"""Names that may have been meant."""


@dataclass(frozen=True, slots=True)
class DiagnoseRequest:
    """What is asked."""

    logs: tuple[Path, ...]
    held_out: tuple[Path, ...] = ()
    """Logs that take no part in fitting or choosing."""
    params: Path | None = None
    """Flight parameters over nominal ones, as TOML."""
    kinds: tuple[str, ...] | None = None
    """Names of the effects that may be the cause; None for the whole catalogue."""
    campaign: Path | None = None
    """Folder with logs of the campaign that these repeat, and its sensitivities; None for their own."""
    seed: int = 0
    patch: tuple[Effect, ...] = ()
    """Effects that are switched on in the simulator from the beginning."""

    @property
    def base(self) -> Params:
        """The flight parameters that the arm had."""
        return nominal_params() if self.params is None else params_over_nominal(self.params)


def diagnose_request(
    logs: Sequence[Path],
    held_out: Sequence[Path] = (),
    params: Path | None = None,
    names: str | None = None,
    campaign: Path | None = None,
    seed: int = 0,
    effects: Sequence[str] = (),
) -> DiagnoseRequest:
    """The request, folders opened and everything checked that needs no log to be read.

    `names` are effects with commas between them, `effects` what is switched on already.

    Raises:
        BadRequest: a file is not there or is given twice, a name is not known, or parameters are wrong.
    """
    check_seed(seed)
    fitted, apart = tuple(_logs(logs, "log")), tuple(_logs(held_out, "held-out log"))
    _check_different(fitted, apart)
    if params is not None:
        try:
            params_over_nominal(params)
        except BadParams as error:
            raise BadRequest(str(error)) from error
    if campaign is not None and not os.path.isdir(campaign):
        raise BadRequest(f"campaign {campaign}: there is no such folder of logs")
    kinds = None if names is None else _kinds(names)
    return DiagnoseRequest(fitted, apart, params, kinds, campaign, seed, parse_effects(tuple(effects)))


def _logs(given: Sequence[Path], what: str) -> Iterator[Path]:
    """Files as they are, folders as what is in them, in the order of names."""
    for path in given:
        if os.path.isdir(path):  # unlike Path.is_dir, False for any bad name
            inside = sorted(one for one in path.glob("*.mcap") if one.is_file())
            if not inside:
                raise BadRequest(f"{what} {path}: this folder holds no .mcap file")
            yield from inside
        elif os.path.isfile(path):
            yield path
        elif os.path.exists(path):
            raise BadRequest(f"{what} {path}: this is neither a regular file nor a folder")
        else:
            raise BadRequest(f"{what} {path}: there is no such file or folder")


def _check_different(fitted: tuple[Path, ...], apart: tuple[Path, ...]) -> None:
    """Refuse the same data twice, under one name or two."""
    known: dict[str, Path] = {}
    for path in (*fitted, *apart):
        try:
            same = known.setdefault(_digest(path), path)
        except OSError as error:
            raise BadRequest(f"log {path}: cannot be read ({error.strerror})") from error
        if same is path:
            continue
        if path in apart and same in fitted:
            raise BadRequest(
                f"held-out log {path}: this is log {same} too; what is held out takes no part in fitting"
            )
        raise BadRequest(f"log {path}: is the same as {same}; give each once")


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _kinds(names: str) -> tuple[str, ...]:
    """In the order of the catalogue."""
    known = {effect_name(one.kind) for one in raced(None)}
    wanted = {name.strip() for name in names.split(",")}
    problems = [_unknown(name, known) for name in sorted(wanted - known)]
    if problems:
        raise BadRequest("\n".join(problems))
    return tuple(name for name in catalogue() if name in wanted)


def _unknown(name: str, known: set[str]) -> str:
    if name in catalogue():
        return (
            f"catalogue: {name} is an effect whose size alone does not make it a cause that could be told; "
            "leave it out"
        )
    near = get_close_matches(name.lower(), sorted(known), n=NEAREST, cutoff=0.4)
    meant = f"did you mean {' or '.join(near)}? " if near else ""
    return f"catalogue: effect {shorten(name)!r} is not known; {meant}`marsarm effects` lists what there is"
