"""``python -m impact_xval``: the command."""

import sys

from impact_xval.experiments.commands.supervision import entry

sys.exit(entry())
