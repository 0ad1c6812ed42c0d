"""Run the command line: `python -m marsarm`."""

from ground.cli.start import start

if __name__ == "__main__":
    start()
