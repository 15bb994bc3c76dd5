"""The command: what it writes, and what it says of what it cannot do."""

import contextlib
import html
import io
import re
import shutil

import pandas as pd
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, named
from impact_xval.experiments.tables.numbers import number
from tests.browser import opened

SMALL = """
points = 6
solvers = ["state-transition", "bistiffness", "kelvin-voigt"]
contrast = [10, 1e6]
plastic_contrast = [10, 1e7]
per_decade = 4
[columns]
points = 3
balls = [4, 4]
contrast = [10, 1e5]
"""

#: A mistake, and what its one line says; those of any configuration are tested with it.
BAD = {
    "contrast = [1e5, 10]": ["contrast = [100000.0, 10.0]", "lo < hi"],
    "plastic_contrast = [0, 10]": ["plastic_contrast", "1 < lo < hi <= 1e16"],
    "solvers = ['mujoko']": ["solvers", "'mujoko'", "did you mean 'mujoco'"],
    "[columns]\nballs = [3, 7]": ["columns.balls = [3, 7]", "whole numbers from 4 to 12"],
    "seed = 1.5": ["seed = 1.5", "a whole number from 0 to 2^32"],
    "points = 3": ["points = 3", "from 6 to 500 (points of each limit)"],
}


def test_bad_input_is_one_line_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, words in BAD.items():
        (tmp_path / "h.toml").write_text(text)
        assert main(["hypothesis", "h.toml"]) == 2, text
        out, err = capsys.readouterr()
        assert (out, err.count("\n"), (tmp_path / "runs").exists()) == ("", 1, False), (text, err)
        assert all(word in err for word in ("impact-xval: h.toml: ", *words)), (text, err)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Run it; gives its folder, and what it prints."""
    root, said = tmp_path_factory.mktemp("hypothesis"), io.StringIO()
    (root / "h.toml").write_text(SMALL)
    with contextlib.redirect_stdout(said):
        assert main(["hypothesis", str(root / "h.toml"), "--out", str(root / "out"), "--workers", "1"]) == 0
    return root / "out", said.getvalue()


def test_it_is_continued_to_the_same_tables_and_holds_no_other_test(made, tmp_path, capsys):
    again = tmp_path / "again"
    shutil.copytree(made[0], again)
    table = (again / "verdicts.csv").read_bytes()
    lost = sorted((again / "exact" / "parts").iterdir())[::2]
    for path in (*lost, again / "verdicts.csv", again / "exact" / "cells.parquet"):
        path.unlink()
    assert main(["hypothesis", str(made[0].parent / "h.toml"), "--out", str(again), "--workers", "2"]) == 0
    assert "resumed: " in capsys.readouterr().out
    assert (again / "verdicts.csv").read_bytes() == table
    for folder, says in ((again, "holds another test of the hypothesis"), (tmp_path, "not empty")):
        assert main(["hypothesis", "--out", str(folder)]) == 2
        assert f"{says}; legal: a new or empty folder" in capsys.readouterr().err


def test_the_page_and_the_command_show_the_verdicts_of_the_tables(made):
    root, said = made
    page = html.unescape((root / "report.html").read_text())
    wholes = pd.read_csv(root / "verdicts.csv").query("`class` == 'all'")
    table = next(part for part in page.split("</table>") if ">zero-apart</th>" in part)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL) for row in table.split("<tr>")]
    shown = {row[0]: row[1:] for row in cells if row}
    for solver, found in wholes.groupby("solver"):
        for row, cell in zip(found.itertuples(), shown[named(solver)], strict=True):
            n = row.n_undecided if row.verdict == "no limit" else getattr(row, f"n_{row.verdict}")
            close = "never" if row.close_from == float("inf") else f"≥{number(row.close_from, 1)}"
            more = {"supported": f"r {row.rate:.2f}", "refuted": f"D {row.offset_least:.2g}"}
            verdict = f"{row.verdict} {n}/{row.points}"
            assert cell.startswith(f"{verdict} {close}<br>{more.get(row.verdict, '')}")
            assert verdict in said
    assert wholes[wholes.case == "zero-late"].verdict.to_list() == ["supported", "refuted", "refuted"]
    assert "they move,<br>it parts again" in shown["the pair is one by"][2]
    assert said.count(LAWS_WITH_LAWS) == page.count(LAWS_WITH_LAWS) == 1


def test_columns_that_move_as_one_are_counted_on_the_page_and_in_the_terminal(made):
    wholes = pd.read_csv(made[0] / "columns.csv").query("`class` == 'all'")
    assert len(wholes) == 12 * 3
    assert wholes.n_supported[wholes.meets].sum() == 0
    assert wholes.least_rate.min() > 0.4
    assert wholes.largest_rate.max() < 2.2
    found = wholes[~wholes.meets].groupby("solver")[["n_supported", "n_refuted", "points"]].sum()
    assert found.loc["kelvin-voigt"].to_list() == [8, 16, 24]
    assert found.drop("kelvin-voigt").n_refuted.to_list() == [0, 0]
    for row in found.itertuples():
        count = f"{row.n_supported} of {row.points}"
        assert f">{count}</td>" in (made[0] / "report.html").read_text()
        assert f"{named(row.Index)} {count}" in " ".join(made[1].split())


@pytest.mark.slow
def test_the_page_is_two_screens_unfolded(made):
    with opened((made[0] / "report.html").as_uri()) as page:
        assert page.evaluate("document.documentElement.scrollHeight") <= 2 * 900
