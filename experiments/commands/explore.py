"""``impact-xval explore``: one collision, or one column, in the browser as it moves."""

from __future__ import annotations

from typing import Annotated

import typer

from impact_xval.experiments.commands.options import whole


def _port(text: str) -> int:
    return whole("--port", text, 0, 65535)


def explore(
    port: Annotated[
        int, typer.Option(metavar="N", parser=_port, help="Port to listen at; 0: any free one.")
    ] = 5006,
    address: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Of this machine, to listen at; by default for this machine alone."
        ),
    ] = "127.0.0.1",
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
) -> None:
    """Serve a page whose sliders move one collision, or one column of N balls, until Ctrl-C.

    The model and the exact references follow the sliders; a button runs the engines. The address of the page holds
    the cell.
    """
    from impact_xval.experiments.cells.serving import explorer
    from impact_xval.experiments.presentation.terminal import make_console, print_line

    with explorer(address, port) as (where, serve):
        print_line(make_console(), f"{where} (Ctrl-C ends it)")
        if browser:
            import webbrowser

            webbrowser.open(where)
        serve()
