"""Start of the command `simgap`: Ctrl-C is answered from here on, also while the rest is imported."""

from simgap.common.interruption import report_interruption


def start() -> None:
    """Run the command `simgap`."""
    # An interruption is an exception, which unwinds the stack, so that temporary files are deleted.
    with report_interruption():
        from simgap.command.app import main

        main()


if __name__ == "__main__":
    start()
