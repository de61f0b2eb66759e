"""Entry point of `athrl` and of `python -m athrl`, with which `athrl train` starts its services."""

import sys


def main() -> None:
    """Load the command and run it; Ctrl-C while it is loaded ends it without a message."""
    try:
        from athrl import command

        command.main()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
