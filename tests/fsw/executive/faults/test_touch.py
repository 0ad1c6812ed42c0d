"""Contact, wanted and not; readings that are wild, no number, frozen, missed or turned."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.dictionary import evrs, faults
from fsw.dictionary.commands import ClearFault, MoveJoints, Preload, Retract, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.faults import CyclesMissed, ReadingImplausible, SensorFrozen
from fsw.motion.move import Phase
from helpers.marks import slow_but
from tests.fsw.executive.faults import lab
from tests.fsw.protect.test_readings import BAD, QUIET, corrupted
from tests.fsw.rig import MARS_R_m_s2, Rig, facing, floats, in_limits, in_the_open, levers_m, made_once
from tests.tools import TOOL_SWITCHES, TOOLS, WITH_SWITCHES

HOLDING_N = lab.CONFIG.params.holding_force_N


@pytest.mark.parametrize("tool", slow_but(WITH_SWITCHES, "apxs", "drill"))
def test_a_guarded_move_ends_at_the_contact_of_its_own_tool(tool):
    for switch in TOOL_SWITCHES[tool]:
        rig = lab.in_guarded_motion(tool)
        rate = np.abs(rig.outputs.drive.setpoint_rate_rad_s).max()
        rig.cycle(**lab.closed(switch))
        assert rate > 0
        (evr,) = lab.found(rig, evrs.ContactMade)
        assert evr.switch == switch
        assert 0 < evr.travel_m < 0.05
        rig.run(**lab.closed(switch))
        assert rig.state.preload.tool == tool
        assert rig.state.preload.force_N == pytest.approx(HOLDING_N[tool])
        assert rig.outputs.joint.planned_backlash_rad == pytest.approx(
            rig.outputs.joint.backlash_rad, abs=1e-5
        )
        assert not rig.outputs.drive.setpoint_rate_rad_s.any()
        assert evrs.CommandCompleted("GuardedMove") in rig.evrs
        assert rig.state.mode is Mode.GUARDED
        assert not lab.found(rig, evrs.FaultResponse)


def test_a_touch_presses_on_while_all_switches_are_open_and_then_has_lost_contact():
    rig = lab.in_guarded_motion("apxs")
    rig.cycle(**lab.closed("apxs_1"))
    rig.run()
    assert lab.found(rig, faults.Fault) == [faults.ContactLost("apxs")]
    assert rig.state.preload.force_N == pytest.approx(lab.BOUNDS.guarded_force_N)
    assert evrs.CommandAborted("GuardedMove") in rig.evrs


@pytest.mark.parametrize("tool", WITH_SWITCHES)
def test_the_switches_of_a_touch_may_open_until_its_end_and_one_of_them_completes_it(tool):
    rig = lab.in_guarded_motion(tool)
    rig.cycle(**lab.closed(TOOL_SWITCHES[tool][0]))
    while rig.state.move.phase is not Phase.SETTLE:
        rig.cycle()
    for _ in range(2 * lab.CONFIG.settle_ticks):
        rig.cycle()
    assert evrs.CommandCompleted("GuardedMove") not in rig.evrs
    rig.run(**lab.closed(TOOL_SWITCHES[tool][-1]))
    assert evrs.CommandCompleted("GuardedMove") in rig.evrs
    assert not lab.found(rig, faults.Fault)


@made_once
def touched():
    """A tool that has touched and pressed."""
    rig = lab.in_guarded_motion("apxs")
    rig.run(**lab.closed("apxs_1"))
    return rig


def test_a_stop_while_a_contact_is_made_firm_keeps_what_it_presses_with():
    rig = lab.in_guarded_motion("apxs")
    for _ in range(150):
        rig.cycle(**lab.closed("apxs_1"))
    rig.run(Stop(), **lab.closed("apxs_1"))
    assert rig.state.mode is Mode.GUARDED
    assert lab.CONFIG.params.motion.switch_force_N <= rig.state.preload.force_N < HOLDING_N["apxs"]


def test_a_guarded_move_that_touches_before_it_moves_presses_no_further_and_can_be_released():
    rig = touched()
    pressing, motor_rad = rig.state.preload, rig.state.joints.motor_rad
    rig.run(rig.touch("apxs", 0.05), **lab.closed("apxs_1"))
    assert rig.state.preload is pressing
    assert rig.state.joints.motor_rad == pytest.approx(
        motor_rad, abs=lab.CONFIG.params.motion.settle_error_rad
    )
    assert evrs.CommandCompleted("Preload") in rig.run(Preload("apxs", 0.0), **lab.closed("apxs_1"))
    assert rig.state.preload.force_N == 0.0


def test_a_touch_that_may_not_press_stays_where_its_switch_closed():
    """Another part of the turret would meet the ground."""
    rig = lab.in_guarded_motion("apxs")
    rig.config, height_m = in_the_open(rig.config), float(rig.tool_pose("apxs").p[2])
    vars(rig.config)["collision_geometry"] = replace(rig.config.collision_geometry, ground_z_m=height_m)
    rig.cycle(**lab.closed("apxs_1"))
    rig.run(**lab.closed("apxs_1"))
    assert evrs.CommandCompleted("GuardedMove") in rig.evrs
    assert rig.state.preload is None


def test_a_fault_by_the_contact_of_another_tool_ends_what_the_first_pressed_with():
    rig = touched()
    rig.run(**lab.closed("drt_1"))
    rig.run(ClearFault(), **lab.closed("drt_1"))
    assert rig.state.tool == "drt"
    assert rig.state.preload is None


def test_the_travel_at_contact_is_how_far_the_tool_went():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    start = rig.tool_pose("apxs").p
    rig.until_moving(rig.touch("apxs", 0.05), cycles=300)
    rig.cycle(**lab.closed("apxs_2"))
    (evr,) = lab.found(rig, evrs.ContactMade)
    went = np.linalg.norm(rig.tool_pose("apxs").p - start)
    assert evr.travel_m == pytest.approx(went, abs=3e-4)


def test_no_contact_to_the_end_of_the_travel_is_a_fault_with_brakes():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.evrs.clear()
    rig.begin(rig.touch("apxs", 0.03))
    while rig.state.mode is Mode.GUARDED:
        rig.cycle()
    (evr,) = lab.found(rig, faults.NoContact)
    assert evr.travel_m == pytest.approx(0.03, abs=1e-6)
    assert lab.REFUSED in rig.evrs
    assert lab.braked(rig)
    rig.run()
    assert evrs.CommandAborted("GuardedMove") in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert not rig.outputs.drive.power_on.any()
    rig.run(ClearFault())
    assert evrs.CommandCompleted("Retract") in rig.run(Retract("apxs", 0.02))


LATEST = 40


def pushed(rig, tool, force_N, cycles, **readings):
    """Resolvers that show a force, and encoders that do not."""
    levers = levers_m(lab.CONFIG.arm, tool, rig.state.joints.output_rad, MARS_R_m_s2)
    wound = force_N * levers / lab.CONFIG.arm.gear_stiffness_Nm_rad
    for _ in range(cycles):
        rig.cycle(resolver_rad=rig.resolver_rad() + wound, **readings)
        if lab.found(rig, faults.Fault):
            break


@pytest.mark.parametrize(("times", "cycles"), [(1.5, LATEST), (10.0, 4)], ids=["some", "large"])
@pytest.mark.parametrize("tool", WITH_SWITCHES)
def test_a_force_on_a_guarded_tool_that_closes_no_switch_stops_the_arm(tool, times, cycles):
    rig = lab.in_guarded_motion(tool)
    pushed(rig, tool, times * lab.BOUNDS.guarded_force_N, cycles)
    (evr,) = lab.found(rig, faults.Fault)
    assert evr == faults.PreloadOutside(tool, 0.0, evr.error_N, evr.bound_N)
    assert evr.error_N > evr.bound_N >= lab.BOUNDS.guarded_force_N
    assert lab.REFUSED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert lab.braked(rig)


CYCLES = 150
JITTER_RAD = 1e-3


def readings(rng, rig, trouble):
    """One cycle of sensors: mostly noise, sometimes a storm, sometimes no number at all."""
    jitter = rng.uniform(-JITTER_RAD, JITTER_RAD, 5) / lab.CONFIG.rad_per_count
    values = {
        "encoder_count": rig.count + np.rint(jitter).astype(int),
        "resolver_rad": rig.resolver_rad() + rng.normal(0, 1e-3, 5),
        "current_A": rng.normal(0, 1.0, 5),
        "winding_C": rng.uniform(-130, 80, 5),
        "switch_closed": rng.random(10) < 0.02 * trouble,
        "gravity_R_m_s2": MARS_R_m_s2 + rng.normal(0, 0.5, 3),
    }
    if rng.random() < 0.05 * trouble:
        name = rng.choice(["resolver_rad", "current_A", "winding_C", "gravity_R_m_s2"])
        values[name][rng.integers(values[name].size)] = rng.choice([np.nan, np.inf])
    if rng.random() < 0.1 * trouble:
        values["current_A"] = rng.uniform(-1e3, 1e3, 5)
    if rng.random() < 0.1 * trouble:
        values["resolver_rad"] = rng.uniform(-7, 7, 5)
    return values


def command(rng, rig):
    kind = rng.integers(6)
    if kind == 0:
        return Stop()
    if kind == 1:
        return ClearFault()
    if kind == 2:
        return Retract(TOOLS[rng.integers(5)], rng.uniform(0, 0.3))
    if kind == 3:
        return rig.touch(TOOLS[rng.integers(5)], rng.uniform(0.001, 0.3))
    if kind == 4:
        return rig.here(TOOLS[rng.integers(5)], rng.uniform(-0.3, 0.3))
    return MoveJoints(floats(in_limits(lab.CONFIG, rng, 1)[:, 0]))


def assert_safe(rig):
    drive, joint = rig.outputs.drive, rig.outputs.joint
    setpoint = drive.setpoint_count * lab.CONFIG.rad_per_count + rig.state.joints.reference.zero_rad
    room = lab.CONFIG.params.monitors.soft_limit_margin_rad + JITTER_RAD
    if drive.power_on.any():
        assert (setpoint >= lab.CONFIG.arm.soft_min_rad - room).all()
        assert (setpoint <= lab.CONFIG.arm.soft_max_rad + room).all()
    assert (np.abs(drive.setpoint_rate_rad_s) <= 1.5 * lab.CONFIG.speed_rad_s).all()
    np.testing.assert_array_equal(drive.current_limit_A, lab.CONFIG.current_limit_A)
    for values in (drive.setpoint_rate_rad_s, joint.motor_rad, joint.motor_rate_rad_s, joint.setpoint_rad):
        assert np.isfinite(values).all()
    assert np.isfinite(joint.backlash_rad).all()
    assert not (drive.brake_release & ~drive.power_on).any()
    if joint.mode is Mode.FAULTED:
        assert not drive.brake_release.any()
        assert not drive.setpoint_rate_rad_s.any()
    if rig.outputs.tool is not None:
        for values in (rig.outputs.tool.p_RoTo_R_m, rig.outputs.tool.R_RT, rig.outputs.tool.load_torque_Nm):
            assert np.isfinite(values).all()
    for evr in rig.outputs.evrs:
        assert isinstance(evr, evrs.Evr)
        told = isinstance(evr, evrs.ReadingNotUsed | ReadingImplausible)
        assert told or "nan" not in evr.message


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 1.0]))
def test_random_sensors_and_commands_never_make_the_arm_unsafe(seed, trouble):
    rng = np.random.default_rng(seed)
    start = facing(lab.CONFIG, "apxs") if rng.random() < 0.5 else in_limits(lab.CONFIG, rng, 1)[:, 0]
    rig = Rig(lab.CONFIG, Mode(rng.integers(2)), start)
    for _ in range(CYCLES):
        commands = (command(rng, rig),) if rng.random() < 0.06 else ()
        rig.cycle(*commands, **readings(rng, rig, trouble))
        assert_safe(rig)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_a_stuck_or_slipping_arm_never_makes_its_set_points_run_away(seed):
    rng = np.random.default_rng(seed)
    rig = Rig(lab.CONFIG, start_rad=in_limits(lab.CONFIG, rng, 1, shrink=0.2)[:, 0])
    rig.stuck = True
    rig.cycle(MoveJoints(floats(in_limits(lab.CONFIG, rng, 1)[:, 0])))
    for _ in range(CYCLES):
        rig.count = rig.count + rng.integers(-30, 31, 5)
        rig.cycle()
        assert_safe(rig)


def test_one_wild_encoder_reading_does_not_become_a_set_point_under_power():
    rig = Rig(lab.CONFIG)
    rig.until_moving(MoveJoints(floats(np.array(lab.CONFIG.params.poses.ready_rad) + 0.05)))
    before = rig.outputs.drive.setpoint_count
    drive = rig.cycle(encoder_count=rig.count + 10**7).drive
    assert drive.power_on.all()
    # no farther than a motor may follow
    bound = np.ceil(lab.CONFIG.params.monitors.following_error_rad / lab.CONFIG.rad_per_count)
    assert (np.abs(drive.setpoint_count - before) <= bound).all()


MOVES = {
    "joints": lambda rig: MoveJoints(floats(lab.START + 0.05)),
    "guarded": lambda rig: rig.touch("apxs", 0.1),
    "retract": lambda rig: Retract("apxs", 0.1),
}


@made_once
def on_its_way(kind):
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.until_moving(MOVES[kind](rig))
    return rig


PERSISTENCE = lab.BOUNDS.reading_persistence


@pytest.mark.parametrize("kind", MOVES)
@pytest.mark.parametrize("value", BAD)
def test_with_a_bad_reading_a_move_goes_on_for_its_persistence_then_stands_and_is_refused_until_cleared(
    kind, value
):
    rig, twin = on_its_way(kind), on_its_way(kind)
    name = rig.state.move.plan.command
    mode, bad = rig.state.mode, corrupted("current_A", 2, value)
    for cycle in range(1, PERSISTENCE):
        out, undisturbed = rig.cycle(**bad), twin.cycle()
        assert [type(evr) for evr in out.evrs] == [evrs.ReadingNotUsed] * (cycle == 1)
        np.testing.assert_array_equal(out.drive.setpoint_count, undisturbed.drive.setpoint_count)
    follow = rig.outputs.drive.setpoint_count
    out = rig.cycle(**bad)
    assert isinstance(out.evrs[0], ReadingImplausible)
    assert out.evrs[0].sensor == "current_A[2]"
    assert out.evrs[1:] == (lab.REFUSED, evrs.ModeChanged(mode, Mode.FAULTED))
    # held where the motors were last seen: no farther than the cycle just passed
    held, step = out.drive.setpoint_count, np.ceil(lab.CONFIG.speed_rad_s / 64 / lab.CONFIG.rad_per_count)
    assert (np.abs(held - follow) <= step).all()
    for k in range(60):
        out = rig.cycle(**(corrupted("winding_C", k % 5, value) if k % 3 == 0 else {}))
        np.testing.assert_array_equal(out.drive.setpoint_count, held)
        assert not out.drive.setpoint_rate_rad_s.any()
        assert not out.drive.brake_release.any()
        assert np.isfinite([out.drive.setpoint_rate_rad_s, out.drive.current_limit_A]).all()
    assert not out.drive.power_on.any()
    assert rig.state.mode is Mode.FAULTED
    assert evrs.CommandAborted(name) in rig.evrs
    rig.evrs.clear()
    rig.cycle(MoveJoints(floats(lab.START)))
    assert rig.evrs == [evrs.CommandRefused("MoveJoints", "a fault stands; clear it first")]
    rig.cycle(ClearFault())
    assert rig.state.mode is (Mode.DEPLOYED if kind == "joints" else Mode.GUARDED)


@pytest.mark.parametrize("reads_m_s2", [-3.711, 0.0, 25.0, 1e300])
@pytest.mark.parametrize("kind", MOVES)
def test_an_implausible_gravity_is_not_learnt_and_stops_the_arm_if_it_lasts(kind, reads_m_s2):
    rig = on_its_way(kind)
    before = rig.state.joints.gravity_R_m_s2
    for _ in range(PERSISTENCE):
        assert rig.outputs.drive.brake_release.all()
        out = rig.cycle(gravity_R_m_s2=[0.0, 0.0, reads_m_s2])
    assert isinstance(out.evrs[0], ReadingImplausible)
    assert not out.drive.brake_release.any()
    assert not out.drive.setpoint_rate_rad_s.any()
    np.testing.assert_allclose(rig.state.joints.gravity_R_m_s2, before, atol=1e-11)


@pytest.mark.parametrize("count", [1000, -(10**17)])
def test_an_encoder_that_jumped_and_stays_is_cleared_where_its_motor_was_and_must_be_calibrated_again(count):
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.cycle()
    before = rig.state.joints.motor_rad
    jumped = rig.count + count * (np.arange(5) == 2)
    for _ in range(PERSISTENCE):
        rig.cycle(encoder_count=jumped)
    assert [evr.sensor for evr in lab.found(rig, ReadingImplausible)] == ["encoder_count[2]"]
    rig.cycle(ClearFault(), encoder_count=jumped)
    rig.cycle(encoder_count=jumped)
    if count == 1000:
        assert rig.state.mode is Mode.DEPLOYED
        np.testing.assert_allclose(rig.state.joints.motor_rad, before, atol=1e-9)
        np.testing.assert_array_equal(rig.state.joints.reference.calibrated, np.arange(5) != 2)
    else:
        assert rig.evrs[-1] == evrs.CommandRefused("ClearFault", "out of range: encoder_count")
        assert rig.state.mode is Mode.FAULTED


@pytest.mark.parametrize("name", QUIET)
def test_with_bad_readings_nothing_is_known_until_the_first_good_ones(name):
    rig = Rig(lab.CONFIG, start_rad=lab.START, calibrated=False)
    for _ in range(3):
        rig.cycle(**corrupted(name, 0, BAD[0]))
        assert not rig.state.joints.initialised
    rig.cycle()
    np.testing.assert_allclose(rig.state.joints.motor_rad, lab.START, atol=1e-5)


LIVELY = ("resolver_rad", "current_A", "gravity_R_m_s2")


def test_all_frozen_sensors_are_named_once_each_and_are_not_cleared():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    frozen = {"resolver_rad": rig.resolver_rad(), "current_A": np.ones(5), "gravity_R_m_s2": MARS_R_m_s2}
    for _ in range(2 * lab.BOUNDS.frozen_persistence):
        rig.cycle(**frozen)
    assert [evr.sensor for evr in lab.found(rig, SensorFrozen)] == list(LIVELY)
    rig.evrs.clear()
    rig.cycle(ClearFault(), **frozen)
    (refused,) = rig.evrs
    assert refused.reason.startswith("a fault was found in the same cycle: resolver_rad reads the same")
    assert rig.state.mode is Mode.FAULTED


def test_cycles_missed_at_rest_are_reported_and_stop_nothing():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.evrs.clear()
    lab.skip(rig, 20)
    told, *responded = rig.evrs
    assert isinstance(told, evrs.ReadingNotUsed)
    assert responded == [CyclesMissed(20, lab.BOUNDS.missed_cycles), lab.STOPPED]
    assert rig.state.mode is Mode.DEPLOYED
