"""The `fame` command, also as ``python -m fame``: a Ctrl-C is told in one line from its first import on."""

from __future__ import annotations

import sys


def main() -> int:
    """Do what the command line says and return the exit code. See `fame.cli`."""
    try:
        from fame import cli
    except KeyboardInterrupt:
        print("fame: interrupted", file=sys.stderr)
        return 130
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
