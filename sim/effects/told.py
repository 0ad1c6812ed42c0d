"""Flight parameters of one joint or link, found and replaced."""

from dataclasses import replace

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import JointParams, LinkParams, Params


def joint_of(params: Params, joint: Joint) -> JointParams:
    """What flight software is told of a joint."""
    found: JointParams = getattr(params.joints, joint.name.lower())
    return found


def with_joint(params: Params, joint: Joint, changed: JointParams) -> Params:
    """The parameters with another joint."""
    return replace(params, joints=replace(params.joints, **{joint.name.lower(): changed}))


def link_of(params: Params, frame: Frame) -> LinkParams:
    """What flight software is told of the link that ends in a frame, which is not that of a tool."""
    found: LinkParams = getattr(params.links, frame.name.lower())
    return found


def with_link(params: Params, frame: Frame, changed: LinkParams) -> Params:
    """The parameters with another link."""
    return replace(params, links=replace(params.links, **{frame.name.lower(): changed}))
