"""`python -m clothkit`, the command line."""

from clothkit.app.cli import main

if __name__ == "__main__":
    main()
