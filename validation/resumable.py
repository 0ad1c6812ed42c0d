"""Results of a campaign in a file, from which an interrupted campaign goes on."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from marsarm.common.checkpoint import Checkpoint
from simgap.selection.checkpoint import digest_code

Result = dict[str, Any]
Once = Callable[[str, Callable[[], Result]], Result]
"""Function of the name of a result and of the work that makes it; the work is done once."""


@contextmanager
def keep_results(path: Path | None, seed: int) -> Iterator[Once]:
    """Keep the results of a block in a file, one JSON line each.

    Args:
        path: The file; None keeps nothing.
        seed: Seed of the campaign. Results of another seed, or of other code of the diagnosis, are refused.

    Raises:
        BadRequest: The file belongs to another campaign, or cannot be written.
    """
    request = {"seed": seed, "code of the diagnosis": digest_code()[:12]}
    with nullcontext() if path is None else Checkpoint(path, request) as kept:
        known: dict[str, Result] = {} if kept is None else {one["name"]: one["result"] for one in kept.done}

        def once(name: str, work: Callable[[], Result]) -> Result:
            if name not in known:
                known[name] = work()
                if kept is not None:
                    kept.add({"name": name, "result": known[name]})
            return known[name]

        yield once
