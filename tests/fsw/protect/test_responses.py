"""What is done about each fault, by the table, in the documents, and of several at once."""

import re
from dataclasses import fields

import numpy as np
import pytest

from fsw.dictionary import faults
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, ContactMade, FaultResponse
from fsw.dictionary.motion_params import MonitorParams
from fsw.protect.responses import RESPONSE_TO, Response, StandingFault, decide, identify, response_to
from tests.fsw.protect.lab import BOUNDS, CONFIG, MONITORS, READY, at, rows

FAULTS = {
    kind for kind in vars(faults).values() if isinstance(kind, type) and issubclass(kind, faults.Fault)
} - {faults.Fault}


def test_every_fault_has_a_response_and_every_response_is_used():
    assert set(RESPONSE_TO) == FAULTS
    assert set(RESPONSE_TO.values()) == set(Response)


def test_the_page_says_of_every_fault_what_is_done_about_it():
    assert {(name, response) for name, *_, response in rows("Monitors")} == {
        (kind.__name__, response.value) for kind, response in RESPONSE_TO.items()
    }
    assert {name for name, *_ in rows("Responses")} == {response.value for response in Response}


def test_the_page_names_every_parameter_of_the_monitors_and_no_other():
    names = set(re.findall(r"`([a-zA-Z0-9_.]+)`", str(rows("Monitors"))))
    groups = [(group, fields(getattr(CONFIG.params, group))) for group in ("motion", "hardstop", "preload")]
    others = {f"{group}.{field.name}" for group, its_fields in groups for field in its_fields}
    assert {name for name in names if "." not in name} == {field.name for field in fields(MonitorParams)}
    assert {name for name in names if "." in name} <= others


@pytest.mark.parametrize("mode", Mode)
def test_an_arm_may_touch_where_it_was_to_touch_and_where_it_did(mode):
    to_touch = mode in (Mode.GUARDED, Mode.RETRACTING, Mode.PRELOAD)
    other = identify(faults.OverCurrent(Joint.WRIST, 3.0, 2.0))
    assert StandingFault(mode, frozenset()).may_touch is to_touch
    assert StandingFault(mode, frozenset({other})).may_touch is to_touch
    for contact in (faults.ContactInFreeSpace("drt_1"), faults.UnexpectedContact(Joint.ELBOW, 63.4, 52.4)):
        assert StandingFault(mode, frozenset({other, identify(contact)})).may_touch


def test_two_events_are_the_same_news_if_they_are_of_one_class_and_about_the_same():
    assert identify(faults.OverCurrent(Joint.WRIST, 3.0, 2.0)) == (faults.OverCurrent, Joint.WRIST)
    frozen = faults.SensorFrozen("current_A", 64)
    assert identify(frozen) == (faults.SensorFrozen, "current_A")
    assert identify(faults.ContactInFreeSpace("drt_1")) == (faults.ContactInFreeSpace, "drt_1")
    assert identify(faults.NoContact(0.1)) == identify(faults.NoContact(0.2)) == (faults.NoContact, None)


def test_of_several_faults_the_severest_response_counts_in_whatever_order_they_come():
    stop, brake = faults.CyclesMissed(9, 4), faults.NoContact(0.1)
    off = faults.OverCurrent(Joint.ELBOW, 5.0, 4.75)
    for several, response in (
        ((stop, brake), Response.BRAKE_AND_REFUSE),
        ((brake, off), Response.POWER_OFF),
        ((stop, off), Response.POWER_OFF),
        ((stop, brake, off), Response.POWER_OFF),
        ((stop, stop), Response.STOP_AND_BRAKE),
    ):
        assert response_to(several) is response
        assert response_to(several[::-1]) is response


BRAKING = {
    faults.NoContact(0.1): Response.BRAKE_AND_REFUSE,
    faults.OverCurrent(Joint.ELBOW, 5.0, 4.75): Response.POWER_OFF,
}


def decision(*found, mode=Mode.FREE_SPACE, fault=None, motor_rad=READY):
    return decide(BOUNDS, mode, fault, found, motor_rad, READY)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("trouble", BRAKING, ids=lambda evr: evr.name)
def test_only_a_fault_has_a_response_and_one_that_brakes_stands_in_the_mode_in_which_it_happened(
    trouble, mode
):
    found = (trouble, CommandAborted("MoveJoints"))
    done = decision(*found, mode=mode)
    assert done.response is BRAKING[trouble]
    assert done.fault == StandingFault(mode, frozenset({identify(trouble), (CommandAborted, None)}))
    assert done.evrs == (*found, FaultResponse(BRAKING[trouble].value))
    quiet = CommandCompleted("Stop"), ContactMade("apxs_1", 0.1), CommandAborted("Stop")
    assert response_to(quiet) is response_to(()) is None
    assert response_to((*quiet, trouble)) is BRAKING[trouble]
    done = decision(*quiet, mode=mode)
    assert (done.response, done.fault, done.evrs) == (None, None, quiet)


def test_a_fault_that_only_stops_does_not_stand():
    lost = faults.ContactLost("drill")
    done = decision(lost)
    assert (done.response, done.fault) == (Response.STOP_AND_BRAKE, None)
    assert done.evrs == (lost, FaultResponse("STOP_AND_BRAKE"))


def test_a_standing_fault_is_not_answered_again_but_what_is_new_is_reported_once():
    drew, other = faults.OverCurrent(Joint.WRIST, 3.0, 2.85), faults.OverCurrent(Joint.ELBOW, 5.0, 4.75)
    fault = decision(faults.NoContact(0.1)).fault
    again = decision(faults.NoContact(0.2), mode=Mode.FAULTED, fault=fault)
    assert (again.response, again.fault, again.evrs) == (None, fault, ())
    more = decision(faults.NoContact(0.2), drew, mode=Mode.FAULTED, fault=fault)
    assert (more.response, more.evrs) == (None, (drew,))
    assert more.fault == StandingFault(Mode.FREE_SPACE, fault.reported | {(faults.OverCurrent, Joint.WRIST)})
    assert decision(drew, fault=more.fault).evrs == ()
    assert decision(drew, other, fault=more.fault).evrs == (other,)


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("off_rad", [-0.3, -0.0025, 0.0, 0.0015, 5.0])
@pytest.mark.parametrize("fault", [None, StandingFault(Mode.GUARDED, frozenset())], ids=["new", "standing"])
def test_motors_are_held_where_they_read_but_no_farther_from_the_set_point_than_they_may_follow(
    joint, off_rad, fault
):
    bound = MONITORS.following_error_rad
    for trouble in (faults.NoContact(0.1), faults.ContactLost("drill"), CommandCompleted("Stop")):
        done = decision(trouble, fault=fault, motor_rad=READY + at(joint, off_rad))
        np.testing.assert_allclose(
            done.hold_rad - READY, at(joint, np.clip(off_rad, -bound, bound)), atol=1e-15
        )
