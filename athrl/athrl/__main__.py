"""`python -m athrl` is the command; `athrl train` starts its services this way."""

from athrl.command import main

if __name__ == "__main__":
    main()
