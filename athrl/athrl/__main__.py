"""What starts as `athrl` and as `python -m athrl`, which is how `athrl train` starts its services."""

import sys


def main() -> None:
    """Load the command and run it; Ctrl-C meanwhile, which takes a moment, ends it without a word."""
    try:
        from athrl import command
    except KeyboardInterrupt:
        sys.exit(130)
    command.main()


if __name__ == "__main__":
    main()
