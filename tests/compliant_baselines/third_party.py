"""Distributions for tests that pretend to be installed by others: folders with solvers, correct or broken."""

from pathlib import Path

_EXAMPLES = Path(__file__).parents[2] / "examples"

#: Source of the examples of the documentation: an adapter of an engine, and a solver of single collisions.
TOY, ANVIL = (_EXAMPLES.joinpath(name).read_text(encoding="utf-8") for name in ("toy_engine.py", "anvil.py"))


def install(folder: Path, name: str, points: dict[str, str], **modules: str) -> None:
    """Write a distribution into a folder as pip would: its metadata with entry points, and its modules."""
    info = folder / f"{name.replace('-', '_')}-1.2.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    info.joinpath("METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n", encoding="utf-8"
    )
    lines = "\n".join(f"{key} = {value}" for key, value in points.items())
    info.joinpath("entry_points.txt").write_text(f"[impact_xval.solvers]\n{lines}\n", encoding="utf-8")
    for module, text in modules.items():
        folder.joinpath(f"{module}.py").write_text(text, encoding="utf-8")
