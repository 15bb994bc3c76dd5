"""``python -m impact_xval``: the command."""

import sys

from impact_xval.experiments.commands.cli import main

sys.exit(main())
