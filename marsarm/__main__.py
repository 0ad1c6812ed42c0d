"""Run the command line: `python -m marsarm`."""

from marsarm.cli.start import start

if __name__ == "__main__":
    start()
