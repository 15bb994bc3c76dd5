"""What the pages of the site say that is in the code already: commands, configuration, tables, linked files.

MkDocs calls ``on_files`` and ``on_page_markdown``. A page holds ``<!-- generated: NAME -->`` where the text of
`GENERATED` goes; in the repository the page says without it where the same is found.
"""

from __future__ import annotations

import json
import posixpath
import re
from collections.abc import Callable, Iterable
from html import escape
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]

#: Pages made of files outside of docs/, below this folder of the site.
SOURCE = "source"

SCHEMA = "configuration.schema.json"

_LINK = re.compile(r"(\]\()((?:\.\./)+[^)#\s]+)((?:#[^)\s]*)?\))")
_MARKER = re.compile(r"^<!-- generated: ([a-z-]+) -->$", re.M)


def on_files(files: Any, config: Any) -> Any:
    """Add the schema of a configuration, and a page for every file outside of docs/ that a page links to."""
    from mkdocs.structure.files import File

    added = {SCHEMA: schema()}
    for file in list(files.documentation_pages()):
        for link in _LINK.finditer(file.content_string):
            path = _outside(file.src_uri, link[2])
            if path:
                added[_page_of(path)] = _page_text(ROOT / path)
    for uri, content in added.items():
        files.append(File.generated(config, uri, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Fill in what is generated, and lead links that leave docs/ to the pages made of those files."""
    here = page.file.src_uri

    def inside(link: re.Match[str]) -> str:
        path = _outside(here, link[2])
        if path is None:
            return link[0]
        return link[1] + posixpath.relpath(_page_of(path), posixpath.dirname(here) or ".") + link[3]

    return _LINK.sub(inside, _MARKER.sub(lambda marker: GENERATED[marker[1]](), markdown))


def _outside(page: str, target: str) -> str | None:
    """Path in the repository of a link that leaves docs/, else None."""
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
    return None if path.startswith("docs/") or page.startswith(SOURCE) else path


def _page_of(path: str) -> str:
    return f"{SOURCE}/{path.removesuffix('.md')}.md"


def _page_text(path: Path) -> str:
    """Show a file as a page."""
    name, text = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        # Its links lead from the root of the repository: into docs/, or to files that have no page here.
        def led(link: re.Match[str]) -> str:
            up = "../" * (name.count("/") + 1)
            return f"{link[1]}({up}{link[3]})" if link[2] else link[1].removeprefix("[").removesuffix("]")

        return re.sub(r"(\[[^\]]*\])\((?![a-z]+:|#)(docs/)?([^)\s]*)\)", led, text)
    if path.suffix == ".ipynb":
        return _notebook(name, json.loads(text))
    language = {".py": "python", ".toml": "toml", ".csv": "text"}.get(path.suffix, "text")
    return f"# {name}\n\n````{language}\n{text}````\n"


def _notebook(name: str, notebook: dict[str, Any]) -> str:
    """Show the cells of a notebook, each with what it printed and drew."""
    parts = [] if "".join(notebook["cells"][0]["source"]).startswith("# ") else [f"# {name}"]
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            shown = output.get("data", {})
            if "text/html" in shown:
                parts.append(f'<div class="notebook">\n{"".join(shown["text/html"])}\n</div>')
            else:
                text = "".join(output.get("text") or shown.get("text/plain", ""))
                parts.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts) + "\n"


def schema() -> str:
    """Return the JSON schema of a configuration."""
    from impact_xval.experiments.config.configuration import Config

    made = {"$schema": "https://json-schema.org/draft/2020-12/schema", **Config.model_json_schema()}
    return json.dumps(made, indent=1, allow_nan=False) + "\n"


def _plain(text: str) -> str:
    """Text in which nothing is markup of HTML."""
    return escape(text, quote=False)


def _row(cells: Iterable[object]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def _table(head: tuple[str, ...], rows: Iterable[Iterable[object]]) -> str:
    return "\n".join([_row(head), _row("---" for _ in head), *map(_row, rows)]) + "\n"


def commands() -> str:
    """Arguments and options of every command."""
    import typer.main

    from impact_xval.experiments.commands.cli import PROGRAM, app

    group: Any = typer.main.get_command(app)
    sections = []
    for name, command in group.commands.items():
        if command.hidden:
            continue
        with command.make_context(name, [], resilient_parsing=True) as context:
            usage = " ".join([PROGRAM, name, *command.collect_usage_pieces(context)])
            rows = [each.get_help_record(context) for each in command.get_params(context)]
        about = (command.help or "").replace("\b", "").strip()
        options = _table(
            ("argument or option", "meaning"), ((f"`{a}`", _plain(b)) for a, b in filter(None, rows))
        )
        sections.append(f"## {name}\n\n```text\n{usage}\n```\n\n{_plain(about)}\n\n{options}")
    return "\n".join(sections)


def configuration() -> str:
    """Every key of a configuration: default, and what is legal."""
    described = json.loads(schema())
    tables = {"": described, **_tables(described)}
    return "\n".join(_keys(name, table) for name, table in tables.items())


def _tables(described: dict[str, Any]) -> dict[str, Any]:
    """Tables of the file by their key."""
    found = {}
    for key, entry in described["properties"].items():
        for option in (entry, *entry.get("anyOf", ())):
            if "$ref" in option:
                found[key] = described["$defs"][option["$ref"].rpartition("/")[2]]
    return found


def _keys(name: str, table: dict[str, Any]) -> str:
    rows = (
        (f"`{key}`", _default(entry), _plain(entry.get("description", "")))
        for key, entry in table["properties"].items()
    )
    head = (
        f"## [{name}]\n\n{_plain(table.get('description', '')).replace('``', '`')}"
        if name
        else "## Keys of the file"
    )
    return f"{head}\n\n{_table(('key', 'default', 'legal'), rows)}"


def _default(entry: dict[str, Any]) -> str:
    if "default" not in entry:
        return "its own, below"
    value = entry["default"]
    return "none" if value is None else f"`{_toml(value)}`"


def _toml(value: Any) -> str:
    """Write a value as the file holds it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + "}"
    return json.dumps(value)


def columns() -> str:
    """Every column of the tables of a run: type, unit and meaning, as in the metadata of the files."""
    from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
    from impact_xval.experiments.measures.ladder_table import ladder_schema
    from impact_xval.experiments.tables import schema as known

    tables = {
        "cells.parquet": known.COLLISIONS.cells,
        "divergence.parquet": known.COLLISIONS.divergence,
        "ladder.parquet": ladder_schema(KELVIN_VOIGT),
        "cells.parquet, of columns of N balls": known.LINES.cells,
        "divergence.parquet, of columns of N balls": known.LINES.divergence,
    }
    return "\n".join(
        f"### {name}\n\n"
        + _table(
            ("column", "type", "unit", "meaning"),
            (
                (
                    f"`{field.name}`",
                    field.type,
                    field.metadata[b"unit"].decode(),
                    _plain(field.metadata[b"meaning"].decode()),
                )
                for field in fields
            ),
        )
        for name, fields in tables.items()
    )


#: Text that goes to the places marked ``<!-- generated: NAME -->``.
GENERATED: dict[str, Callable[[], str]] = {
    "commands": commands,
    "configuration": configuration,
    "columns": columns,
}
