"""Names of version 0.1 and their names today: for old logs, and for the error of a file with an old name.

No name is both an old and a new one. docs/renamed-0.2.md lists them for people.
"""

from collections.abc import Iterable
from typing import Final

CHANNELS: Final = {
    "/joint.gap_rad": "/joint.backlash_rad",
    "/joint.gap_side": "/joint.backlash_side",
    "/joint.gap_uncertainty_rad": "/joint.backlash_uncertainty_rad",
    "/joint.planned_gap_rad": "/joint.planned_backlash_rad",
}
EVRS: Final = {
    "ForceFelt": "ForceEstimated",
    "NoHardstop": "HardstopImplausible",
    "SpotTaken": "SpotSet",
}
EVR_FIELDS: Final = {
    "MotorStalled.asked_rad_s": "MotorStalled.commanded_rad_s",
    "NoHardstop.drawn_urad_Nm": "HardstopImplausible.nominal_urad_Nm",
    "TiltSet.off_rad": "TiltSet.difference_rad",
}
COMMAND_FIELDS: Final = {
    "Calibrate.anew": "Calibrate.accept_moved",
    "CalibrateAll.anew": "CalibrateAll.accept_moved",
    "MoveTeachPoint.away_m": "MoveTeachPoint.standoff_m",
}
PARAMETERS: Final = {
    "hardstop.again_rad": "hardstop.second_start_rad",
    "motion.approach_rad": "motion.takeup_rad",
    "motion.load_period": "motion.load_period_cycles",
    "motion.stowed_rad": "motion.stow_tolerance_rad",
    "preload.guard_share": "preload.current_margin_share",
    "preload.most_N": "preload.max_force_N",
}
REFERENCE_FIELDS: Final = {"reference.half_gap_rad": "reference.half_backlash_rad"}
EFFECT_PARAMETERS: Final = {
    "flex-cable.give_rad": "flex-cable.transition_rad",
    "flex-cable.laid_rad": "flex-cable.neutral_rad",
    "numerics.finer": "numerics.substeps",
    "numerics.gears": "numerics.scheme",
}

FILE_KEYS: Final = {
    "sentence": ("summary",),
    "most_N": ("max_N", "max_force_N"),
    "gap_s": ("max_interval_s",),
    "share": ("tolerance_cycles",),
    "approach_rad": ("hysteresis_rad",),
    "wave_rad": ("periodic_rad",),
    "uncertain": ("uncertainty",),
    "repeats": ("repeatability",),
    "half_gap_rad": ("half_backlash_rad",),
    "outside": ("out-of-catalogue",),
}
"""Today's names by old names of keys in files other than logs; one of them fits the place of the key."""
OPTIONS: Final = {
    "--ladder": "--nested",
    "--how": "--move-model",
}
"""Options that no verb has any more; --share of calibrate-serial is --fit-share."""
PAGE: Final = "docs/renamed-0.2.md"
"""Page that lists all renamed names."""

TABLES: Final = (CHANNELS, EVRS, EVR_FIELDS, COMMAND_FIELDS, PARAMETERS, REFERENCE_FIELDS, EFFECT_PARAMETERS)


def find_new_name(old: str, known: Iterable[str]) -> str | None:
    """Return which of the known names has replaced an old one; None if none has.

    Names with a dot in front, such as `motion.load_period`, may be given with or without it.
    """
    names = set(known)
    candidates = [new for table in TABLES for name, new in table.items() if old in (name, _last(name))]
    candidates += FILE_KEYS.get(old, ())
    whole = (new for new in candidates if new in names)
    return next(whole, next((_last(new) for new in candidates if _last(new) in names), None))


def renamed_text(new: str) -> str:
    """Return the advice for a name that is an old one."""
    return f"it is {new} since version 0.2, and {PAGE} lists all new names"


def _last(name: str) -> str:
    return name.rsplit(".", 1)[-1]
