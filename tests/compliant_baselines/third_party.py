"""Distributions that others might install, made in a folder: with solvers, good and bad."""

from pathlib import Path

GOOD = '''
"""The whole of an adapter: an engine of one's own, here semi-implicit Euler on two springs with dashpots."""
from dataclasses import replace

from compliant_baselines.column import Column
from compliant_baselines.engine import EngineSolver
from compliant_baselines.recording import Recorder
import numpy as np


class TinyEngine(EngineSolver):
    """Semi-implicit Euler."""

    name = "tiny"

    def version(self):
        return "1.2"

    def run_columns(self, columns, max_steps, record_path=False):
        return [self.run(column, max_steps, record_path) for column in columns]

    def run(self, column, max_steps, record_path):
        c, h = column, column.step
        x1, x2 = c.start(c.m2 * c.gravity / c.contact2.k, 1.0)
        x, v = [x1, x2], [c.v1, c.v2]
        recorder = Recorder(c, x1, x2, c.contact2.k, max_steps, record_path)
        while recorder.n_steps < max_steps:
            rows = []
            for _ in range(min(256, max_steps - recorder.n_steps)):
                d1, d2 = x[1] - x[0], -x[1]
                f1 = max(0.0, c.contact1.k * d1 + c.contact1.c * (v[1] - v[0])) if d1 > 0 else 0.0
                f2 = max(0.0, c.contact2.k * d2 - c.contact2.c * v[1]) if d2 > 0 else 0.0
                v = [v[0] + h * (f1 / c.m1 - c.gravity), v[1] + h * ((f2 - f1) / c.m2 - c.gravity)]
                x = [x[0] + h * v[0], x[1] + h * v[1]]
                rows.append((*v, *x))
            rows = np.array(rows)
            if recorder.feed(rows[:, :2].copy(), rows[:, 2:].copy()):
                break
        return recorder.finish()
'''


def install(folder: Path, name: str, points: dict[str, str], **modules: str) -> None:
    """Lay a distribution down as pip would: metadata with entry points, and its modules."""
    info = folder / f"{name.replace('-', '_')}-1.2.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    info.joinpath("METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n", encoding="utf-8"
    )
    lines = "\n".join(f"{key} = {value}" for key, value in points.items())
    info.joinpath("entry_points.txt").write_text(f"[impact_xval.solvers]\n{lines}\n", encoding="utf-8")
    for module, text in modules.items():
        folder.joinpath(f"{module}.py").write_text(text, encoding="utf-8")
