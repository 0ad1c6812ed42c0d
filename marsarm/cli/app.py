"""Assemble the command line `marsarm` and write its output.

Exit status: 0 done; 1 a bug; 2 bad input; 3 the arm refused or faulted and is safe; 130 interrupted by
Ctrl-C, 143 by SIGTERM; 141 the reader of the output is closed.
"""



from marsarm.cli.accuracy import budget, monte_carlo
from marsarm.cli.arm import arm_app
from marsarm.cli.calibrate import calibrate
from marsarm.cli.diagnosis import diagnose, gap_app
from marsarm.cli.dictionary import dictionary, effects
from marsarm.cli.ik import ik, reach
from marsarm.cli.log import log_app, replay
from marsarm.cli.runs import hardstop, place, run, scenarios
from marsarm.cli.view import view
from simgap.common.verb import EFFECT_MODULES, VerbCommand, make_app, run_app

app = make_app(
    "marsarm", "Control of the arms of Curiosity and like rovers, a MuJoCo plant for them, and ground tools."
)
EFFECT_MODULES.append("sim.scenario.effects")

app.command()(place)
app.command(cls=VerbCommand)(ik)
app.command(cls=VerbCommand)(reach)
app.command()(hardstop)
app.command()(run)
app.command()(scenarios)
app.command()(view)
app.command()(replay)
app.command()(dictionary)
app.command()(effects)
app.add_typer(log_app, name="log")
app.add_typer(gap_app, name="gap")
app.add_typer(arm_app, name="arm")
app.command()(budget)
app.command("monte-carlo", cls=VerbCommand)(monte_carlo)
app.command()(calibrate)
app.command(cls=VerbCommand)(diagnose)


def main() -> None:
    """Run the command `marsarm`; `marsarm.cli.start` calls this and reports an interruption."""
    run_app(app, "marsarm")
