"""Numbers in sentences."""


def counted(count: int, one: str) -> str:
    """So many of these: 1 channel, 2 channels."""
    return f"{count} {one}" if count == 1 else f"{count} {one}s"
