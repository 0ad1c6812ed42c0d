"""Tools and contact switches of the nominal arm, in the order of its parameters."""

from sim.arms import nominal_params

_PARAMS = nominal_params()
TOOLS = _PARAMS.tool_names
SWITCHES = tuple(switch.name for switch in _PARAMS.switches)
TOOL_SWITCHES = {
    tool: tuple(switch.name for switch in _PARAMS.switches if switch.tool == tool) for tool in TOOLS
}
WITH_SWITCHES = [tool for tool in TOOLS if TOOL_SWITCHES[tool]]


def tool_index(tool: str) -> int:
    """Return the index of a tool in arrays of tools."""
    return TOOLS.index(tool)


def switch_index(switch: str) -> int:
    """Return the index of a contact switch in the sensor word."""
    return SWITCHES.index(switch)
