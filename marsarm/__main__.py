"""Run the command line: `python -m marsarm`."""

from ground.cli.app import main

if __name__ == "__main__":
    main()
