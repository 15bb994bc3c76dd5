"""How long the explorer takes to redraw: from a slider's event in a browser to the frame after its new data.

    python benchmarks/explore.py [--moves N]

Debian's chromium, without a screen, on this machine; the median, and the share of it that is the server's. Every move
is to a cell that was not asked for before.
"""

import argparse
import statistics
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.experiments.cells.explored import explored, redraws


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=100)
    moves = parser.parse_args().moves
    print(subprocess.run(["nproc"], capture_output=True, text=True).stdout.strip(), "cores")
    for query, slider in (
        ("", "stiffness_ratio"),
        ("", "e2"),
        ("?kind=column&balls=5", "e"),
        ("?kind=column&balls=20", "e"),
    ):
        with explored(query) as page:
            times = redraws(page, slider, moves)
        tenths = statistics.quantiles(times, n=10)
        print(
            f"{query or 'two balls'}, {slider}: median {statistics.median(times):.0f} ms, "
            f"tenths {tenths[0]:.0f} to {tenths[-1]:.0f} ms, largest {max(times):.0f} ms, {moves} moves"
        )


if __name__ == "__main__":
    main()
