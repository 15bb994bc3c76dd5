"""A run without its figures: ``python -m tests.experiments.runner CONFIG OUT [options]``.

A run that is in the folder is continued.
"""

import argparse
from pathlib import Path

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.configuration import load_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import faulty

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("config", type=Path)
    parser.add_argument("root", type=Path)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--scheduler")
    parser.add_argument("--faulty", action="store_true", help="MuJoCo that dies of chosen cells")
    asked = parser.parse_args()
    run_sweep(
        load_config(asked.config),
        asked.root,
        workers=asked.workers,
        scheduler=asked.scheduler,
        resolve=faulty.faulty if asked.faulty else get_solver,
        resume=(asked.root / "manifest.json").exists(),
        progress=lambda done, total, line: print(line, flush=True) if line else None,
    )
