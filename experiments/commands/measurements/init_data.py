"""``impact-xval init-data``: a file of measured collisions to fill in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import file_to_write, path
from impact_xval.experiments.config.errors import UserError


def init_data(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", parser=path("FILE"), help="To write; ends in .csv.")
    ],
) -> None:
    """Write a commented file for measured collisions, which `impact-xval fit` reads once it is filled in."""
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, print_line
    from impact_xval.experiments.tables.store import write_text

    file_to_write("FILE", file, (".csv",))
    if file.exists() or file.is_symlink():
        raise UserError(f"FILE {file}: is there already; legal: a new file")
    write_text(file, render("init_data.txt.j2"))
    print_line(make_console(), f"{file}: fill it in, then impact-xval fit {file}")
