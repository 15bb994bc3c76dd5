"""``impact-xval fit``: which law explains measured collisions."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Annotated

import typer

from impact_xval.experiments.commands.options import folder_to_write, path


def fit(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA", parser=path("DATA"), help="A .csv or .parquet file, a row a collision."
        ),
    ],
    law: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A law; may be repeated. By default all.")
    ] = None,
    out: Annotated[Path | None, folder_to_write("by default fit")] = None,
) -> None:
    """Find the law that explains measured collisions, its k2/k1, e1 and e2, and how sure that is.

    Writes fit.html (the page to read), tables, and what MuJoCo and PyBullet would do with these parameters. Rows that
    are impossible are named and left out; exit code 2 if nothing is left to fit. `impact-xval init-data` writes a file
    to fill in.
    """
    from impact_xval.experiments.fit.fitting import fit as fitted
    from impact_xval.experiments.fit.laws import laws_of
    from impact_xval.experiments.fit.page import write_fit
    from impact_xval.experiments.fit.trials import NoTrialsError, read_trials, trials_of
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import (
        error_line,
        make_console,
        print_line,
        show,
        show_progress,
    )
    from impact_xval.experiments.tables.folders import new_folder

    laws_of(law)
    start, root, frame = time.perf_counter(), out if out is not None else Path("fit"), read_trials(data)
    try:
        trials_of(frame)
    except NoTrialsError as error:
        for line in error.problems:
            error_line(line)
        raise
    new_folder(root)
    console = make_console()
    try:
        with show_progress(console, "laws") as progress:
            result = fitted(frame, law, progress)
        facts = write_fit(root, result, data.name, time.perf_counter() - start)
    except BaseException:
        with contextlib.suppress(OSError):  # it holds something else
            root.rmdir()
        raise
    show(console, render("fit_run.md.j2", **facts))
    print_line(console, f"{time.perf_counter() - start:.0f} s; {root / 'fit.html'} is the page to read")
