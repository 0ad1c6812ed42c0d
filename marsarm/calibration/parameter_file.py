"""Parameter file of a calibrated arm, which flight software loads, with its provenance."""

import hashlib
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np

from fsw.config import digest
from fsw.dictionary.params import Params
from fsw.kinematics.arm import pose_to_transform6
from fsw.kinematics.transforms import Pose
from marsarm.calibration.arm_parameters import move_zeros_to_hardstops
from marsarm.calibration.calibrate import Calibration, rms_m
from marsarm.calibration.campaign_data import Campaign
from sim.arms import own_name
from sim.params_table import params_toml
from simgap.common.files import atomic_write


def calibrated_params(found: Calibration, tools: dict[str, Pose] | None = None) -> Params:
    """Build the parameters of the calibrated arm, with the encoder zeros in its hardstop angles.

    Args:
        tools: Poses X_FT of registered tools in frame Arm6; they replace the nominal ones.

    Returns:
        Parameters of flight software.
    """
    _, params = move_zeros_to_hardstops(found.nominal, found.best.values)
    registered = {name: pose_to_transform6(X_FT) for name, X_FT in (tools or {}).items()}
    changed = tuple(
        replace(tool, transform=registered.get(tool.name, tool.transform)) for tool in params.tools
    )
    return replace(params, tools=changed, arm_name=own_name(found.campaign.arm_name))


def data_sha256(campaign: Campaign) -> str:
    """Compute a digest of all measured data; it does not depend on the file format."""
    b, m = campaign.believed, campaign.measured
    # a table stores quaternions and half of each covariance, so the last digits of the rest may change
    R = np.round(m.X_RT.R, 8) + 0.0
    upper = m.covariance[:, *np.triu_indices(6)]
    written = BytesIO()
    for values in (b.motor_rad, b.backlash_rad, b.friction_Nm, b.side, b.gravity_R_m_s2, b.turret_kg):
        np.save(written, np.ascontiguousarray(values))
    for values in (R, m.X_RT.p, upper):
        np.save(written, np.ascontiguousarray(values))
    return hashlib.sha256(campaign.arm_name.encode() + written.getvalue()).hexdigest()


def provenance(found: Calibration) -> tuple[str, ...]:
    """Describe the origin of the parameters, one sentence a line; no date, so that files are reproducible."""
    campaign, best = found.campaign, found.best
    left_out = ", ".join(map(str, found.rejection.outliers)) or "none"
    groups, held = np.unique(campaign.group).size, found.held_out_error
    return (
        f"Flight parameters of {campaign.arm_name}, calibrated; those that are not here are nominal.",
        f"Over nominal parameters of digest {digest(found.nominal)}.",
        f"Data of digest {data_sha256(campaign)}:",
        f"{campaign.count} poses in {groups} groups; left out as outliers: {left_out}.",
        f"Position error, root mean square: {1e3 * rms_m(found.before):.3f} mm before, "
        f"{1e3 * rms_m(found.after[:, best.used]):.3f} mm after,",
        f"{1e3 * rms_m(held):.3f} mm on {held.shape[1]} held-out poses.",
        f"Residuals {best.sigma0:.3f} of the noise, p = {best.p_value:.3f}; "
        f"held out {found.hold_out.ratio:.3f} of what is expected.",
        (
            f"Rank {found.frame_identifiability.rank} of 42 frame numbers, {found.identifiability.rank} of "
            f"{best.values.size} in all."
        ),
        "Encoder zeros are in the hardstop angles: find every hardstop anew with this file loaded.",
    )


def save_parameter_file(found: Calibration, params: Params, path: Path) -> None:
    """Write the parameter file.

    Raises:
        BadOutput: The file cannot be written.
    """
    with atomic_write(path, "out") as file:
        file.write(parameter_text(found, params).encode())


def parameter_text(found: Calibration, params: Params) -> str:
    """Format all parameters that differ from the nominal ones as TOML."""
    return params_toml(found.nominal, params, provenance(found))
