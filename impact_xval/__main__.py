"""``python -m impact_xval``: the command."""

import sys

from impact_xval.experiments.commands.cli import entry

sys.exit(entry())
