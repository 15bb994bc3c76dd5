"""Command ``impact-xval hypothesis``: tests whether infinitely stiff pairs move as one body.

The command tests the limiting cases of the supplement, or one collision that the user describes.
"""

from __future__ import annotations

import time
from pathlib import Path

from impact_xval.experiments.commands.options import (
    Workers,
    argument,
    option,
    parse_path,
    with_collision_options,
)
from impact_xval.experiments.commands.runs import check_holds_something, writing_folder
from impact_xval.experiments.config.collision_options import parse_collision
from impact_xval.experiments.config.errors import UserError


@with_collision_options("scenario", "gravity", "exponent", "gap", "step_fraction", "cell_timeout")
def hypothesis_command(
    config: Path | None = argument(
        "[FILE.toml]",
        "File of a test or of one collision (masses, stiffnesses ...). By default the built-in test.",
        parse_path,
        None,
    ),
    *,
    out: Path | None = option("DIR", "Folder to write; by default runs/hypothesis.", parse_path),
    workers: Workers = None,
    **typed: str | None,
) -> None:
    """Test whether infinitely stiff pairs move as one.

    The command tests the hypothesis of the supplement for each case and solver. You get verdicts, tables and a page.
    The same command continues a test that was stopped.

    Example: impact-xval hypothesis --out my-verdicts

    You can also describe a collision of your own, by the options of solve or in a file. The command then makes the
    stiffest contact stiffer in steps, and prints for every law whether its two bodies move as one. It writes no file.

    Example: impact-xval hypothesis --stiffness-ratio 40 --mass-ratio 1.15 --e1 0.9 --e2 0.7
    """
    given = [f"--{name.replace('_', '-')}" for name, value in typed.items() if value is not None]
    if config is not None and given:
        raise UserError(f"{config} and {given[0]} are given; legal: a file, or a collision by options")
    collision_and_contact = None
    if given:
        collision, _, _ = parse_collision(typed)
        collision_and_contact = collision, None
    elif config is not None:
        from impact_xval.experiments.hypothesis.own import load_own_collision

        collision_and_contact = load_own_collision(config)
    if collision_and_contact is None:
        _test_limiting_cases(config, out or Path("runs") / "hypothesis", workers)
        return
    for name, value in (("out", out), ("workers", workers)):
        if value is not None:
            raise UserError(f"--{name} = {value}: for one collision no file is written; legal: without it")
    from impact_xval.experiments.hypothesis.own import judge_own_pair, own_pair_blocks
    from impact_xval.experiments.presentation.terminal import (
        COMPILING,
        error_line,
        make_console,
        print_blocks,
        report_waiting,
    )
    from impact_xval.experiments.sweep.chunk import are_compiled

    is_pair = collision_and_contact[0].falls_on_resting
    if not are_compiled("state-transition", "pair" if is_pair else "chain"):
        error_line(COMPILING)
    with report_waiting("solving the collision at rising contrasts"):
        pair = judge_own_pair(*collision_and_contact)
    print_blocks(make_console(), own_pair_blocks(pair))


def _test_limiting_cases(config: Path | None, root: Path, workers: int | None) -> None:
    """Test the limiting cases of the supplement, write the results into a folder, and print the verdicts."""
    from impact_xval.experiments.hypothesis.config import load_hypothesis_config

    start = time.perf_counter()
    if config is not None:
        check_holds_something(config, "hypothesis")
    design = load_hypothesis_config(config)
    from impact_xval.experiments.hypothesis.page import show_verdicts, write_hypothesis
    from impact_xval.experiments.hypothesis.run import judge_runs, prepare_runs
    from impact_xval.experiments.presentation.terminal import make_console, print_line

    words, console = ["hypothesis", *([config] if config else []), "--out", root], make_console()
    for name, solve in prepare_runs(design, root):
        with writing_folder(words, console, name) as progress:
            solve(workers=workers, progress=progress)
    results = judge_runs(design, root)
    page = write_hypothesis(results, root)
    show_verdicts(console, results)
    print_line(console, f"{time.perf_counter() - start:.0f} s; the page is {page}")
