"""A command arrives with plain values of its types and within its limits, or is refused with a sentence."""

from dataclasses import fields, replace
from decimal import Decimal
from typing import get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.dictionary.arguments import Wrong, read_arguments
from fsw.dictionary.commands import (
    Command,
    MoveJoint,
    MoveJoints,
    MoveTool,
    Preload,
    Process,
    Retract,
    SetParam,
    SetTilt,
    Stop,
)
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Limits
from fsw.executive.context import known_names
from fsw.state import Hold
from sim.arms import nominal_params

NAMES = known_names(nominal_params())
TOOL_MOVE = MoveTool("apxs", (2.0, 0.0, 0.8), (0.0, 0.0, 1.0))
COMMAND_FIELDS = [
    (kind, field.name, get_type_hints(kind, include_extras=True)[field.name])
    for kind in get_args(Command)
    for field in fields(kind)
]


def problem(command) -> str:
    read = read_arguments(command, NAMES)
    assert isinstance(read, Wrong)
    return read.text


def limits_in(hint) -> list[Limits]:
    return [mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Limits)]


@pytest.mark.parametrize(
    ("kind", "name", "hint"),
    COMMAND_FIELDS,
    ids=[f"{kind.__name__}.{name}" for kind, name, _ in COMMAND_FIELDS],
)
def test_every_number_of_a_command_has_limits(kind, name, hint):
    bare = getattr(hint, "__origin__", hint) if limits_in(hint) else hint
    is_number = bare in (int, float) or get_origin(bare) is tuple
    assert len(limits_in(hint)) == is_number


def limits_of_params(kind: type) -> list[Limits]:
    found = []
    for hint in get_type_hints(kind, include_extras=True).values():
        found += limits_in(hint)
        if hasattr(hint, "__dataclass_fields__"):
            found += limits_of_params(hint)
    return found


def test_every_value_that_a_parameter_may_have_can_be_commanded():
    (bound,) = limits_in(get_type_hints(SetParam, include_extras=True)["value"])
    assert all(bound.low <= one.low and one.high <= bound.high for one in limits_of_params(Params))


@pytest.mark.parametrize(
    "angle", [1, np.int64(1), np.uint8(1), np.float32(1.0), np.float64(1.0), np.longdouble(1.0)]
)
def test_a_number_may_be_whole_or_of_numpy_and_arrives_as_a_float(angle):
    read = read_arguments(MoveJoint(Joint.ELBOW, angle), NAMES)
    assert read == MoveJoint(Joint.ELBOW, 1.0)
    assert type(read.angle_rad) is float


@pytest.mark.parametrize("kind", [tuple, list, np.array])
def test_a_vector_may_be_any_sequence_and_arrives_as_a_tuple_of_floats(kind):
    read = read_arguments(MoveJoints(kind([0, 1, 2, 3, 4])), NAMES)
    assert read == MoveJoints((0.0, 1.0, 2.0, 3.0, 4.0))
    assert [type(one) for one in read.angle_rad] == [float] * 5


@pytest.mark.parametrize(("field", "name"), [("tool", "MAHLI"), ("frame", "Rover"), ("branch", "AUTO")])
def test_a_name_may_have_any_case(field, name):
    read = read_arguments(replace(TOOL_MOVE, **{field: name}), NAMES)
    assert getattr(read, field) == name.lower()


