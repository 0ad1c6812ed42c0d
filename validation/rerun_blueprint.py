"""Make the blueprint for Rerun, `docs/marsarm.rbl`: the arm, its events, angles, rates and torques."""

from pathlib import Path
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from validation.campaigns import Context, Document

PATH: Final = Path(__file__).parents[1] / "docs" / "marsarm.rbl"
APPLICATION: Final = "marsarm"
"""Application that the blueprint belongs to; Rerun shows it with logs that were converted for it."""
EYE_M: Final = (3.4, -1.5, 0.3)
LOOK_AT_M: Final = (1.4, 0.05, -0.5)
"""Eye and centre of the view in the frame `map`: the workspace, from the front starboard corner."""
COLOURS: Final = (0x4E98E2FF, 0xF5774DFF, 0xE0C020FF, 0x5CD6A9FF, 0xA395E2FF)
"""Colours of the joints, azimuth first."""
SHAPES: Final = (rr.Boxes3D, rr.Cylinders3D, rr.Ellipsoids3D)


def blueprint() -> rrb.Blueprint:
    """Return the blueprint."""
    arm = rrb.Spatial3DView(
        origin="/",
        contents=["/marsarm/**", "/tf/**", "/tf_static/**"],
        name="Arm",
        spatial_information=rrb.SpatialInformation("map"),
        eye_controls=rrb.EyeControls3D(position=EYE_M, look_target=LOOK_AT_M, eye_up=(0, 0, 1)),
        defaults=[shape.from_fields(fill_mode="solid") for shape in SHAPES],
    )
    titles = {"position": "Joint angles, output, believed [rad]", "velocity": "Motor rates [rad/s]"}
    titles["effort"] = "Torques from currents [N m]"
    plots = [
        rrb.TimeSeriesView(
            origin=f"/joint_states/{key}",
            name=title,
            overrides={f"/joint_states/{key}": rr.SeriesLines.from_fields(colors=COLOURS)},
        )
        for key, title in titles.items()
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(arm, rrb.TextLogView(origin="/rosout", name="Events"), row_shares=[3, 1]),
            rrb.Vertical(*plots),
            column_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="message_log_time"),
    )


def campaign(context: Context) -> Document:
    """Write the blueprint."""
    path = context.out or PATH
    blueprint().save(APPLICATION, path)
    return {"blueprint": str(path)}
