"""Residuals of a second encoder on an arm whose truth is simulated, and on the KR300."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.two_joint_arm import PERIOD_s, arm, check_promises, rms, simulated
from simgap.common.errors import RobotError
from simgap.diagnosis import diagnose
from simgap.effects.command import EncoderScale, MeasurementDelay
from simgap.effects.effect import joint_scales
from simgap.effects.forces import CoulombFriction
from simgap.effects.transmission import Backlash, JointCompliance
from simgap.logs import JointLog, Motion, Signal
from simgap.residuals.encoder_residuals import EncoderResiduals, shows, why_refused

SKEW_s, COMPLIANCE_rad_Nm, OFFSET_rad = 0.003, 2e-5, 0.02
SPRING_Nm = 8.0
"""Counterbalance at the shoulder, which the model does not have."""


def counterbalance_Nm(q):
    return np.array((SPRING_Nm * np.cos(q[0]), 0.0))


@cache
def motor_log():
    return simulated(arm(), seed=3, duration_s=6.0, applied_Nm=counterbalance_Nm)


def second_log(late_s=SKEW_s, compliance=COMPLIANCE_rad_Nm, offset_rad=OFFSET_rad, scale=0.0):
    """Add second encoders: at the shoulder the gear bends under its load."""
    motion = motor_log()
    joints = {}
    for name, one in motion.joints.items():
        time_s, q = one.position.time_s, one.position.value
        shown = q.copy()
        if name == "shoulder":
            speed = np.gradient(q, time_s)
            dry = 3.0 * np.tanh(speed / 0.01) + 2.0 * speed
            load_Nm = one.torque.value - dry - 0.5 * np.gradient(speed, time_s)
            shown = np.interp(time_s - late_s, time_s, q - compliance * load_Nm) * (1 + scale)
        joints[name] = replace(one, secondary=Signal(time_s, shown + offset_rad))
    return Motion("m", joints, {})


def effects_at(joint, robot=None):
    robot = robot or arm()
    index = [one.name for one in robot.joints].index(joint)
    delay = MeasurementDelay.at(robot, joint, joint_scales(robot, [motor_log()]))
    return [delay, JointCompliance(joint, index, False, 1e-5, 1e-3)]


def least_squares(model, effects, rows, n_steps=3):
    """Fit sizes, and return them with their residuals and Jacobian in these rows."""
    typical = np.array([0.1 * size.typical for effect in effects for size in effect.sizes])
    sizes = np.zeros(typical.size)
    for _ in range(n_steps):
        points = np.vstack((sizes, sizes + np.diag(typical)))
        found = model.residuals(effects, points)[:, rows]
        jacobian = (found[1:] - found[0]).T / typical
        step = np.linalg.lstsq(jacobian / np.linalg.norm(jacobian, axis=0), found[0])[0]
        sizes = sizes - step / np.linalg.norm(jacobian, axis=0)
    return sizes, model.residuals(effects, sizes[None])[0][rows], jacobian


def test_skew_and_compliance_come_back_behind_a_counterbalance_that_the_model_lacks():
    model = EncoderResiduals(arm(), [second_log()])
    sizes, rest, _ = least_squares(model, effects_at("shoulder"), model.joint_of == 0)
    assert sizes[0] == pytest.approx(SKEW_s, abs=5e-5)
    assert sizes[1] == pytest.approx(COMPLIANCE_rad_Nm, rel=0.15)
    assert rms(rest) < 0.1 * rms(model.residuals([], np.zeros((1, 0)))[0][model.joint_of == 0])


def test_the_offset_between_the_encoders_does_not_count():
    models = (EncoderResiduals(arm(), [second_log(offset_rad=one)]) for one in (0.0, 0.5))
    here, there = (one.residuals([], np.zeros((1, 0))) for one in models)
    assert here == pytest.approx(there, abs=1e-12)


def test_refused_samples_of_the_first_encoder_are_not_compared():
    motion = second_log()
    time_s = motion.joints["shoulder"].position.time_s
    keep = {(motion.name, "shoulder"): (time_s < 1.0) | (time_s > 2.0)}
    model = EncoderResiduals(arm(), [motion], keep)
    here_s = model.time_s[model.joint_of == 0]
    assert here_s.min() < 1.0
    assert here_s.max() > 2.0
    assert not np.any((here_s >= 1.0) & (here_s <= 2.0))
    nothing = {(motion.name, name): np.zeros(time_s.size, bool) for name in motion.joints}
    with pytest.raises(RobotError, match="no sample of a second encoder can be used"):
        EncoderResiduals(arm(), [motion], nothing)


def test_an_encoder_scale_stretches_the_motion():
    model = EncoderResiduals(arm(), [second_log(late_s=0.0, compliance=0.0, scale=0.01)])
    effect = EncoderScale.at(arm(), "shoulder", joint_scales(arm(), [motor_log()]))
    sizes, rest, _ = least_squares(model, [effect], model.joint_of == 0)
    assert sizes[0] == pytest.approx(0.01, rel=1e-6)
    assert rms(rest) < 1e-9


def test_backlash_follows_the_sign_of_the_load():
    model = EncoderResiduals(arm(), [second_log()])
    none, some = model.residuals([Backlash("shoulder", 0, False, 1e-3, 1e-2)], np.array([[0.0], [1e-3]]))
    rows = model.joint_of == 0
    moved = (some - none)[rows]
    load_Nm = model.explain("load")[rows]
    expected = 0.5e-3 * np.sign(load_Nm)
    clear = np.abs(load_Nm) > 0.5
    assert (moved - moved.mean())[clear] == pytest.approx((expected - expected.mean())[clear], abs=5e-5)


def test_the_load_is_the_measured_one_without_friction():
    model = EncoderResiduals(arm(), [second_log()])
    moves = np.abs(model.explain("velocity")) > 0.05  # at rest, dry friction is anything up to its bound
    rows = (model.joint_of == 0) & moves
    load_Nm = model.explain("load")[rows]
    q = model.explain("position")[rows]
    joints = {name: replace(one, torque=None) for name, one in second_log().joints.items()}
    gravity = EncoderResiduals(arm(), [replace(second_log(), joints=joints)]).explain("load")[rows]
    lifted = gravity - SPRING_Nm * np.cos(q)
    assert rms(load_Nm - lifted) < 0.1 * rms(load_Nm - gravity)


def test_candidates_and_parts_keep_their_bits():
    effects = [*effects_at("shoulder"), *effects_at("elbow")]
    sizes = np.array([[0.0, 0.0], [0.002, 0.0], [0.002, 1e-5], [0.0, 3e-5]])
    check_promises(lambda logs: EncoderResiduals(arm(), logs), second_log(), effects, np.tile(sizes, 2))


def test_an_effect_that_no_encoder_shows_changes_nothing():
    friction = CoulombFriction.at(arm(), "shoulder", joint_scales(arm(), [motor_log()]))
    assert not shows(friction)
    none, some = EncoderResiduals(arm(), [second_log()]).residuals([friction], np.array([[0.0], [1.0]]))
    assert np.array_equal(none, some)


def test_compliance_is_refused_where_gravity_does_not_load_the_joint():
    loaded, free = arm(), arm(is_loaded=False)
    delay, compliance = effects_at("shoulder")
    assert why_refused(loaded, compliance) == ""
    assert "gravity does not load it" in why_refused(free, compliance)
    assert why_refused(free, delay) == ""


def test_without_gravity_compliance_is_a_second_order_lag_of_the_encoder():
    """The reason of the refusal: both differ by the acceleration."""
    level = arm(is_loaded=False)
    level.model.opt.gravity[:] = 0.0
    time_s = PERIOD_s * np.arange(1000)
    q = np.sin(2 * time_s)
    elbow = JointLog(Signal(time_s, q), secondary=Signal(time_s, q - 1e-4 * (-4 * q)))
    still = JointLog(Signal(time_s, np.zeros_like(q)))
    model = EncoderResiduals(level, [Motion("m", {"shoulder": still, "elbow": elbow}, {})])
    rows = model.joint_of == 1
    nominal = rms(model.residuals([], np.zeros((1, 0))))
    sizes, rest, _ = least_squares(model, effects_at("elbow", level), rows)
    assert sizes[1] > 0
    assert rms(rest) < 0.1 * nominal


def test_logs_without_a_second_encoder_and_base_parameters_without_a_command_or_a_torque_are_refused():
    with pytest.raises(RobotError, match="no log has a second encoder"):
        EncoderResiduals(arm(), [motor_log()])
    logs = {name: replace(log, command=None, torque=None) for name, log in second_log().joints.items()}
    with pytest.raises(RobotError, match="they show no base parameter"):
        diagnose(arm(), [Motion("m", logs, {})], base_only=True)
