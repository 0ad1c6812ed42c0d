"""Progress of long work: its interface, and a bar on standard error."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[float, float, str], None]
"""Function of the amount done, the total amount, and the name of the current activity."""


def no_progress(done: float, total: float, what: str) -> None:
    """Show nothing."""


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Show a progress bar, on a terminal only; give the function that updates it."""
    from rich import progress as rich_progress  # workers need no rich
    from rich.console import Console

    columns = (
        rich_progress.TextColumn("{task.description:<12}"),
        rich_progress.BarColumn(),
        rich_progress.TextColumn("{task.percentage:>3.0f} %"),
        rich_progress.TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    hidden = not console.is_terminal
    with rich_progress.Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("starting", total=None)

        def update(done: float, total: float, what: str) -> None:
            bar.update(task, completed=min(done, total), total=total, description=what)

        yield update
