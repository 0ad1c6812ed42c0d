"""Residuals of inverse dynamics on an arm whose truth is simulated, and on the KR300."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.real_robots import load_real
from helpers.two_joint_arm import arm, check_promises, rms, simulated
from simgap.catalogue.catalogue import catalogue
from simgap.common.errors import RobotError
from simgap.effects.command import EncoderScale, JointZero
from simgap.effects.effect import joint_scales
from simgap.effects.forces import CoulombFriction, PositionTorque, StribeckFriction, ViscousFriction
from simgap.effects.inertia import Armature, LinkMass
from simgap.effects.transmission import JointCompliance
from simgap.logs import JointLog, Motion, Signal
from simgap.residuals.inverse_residuals import InverseResiduals, MEMORY_rad, shows

FRICTION = (CoulombFriction, ViscousFriction)


def counterbalance_Nm(q):
    return np.array((6.0 * np.cos(q[0]) - 9.0 * np.sin(q[0]), 0.0))


def heavier(model):
    model.body_mass[2] += 1.0
    model.body_inertia[2] *= 1.5  # the same density


@cache
def log(kind="nominal"):
    others = {"counterbalance": {"applied_Nm": counterbalance_Nm}, "heavier": {"change": heavier}}
    others["noisy"] = {"noise_rad": 1e-4}
    return simulated(arm(), seed=3, name=kind, **others.get(kind, {}))


def residuals_of(*motions):
    return InverseResiduals(arm(), motions)


def at(joint, *kinds):
    robot = arm()
    return [kind.at(robot, joint, joint_scales(robot, [log()])) for kind in kinds]


def of_joint(model, values, joint):
    return values[..., model.joint_of == model.joints.index(joint)]


def test_torques_near_refused_samples_take_no_part():
    clean, joint = log(), "elbow"
    one = clean.joints[joint]
    time_s = one.position.time_s
    is_pushed = (time_s > 2.0) & (time_s < 3.0)
    pushed = Signal(one.torque.time_s, one.torque.value + 50.0 * is_pushed)
    contact = replace(clean, joints={**clean.joints, joint: replace(one, torque=pushed)})
    whole, nothing = residuals_of(clean), np.zeros((1, 0))
    part = InverseResiduals(arm(), [contact], {(clean.name, joint): ~is_pushed})
    margin_s = 1.0 / whole.low_pass.cut_off_Hz
    first_s, last_s = time_s[is_pushed][[0, -1]]
    is_near = (whole.time_s > first_s - margin_s) & (whole.time_s < last_s + margin_s)
    kept = (whole.joint_of != whole.joints.index(joint)) | ~is_near
    assert 0 < np.sum(~kept) < np.sum(kept)
    assert part.time_s == pytest.approx(whole.time_s[kept])
    assert part.residuals([], nothing) == pytest.approx(whole.residuals([], nothing)[:, kept], abs=0.5)
    assert part.explain("load").shape == part.time_s.shape
    assert part.select([clean.name]).time_s == pytest.approx(part.time_s)


def test_a_joint_counts_once_its_friction_has_forgotten_what_was_before_the_log():
    clean, resting = log(), "elbow"
    model, one = residuals_of(clean), clean.joints["shoulder"].position
    moved = np.abs(one.value - one.value[0]) > MEMORY_rad
    begin_s = model.time_s[model.joint_of == 0][0]
    assert begin_s == pytest.approx(one.time_s[np.argmax(moved)], abs=0.02)
    still = replace(clean.joints[resting].position, value=np.full(one.value.size, 0.3))
    joints = {**clean.joints, resting: replace(clean.joints[resting], position=still)}
    first_s = residuals_of(replace(clean, joints=joints)).time_s[-1] - model.time_s[-1]
    assert first_s == pytest.approx(0.0)  # a joint that never moves counts as a whole
    assert "remembers what was before the log" in model.method


def moving(model, joint):
    """Return the rows of a joint while it moves: at rest, dry friction is anything up to its bound."""
    return (model.joint_of == model.joints.index(joint)) & (np.abs(model.explain("velocity")) > 0.05)


def least_squares(model, effects, rows, free=slice(None)):
    """Fit sizes that act in proportion, with the residuals of some rows; return sizes, (n_sizes,)."""
    n = sum(len(effect.sizes) for effect in effects)
    points = np.vstack((np.zeros(n), np.eye(n)))
    found = model.residuals(effects, points)[:, rows]
    columns = (found[:1] - found[1:])[free].T
    sizes = np.zeros(n)
    sizes[free] = np.linalg.lstsq(columns, found[0])[0]
    return sizes


def test_a_true_model_leaves_hundredths_of_the_torque():
    model = residuals_of(log())
    (residual,) = model.residuals([], np.zeros((1, 0)))
    for joint in model.joints:
        assert rms(residual[moving(model, joint)]) < 0.03 * np.std(log().joints[joint].torque.value)


def test_friction_that_the_model_lacks_comes_back():
    less = arm()
    less.model.dof_frictionloss[0], less.model.dof_damping[0] = 1.0, 0.5
    model = InverseResiduals(less, [log()])
    coulomb, viscous = least_squares(model, at("shoulder", *FRICTION), moving(model, "shoulder"))
    assert coulomb == pytest.approx(2.0, rel=0.05)
    assert viscous == pytest.approx(1.5, rel=0.1)


def test_a_counterbalance_comes_back_beside_friction():
    model = residuals_of(log("counterbalance"))
    effects = at("shoulder", PositionTorque, *FRICTION)
    sizes = least_squares(model, effects, moving(model, "shoulder"), free=[0, 1, 2, 3])
    assert sizes[:2] == pytest.approx((6.0, -9.0), rel=0.05)


def test_a_heavier_link_needs_more_torque_at_all_joints():
    model = residuals_of(log("heavier"))
    nominal, true = model.residuals([LinkMass("elbow", 2.0)], np.array([[0.0], [1.0]]))
    for joint in model.joints:
        rows = moving(model, joint)
        assert rms(true[rows]) < 0.1 * rms(nominal[rows])


def test_an_armature_is_its_inertia_times_the_acceleration():
    model = residuals_of(log())
    nominal, more = model.residuals(at("elbow", Armature), np.array([[0.0], [1.0]]))
    assert of_joint(model, more, "shoulder") == pytest.approx(of_joint(model, nominal, "shoulder"))
    torque = of_joint(model, nominal - more, "elbow")
    speed = of_joint(model, model.explain("velocity"), "elbow")
    times = model.time_s[model.joint_of == 1]
    middle = slice(50, -50)
    assert torque[middle] == pytest.approx(np.gradient(speed, times)[middle], abs=0.05 * np.max(torque))


def test_an_encoder_with_a_false_zero_is_read_at_its_true_angle():
    truth = log()
    shifted = {}
    for name, one in truth.joints.items():
        false_rad = 0.1 if name == "elbow" else 0.0
        shifted[name] = replace(one, position=Signal(one.position.time_s, one.position.value + false_rad))
    effects = at("elbow", JointZero)
    model = residuals_of(Motion("m", shifted, {}))
    found = model.residuals(effects, np.array([[0.0], [0.1]]))
    (expected,) = residuals_of(truth).residuals([], np.zeros((1, 0)))
    assert found[1] == pytest.approx(expected, abs=1e-6)
    rows = moving(model, "shoulder")  # the forearm hangs elsewhere than it shows
    assert rms(found[0][rows]) > 3 * rms(expected[rows])


def test_candidates_and_parts_keep_their_bits():
    kinds = (*FRICTION, PositionTorque, StribeckFriction, EncoderScale, JointZero)
    effects = [*at("shoulder", *kinds), LinkMass("elbow", 2.0)]
    n_sizes = sum(len(effect.sizes) for effect in effects)
    sizes = np.random.default_rng(5).uniform(-0.05, 0.05, (4, n_sizes))
    sizes[2] = 0.0
    check_promises(lambda logs: residuals_of(*logs), log(), effects, sizes)


def test_what_torques_cannot_show_changes_nothing():
    gear = JointCompliance("elbow", 1, False, 1e-3, 1e-2)
    assert not shows(gear)
    model = residuals_of(log())
    none, some = model.residuals([gear], np.array([[0.0], [1e-3]]))
    assert np.array_equal(none, some)


def test_noise_lowers_the_cut_off_and_widens_the_reversal():
    clean, noisy = residuals_of(log()).low_pass, residuals_of(log("noisy")).low_pass
    assert clean.cut_off_Hz == pytest.approx(25.0)  # a tenth of the sample rate
    assert noisy.cut_off_Hz < 0.5 * clean.cut_off_Hz
    assert np.all(noisy.friction_speed_rad_s > 10 * clean.friction_speed_rad_s)


def test_variables_are_those_of_the_measured_motion():
    model = residuals_of(log())
    measured = log().joints["elbow"].position
    at_rows = np.interp(model.time_s[model.joint_of == 1], measured.time_s, measured.value)
    assert of_joint(model, model.explain("position"), "elbow") == pytest.approx(at_rows, abs=1e-4)
    assert np.array_equal(model.explain("time"), model.time_s)
    assert np.all(np.isnan(model.explain("temperature")))
    starts = {name: one.position.value[0] for name, one in log().joints.items()}
    resting = {name: replace(measured, value=np.full(measured.value.size, q)) for name, q in starts.items()}
    joints = {name: replace(one, position=resting[name]) for name, one in log().joints.items()}
    model = residuals_of(replace(log(), joints=joints))
    angle = sum(starts.values())
    carried_Nm = -9.81 * 2.0 * (0.15 * np.cos(angle) + 0.02 * np.sin(angle))  # at rest; axes point along +y
    assert of_joint(model, model.explain("load"), "elbow")[0] == pytest.approx(carried_Nm, rel=0.02)


def test_logs_without_torques_and_logs_that_are_shorter_than_the_filter_are_refused():
    one = log().joints["elbow"]
    with pytest.raises(RobotError, match="no log has torques"):
        residuals_of(Motion("m", {"elbow": JointLog(one.position)}, {}))
    position, torque = (Signal(each.time_s[:9], each.value[:9]) for each in (one.position, one.torque))
    with pytest.raises(RobotError, match="20 or more"):
        residuals_of(Motion("m", dict.fromkeys(log().joints, JointLog(position, torque=torque)), {}))


@cache
def kr300(folder):
    robot, logs = load_real(folder, "kr300")
    effects = {effect.key: effect for effect in catalogue(robot, logs)}
    shared = {"a2": joint_scales(robot, logs.motions)["a2"]}
    base = [kind.at(robot, "a2", shared) for kind in FRICTION]
    return robot, InverseResiduals(robot, logs.motions), base, effects


def axis_2_errors_Nm(folder, fitted, names, free):
    """Return the error of axis 2 on both batches after a robust fit to one, in N m of the motor."""
    robot, model, base, effects = kr300(folder)
    union = [*base, *(effects[f"a2: {name}"] for name in names)]
    rows = (model.joint_of == 1) & (model.motion_of == fitted)
    n = sum(len(effect.sizes) for effect in union)
    found = model.residuals(union, np.vstack((np.zeros(n), np.eye(n))))
    columns = (found[:1] - found[1:])[free].T
    size, weight = np.zeros(len(free)), np.ones(np.sum(rows))
    for _ in range(20):  # a loss of Cauchy: torques at rest are anything up to the dry friction
        size = np.linalg.lstsq(columns[rows] * weight[:, None], found[0][rows] * weight)[0]
        rest = found[0][rows] - columns[rows] @ size
        scale = 1.4826 * np.median(np.abs(rest))
        weight = 1 / np.sqrt(1 + (rest / scale) ** 2)
    rest = (found[0] - columns @ size) / robot.joint("a2").gear_ratio
    return [rms(rest[(model.joint_of == 1) & (model.motion_of == batch)]) for batch in (0, 1)]


@pytest.mark.real_data
def test_friction_alone_leaves_4_newton_metres_at_axis_2_of_the_kr300(real_data):
    assert axis_2_errors_Nm(real_data, 0, [], [0, 1])[1] == pytest.approx(4.26, abs=0.15)
    assert axis_2_errors_Nm(real_data, 1, [], [0, 1])[0] == pytest.approx(8.93, abs=0.2)


@pytest.mark.real_data
@pytest.mark.parametrize("fitted", [0, 1])
def test_a_counterbalance_of_the_first_order_predicts_the_other_batch(real_data, fitted):
    errors = axis_2_errors_Nm(real_data, fitted, ["position-dependent torque"], [0, 1, 2, 3])
    assert errors[1 - fitted] < 0.8
