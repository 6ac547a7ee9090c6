"""`python -m mooringdx` is the command line."""

from mooringdx.cli import main

if __name__ == "__main__":
    main()
