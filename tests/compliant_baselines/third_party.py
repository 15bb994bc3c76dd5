"""Distributions that others might install, made in a folder: with solvers, good and bad."""

from pathlib import Path

_ROOT = Path(__file__).parents[2]

#: The examples of the documentation, word for word: an adapter of an engine, and a solver of one collision at a time.
TOY, ANVIL = (
    (_ROOT / "docs" / "adding-a-solver.md")
    .read_text(encoding="utf-8")
    .split(f"<!-- example {name} -->\n```python\n")[1]
    .split("```")[0]
    for name in ("adapter", "solver")
)
#: The file that the first one shows.
TOY_FILE = _ROOT / "examples" / "toy_engine.py"


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
