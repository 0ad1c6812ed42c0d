"""What a channel is called: /joint.motor_rad; whoever asks for it may write /joint/motor_rad too."""

from fnmatch import fnmatchcase


def channel_name(topic: str, field: str) -> str:
    """The name of a field of a topic, as it is printed everywhere."""
    return f"{topic}.{field}"


def is_channel_meant(topic: str, field: str, pattern: str) -> bool:
    """Whether a pattern fits a channel in either spelling; capitals count."""
    spellings = (channel_name(topic, field), f"{topic}/{field}")
    return any(fnmatchcase(spelling, pattern) for spelling in spellings)
