"""``python -m mimic``: the same as the ``mimic`` command."""

from mimic.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
