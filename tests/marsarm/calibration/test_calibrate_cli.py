"""`marsarm calibrate`: parameter file, document and page; with bad input nothing is written."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.kinematics.arm import build_arm
from marsarm.calibration import execution
from marsarm.calibration.calibrate import calibrated_params, data_sha256, parameter_text
from marsarm.calibration.campaign_data import save_campaign
from marsarm.common.options import CalibrateRequest
from marsarm.common.requests import select_arm
from sim.arms import params_over_nominal
from simgap.common.errors import BadRequest
from tests.marsarm.calibration.lab import calibration, campaign
from tests.marsarm.command import marsarm_json


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "poses.parquet"
    save_campaign(campaign(), path)
    return path


def test_the_command_writes_parameters_that_flight_software_loads(table, tmp_path, monkeypatch):
    def fitted(_, given, **__):
        """Return the fit of the same poses that other tests use."""
        assert data_sha256(given) == data_sha256(campaign())
        return calibration()

    monkeypatch.setattr(execution, "calibrate", fitted)
    document = marsarm_json(tmp_path, "calibrate", "--data", str(table), "--out", "arm.toml")
    assert document["arm"] == "as-built:1"
    assert document["rank"]["frames"] == 26
    loaded = params_over_nominal(tmp_path / "arm.toml")
    ours = build_arm(calibrated_params(calibration()))
    np.testing.assert_allclose(build_arm(loaded).RP_CF, ours.RP_CF, atol=1e-9)
    assert loaded.arm_name == "as-built:1"


def test_a_verification_that_fails_loses_neither_poses_nor_parameters(tmp_path, monkeypatch):
    def fail(*_):
        raise BadRequest("not verified")

    for name, value in (("run_campaign", campaign()), ("calibrate", calibration()), ("register_tools", None)):
        monkeypatch.setattr(execution, name, lambda *_, own=value, **__: own)
    monkeypatch.setattr(execution, "earth_reference", lambda *_: None)
    monkeypatch.setattr(execution, "verify_calibration", fail)
    data, out = tmp_path / "poses.csv", tmp_path / "arm.toml"
    with pytest.raises(BadRequest, match="not verified"):
        execution.run_calibration(CalibrateRequest(arm="as-built:1", verify=1, save_data=data, out=out))
    assert data.stat().st_size > 0
    assert out.stat().st_size > 0


def test_the_parameter_file_says_where_it_comes_from_and_is_always_the_same(table):
    text = parameter_text(calibration(), calibrated_params(calibration()))
    assert text == parameter_text(calibration(), calibrated_params(calibration()))
    for words in ("as-built:1", "Data of digest", "160 poses", "Rank 26 of 42", "held-out poses"):
        assert words in text


def test_parameters_of_another_arm_are_refused(table, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text('arm_name = "as-built:9"\n')
    with pytest.raises(BadRequest, match="of the arm as-built:9, not of as-built:1"):
        execution.run_calibration(CalibrateRequest(data=table, params=other))


@pytest.mark.parametrize("name", ["as-built:1", "as-built:01", "msl/as-built:1"])
def test_the_parameters_of_a_calibration_are_those_of_its_arm_by_any_name(name, tmp_path):
    found = tmp_path / "found.toml"
    found.write_text(parameter_text(calibration(), calibrated_params(calibration())))
    assert select_arm(name, found).params == calibrated_params(calibration())


def test_data_of_an_arm_that_is_not_known_are_refused(tmp_path):
    save_campaign(replace(campaign(), arm_name="flight-unit"), tmp_path / "poses.csv")
    with pytest.raises(BadRequest, match="column arm: arm 'flight-unit' is not known"):
        execution.run_calibration(CalibrateRequest(data=tmp_path / "poses.csv"))
