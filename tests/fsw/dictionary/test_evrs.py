"""Every event describes itself in one sentence; every event and every command has a test."""

import ast
import typing
from dataclasses import fields
from functools import cache
from pathlib import Path

import pytest

from fsw.dictionary import commands, evrs, faults
from fsw.dictionary.enums import Joint, Mode

EVRS = [
    kind
    for kind in (vars(evrs) | vars(faults)).values()
    if isinstance(kind, type) and issubclass(kind, evrs.Evr) and kind not in (evrs.Evr, faults.Fault)
]
COMMANDS = typing.get_args(commands.Command)
TESTS = Path(__file__).parents[1]
ELSEWHERE = {evrs.SoftwareError}
"""Events of the loop around flight software, which is tested there."""


def test_a_contact_without_a_lever_tells_its_torque_only():
    contact = faults.UnexpectedContact(Joint.ELBOW, 63.4, 52.4)
    assert contact.message == "unexpected contact: ELBOW resists with 63 N m, about 52 N at the tool"
    contact = faults.UnexpectedContact(Joint.ELBOW, 63.4, 0.0)
    assert contact.message == "unexpected contact: ELBOW resists with 63 N m"


@pytest.mark.parametrize("kind", EVRS)
def test_the_message_of_every_event_can_be_formatted(kind):
    of_type = {Joint: Joint.ELBOW, Mode: Mode.STOWED, str: "word", float: 0.5, int: 3, bool: True}
    types = typing.get_type_hints(kind)
    assert kind(*(of_type[types[field.name]] for field in fields(kind))).message


@pytest.mark.parametrize("kind", EVRS)
def test_every_event_has_a_severity_and_names_only_its_own_fields(kind):
    assert isinstance(kind.severity, evrs.Severity)
    named = {part.split(".")[1] for part in kind.text.replace("}", "{").split("{")[1::2]}
    named = {name.split(":")[0] for name in named}
    assert named == {field.name for field in fields(kind)}


@cache
def used() -> set[str]:
    """Collect the names in the code of the other tests, without imports, comments and strings."""
    trees = [ast.parse(path.read_text()) for path in TESTS.rglob("*.py") if path != Path(__file__)]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return names | {node.attr for node in nodes if isinstance(node, ast.Attribute)}


@pytest.mark.parametrize("kind", [kind for kind in EVRS if kind not in ELSEWHERE] + list(COMMANDS))
def test_every_event_is_provoked_and_every_command_given_somewhere(kind):
    assert kind.__name__ in used()
