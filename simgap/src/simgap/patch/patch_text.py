"""Changes of the text of an MJCF file: few elements, each with a comment above it; the rest stays."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Comment, Element, TreeBuilder, XMLParser

from simgap.common.errors import RobotError

ORIENTATIONS: Final = ("quat", "axisangle", "euler", "xyaxes", "zaxis", "fullinertia")
"""Attributes of an inertial element that say the same as `quat`, or what `diaginertia` says."""
BODY_OF: Final = "body of "
"""Before the name of a joint: the body that it moves, which has no name of its own."""
SHORTCUTS: Final = ("kp", "kv", "dampratio", "inheritrange", "timeconst")
"""Attributes of position and velocity actuators that a general one does not have."""


@dataclass(frozen=True, slots=True)
class Change:
    """New attributes of one element, and the reason."""

    tag: str
    """"joint", "actuator", "inertial", "body", "geom", "tendon" or "option"."""
    name: str
    """Name of the element; of an actuator without a name, that of its joint; of an inertial element, that of
    its body; empty for options."""
    attributes: tuple[tuple[str, str], ...]
    reason: str


def change_text(text: str, changes: Sequence[Change]) -> str:
    """Return MJCF text with changes made.

    Args:
        text: MJCF text.
        changes: Changes; an element may have several.

    Raises:
        RobotError: An element is not in this text, as those that MuJoCo makes from others.
    """
    root = ElementTree.fromstring(text, XMLParser(target=TreeBuilder(insert_comments=True)))
    for change in changes:
        parent, element = _find(root, change)
        _set(element, change)
        said = Comment(f" {change.reason.replace('--', '- -')} ")
        said.tail = _indent(parent, element)
        parent.insert(list(parent).index(element), said)
    head = text[: text.index("<mujoco")]  # comments above the root, which the parser leaves out
    return f"{head}{ElementTree.tostring(root, encoding='unicode').replace(' />', '/>')}\n"


def number_text(*values: float) -> str:
    """Return numbers as an attribute, with all their digits."""
    return " ".join(repr(float(value)) for value in values)


def _find(root: Element, change: Change) -> tuple[Element, Element]:
    """Return an element and its parent."""
    if change.tag == "option":
        found = root.find("option")
        return root, (_add(root, "option") if found is None else found)
    if change.tag == "inertial":
        _, body = _body(root, change.name)
        found = body.find("inertial")
        return body, (_add(body, "inertial") if found is None else found)
    if change.tag == "body":
        return _body(root, change.name)
    if change.tag == "new actuator":
        section = root.find("actuator")
        if section is None:
            section = _add(root, "actuator")
            section.text, section.tail = f"{root.text or ''}  ", root.text
        section.append(Element("general"))  # the order of actuators is that of commands
        section[-1].tail = root.text
        return section, section[-1]
    return _named(root, change.tag, change.name)


def _body(root: Element, name: str) -> tuple[Element, Element]:
    """Return a body and its parent."""
    if not name.startswith(BODY_OF):
        return _named(root, "body", name)
    body, _ = _named(root, "joint", name.removeprefix(BODY_OF))
    return next(one for one in root.iter() if any(child is body for child in one)), body


def _named(root: Element, tag: str, name: str) -> tuple[Element, Element]:
    for section in root.findall({"actuator": "actuator", "tendon": "tendon"}.get(tag, "worldbody")):
        for parent in section.iter():
            for element in parent:
                is_kind = tag in ("actuator", "tendon") or element.tag == tag
                own = element.get("name") or (element.get("joint") if tag == "actuator" else None)
                if is_kind and own == name:
                    return parent, element
    raise RobotError(f"the model's text has no {tag} {name!r}")


def _set(element: Element, change: Change) -> None:
    new = dict(change.attributes)
    if change.tag == "inertial":
        for one in ORIENTATIONS:
            element.attrib.pop(one, None)
    if change.tag == "actuator" and "gainprm" in new:
        element.tag = "general"
        for one in SHORTCUTS:
            element.attrib.pop(one, None)
    element.attrib.update(new)


def _add(parent: Element, tag: str) -> Element:
    """Add an element as the first one of its parent."""
    element = Element(tag)
    element.tail = parent.text
    parent.insert(0, element)
    return element


def _indent(parent: Element, element: Element) -> str | None:
    """Return the white space before an element."""
    place = list(parent).index(element)
    return parent.text if place == 0 else list(parent)[place - 1].tail
