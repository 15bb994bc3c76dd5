"""A run of a slow solver, in a session of its own that can be killed whole; one that is there is continued."""

import os

from impact_xval.experiments.config.experiment import load_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import faulty


def run(config, root):
    os.setsid()
    run_sweep(load_config(config), root, workers=2, resolve=faulty.slow)
