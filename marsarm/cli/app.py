"""Command line `marsarm`: its verbs."""

from marsarm.cli.analysis import arm, budget, calibrate, dictionary, ik, monte_carlo, reach
from marsarm.cli.diagnosis import diagnose, gap_app
from marsarm.cli.log import log_app, replay
from marsarm.cli.runs import hardstop, place, run, show, view
from simgap.common.app import make_app, run_app

app = make_app(
    "marsarm", "Control of the arms of Curiosity and like rovers, a MuJoCo plant for them, and ground tools."
)

app.command()(show)
app.command()(place)
app.command()(ik)
app.command()(reach)
app.command()(hardstop)
app.command()(run)
app.command()(view)
app.command()(replay)
app.command()(dictionary)
app.add_typer(log_app, name="log")
app.add_typer(gap_app, name="gap")
app.command()(arm)
app.command()(budget)
app.command("monte-carlo")(monte_carlo)
app.command()(calibrate)
app.command()(diagnose)


def main() -> None:
    """Run the command `marsarm`; `marsarm.__main__` calls this and reports an interruption."""
    run_app(app, "marsarm")