@pytest.mark.parametrize("joint", [np.int8(2), "elbow", "ELBOW"])
def test_a_joint_may_be_given_by_its_number_or_its_name_in_any_case(joint):
    assert read_arguments(MoveJoint(joint, 0.0), NAMES) == MoveJoint(Joint.ELBOW, 0.0)


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (3e306, "3e+306 is outside -7 .. 7"),
        (-1e306, "-1e+306 is outside -7 .. 7"),
        (7.000000000000001, "7.000000000000001 is outside -7 .. 7"),
        (10**400, "inf is outside -7 .. 7"),
        (np.longdouble("-1e4000"), "-inf is outside -7 .. 7"),
        (float("nan"), "nan is outside -7 .. 7"),
        (True, "True is not a number"),
        (np.bool_(True), "a value of type bool is not a number"),
        (None, "None is not a number"),
        ("1.0", "'1.0' is not a number"),
        ("9" * 400, f"'{'9' * 40}...' is not a number"),
        (1j, "a value of type complex is not a number"),
        (Decimal(1), "a value of type Decimal is not a number"),
        (np.array(1.0), "a value of type ndarray is not a number"),
    ],
    ids=str,
)
def test_what_is_no_angle_is_refused_in_a_few_characters(value, sentence):
    assert problem(MoveJoint(Joint.ELBOW, value)) == f"angle_rad: {sentence}"


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (MoveJoints((0.0, 1.0)), "angle_rad: has 2 numbers; must have 5"),
        (MoveJoints((0.0,) * 6), "angle_rad: has 6 numbers; must have 5"),
        (MoveJoints((0.0, 0.0, 1e306, 0.0, 0.0)), "angle_rad: number 3: 1e+306 is outside -7 .. 7"),
        (MoveJoints((0.0, 0.0, "1", 0.0, 0.0)), "angle_rad: number 3: '1' is not a number"),
        (MoveJoints(1.0), "angle_rad: 1.0 is not a sequence of 5 numbers"),
        (MoveJoints(np.zeros((5, 1))), "angle_rad: a value of type ndarray is not a sequence of 5 numbers"),
        (MoveTool("apxs", (2.0, 0.0), (0.0, 0.0, 1.0)), "p_FoTo_F_m: has 2 numbers; must have 3"),
        (replace(TOOL_MOVE, approach_F=(0.0, 1e-10, 0.0)), "approach_F: has no length; its greatest"),
        (replace(TOOL_MOVE, straight=1), "straight: 1 is not True or False"),
        (replace(TOOL_MOVE, deflection="some"), "deflection: 'some' is not known; there are off, absolute"),
        (Preload("apxs", -1.0), "force_N: -1.0 is outside 0 .. 1000"),
        (Process("portion", (1.0, 0.0, 0.0), 3601.0), "duration_s: 3601.0 is outside 0 .. 3600"),
        (SetTilt(0.0, 1.7), "pitch_rad: 1.7 is outside -1.6 .. 1.6"),
        (SetParam("a\nb", 1.0), "name: 'a\\nb' is not printable text"),
        (SetParam("\ud800", 1.0), "name: '\\ud800' is not printable text"),
        (SetParam("", 1.0), "name: is empty; a name is right"),
        (SetParam("x" * 101, 1.0), f"name: '{'x' * 40}...' has 101 characters; at most 100 are allowed"),
        (Hold(1.0, vibrate=True), "is no command; there are Calibrate, CalibrateAll, "),
        (Stop, "is no command; there are "),
        (None, "is no command; there are "),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_told_with_what_would_be_right(command, sentence):
    assert problem(command).startswith(sentence)


def test_a_duration_of_numpy_is_no_number():
    for value in (np.timedelta64(1, "s"), np.timedelta64("NaT"), np.timedelta64(1)):
        assert isinstance(read_arguments(MoveJoint(Joint.ELBOW, value), NAMES), Wrong)
        assert isinstance(read_arguments(MoveJoint(value, 1.0), NAMES), Wrong)


def test_an_object_whose_class_has_no_hash_is_no_command():
    class NoHash(type):
        def __eq__(cls, other):
            return cls is other

        __hash__ = None

    assert isinstance(read_arguments(NoHash("Odd", (), {})(), NAMES), Wrong)


def test_a_command_that_was_never_filled_is_refused():
    assert problem(object.__new__(Retract)) == "tool: is missing"


anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.complex_numbers()
    | st.text(st.characters(codec=None))
    | st.binary()
    | st.sampled_from(("DRILL", "drill", "on", "auto")),
    lambda inner: st.lists(inner, max_size=6) | st.lists(inner, max_size=6).map(tuple),
    max_leaves=8,
)


@given(
    st.sampled_from(get_args(Command)).flatmap(lambda kind: st.builds(kind, *[anything] * len(fields(kind))))
)
def test_any_values_at_all_make_a_command_within_its_limits_or_a_short_sentence(command):
    read = read_arguments(command, NAMES)
    if isinstance(read, Wrong):
        assert len(read.text) < 400
        assert read.text.isprintable()
    else:
        assert read_arguments(read, NAMES) == read
