"""The command ``impact-xval``, also as ``python -m impact_xval``."""

import os
import sys

from impact_xval.experiments.commands.supervision import open_streams, supervised


def entry() -> int:
    """Run the command line of this process, in a process that ends when this one is to end."""
    open_streams()
    return supervised(_main)


def _main() -> int:
    # Takes a third of a second, in which signals come too.
    from impact_xval.experiments.commands.cli import main
    from impact_xval.experiments.sweep.process import NO_WINDOW

    os.environ.update(NO_WINDOW | os.environ)
    return main()


if __name__ == "__main__":
    sys.exit(entry())
