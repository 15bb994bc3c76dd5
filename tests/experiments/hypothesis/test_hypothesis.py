"""Tests of the hypothesis: where each law goes, compared with closed forms and the docs, and the command's output."""

import contextlib
import dataclasses
import html
import io
import math
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.mapping import damping_ratio, restitution
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.hypothesis.chains import (
    draw_chains,
    stiffen_contact,
    velocities_of_balls,
    weld_contact,
)
from impact_xval.experiments.hypothesis.judging import kinetic_distance
from impact_xval.experiments.hypothesis.page import count_chains, format_range
from impact_xval.experiments.hypothesis.run import LIMITING_CASES, MARGIN, draw_design
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, display_name
from impact_xval.experiments.tables.numbers import number
from impact_xval.model import Collision, solve
from tests.browser import opened
from tests.model.test_limits import ball_ball_rigid

ROOT = Path(__file__).parents[3]
GOLDEN = f"{ROOT}/tests/golden/values/hypothesis-full-{{}}.csv"
#: Rows of the tables in docs/hypothesis.md, by limiting case or by solver. `SOLVERS` are the columns of the first
#: table.
TABLES = dict(re.findall(r"^\| `(\S+)` \| (.*) \|$", (ROOT / "docs/hypothesis.md").read_text("utf-8"), re.M))
SOLVERS = ["state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-anchored"]
SOLVERS += ["kelvin-voigt-textbook", "hunt-crossley"]
REDRAWN = [pytest.param(f"seed = {seed}", marks=pytest.mark.nightly) for seed in (2, 77)]


@pytest.fixture(scope="module", params=["points = 6", *REDRAWN])
def made(request, tmp_path_factory):
    """Test the hypothesis with the solvers of the docs; return its folder and the text that the command printed."""
    root, said = tmp_path_factory.mktemp("hypothesis"), io.StringIO()
    chains = "[chains]\npoints = 3\nballs = [4, 4]"
    (root / "h.toml").write_text(f"solvers = {SOLVERS}\n{request.param}\n{chains}")
    with contextlib.redirect_stdout(said):
        assert main(["hypothesis", str(root / "h.toml"), "--out", str(root / "out"), "--workers", "1"]) == 0
    return root / "out", said.getvalue()


def wholes(file):
    return pd.read_csv(file, na_values=["inf"]).convert_dtypes().query("`class` == 'all'")


def test_every_name_that_heads_a_column_or_a_row_is_defined_on_the_page(made):
    page = (made[0] / "report.html").read_text(encoding="utf-8")
    defined = page.partition('id="what-the-names-mean"')[2].partition("</table>")[0]
    names = {html.unescape(name) for name in re.findall(r"<tr><td[^>]*>([^<]+)</td><td", defined)}
    heads = {html.unescape(head) for head in re.findall(r"<th scope=\"col\"[^>]*>([^<]+)</th>", page)}
    assert len(heads) > 15
    assert not heads - names
    assert {display_name(solver) for solver in SOLVERS} <= names


def test_the_tables_of_the_docs_are_those_of_the_built_in_test():
    """The tables of docs/hypothesis.md are those of the golden values, which another test compares with a run."""
    rows = {}
    for row in wholes(GOLDEN.format("limits")).query("solver in @SOLVERS").itertuples():
        n = getattr(row, f"n_{row.verdict}", row.n_undecided)
        far = f", {format_range((row.offset_least, row.offset_largest))}" if row.verdict == "refuted" else ""
        rows.setdefault(row.case, []).append(f"{row.verdict}{'' if n == row.points == 24 else f', {n}'}{far}")
    chains = SimpleNamespace(chains=wholes(GOLDEN.format("chains")))
    for solver, place, *counts, rates, away in count_chains(chains):
        assert all(count.endswith(" of 24" if place == "meet" else " of 48") for count in counts)
        said = (f"{n.split()[0]}, {far}" for n, far in zip(counts, (rates, away), strict=True) if far != "-")
        rows.setdefault(solver, []).append("; ".join(said))
    assert {name: " | ".join(cells) for name, cells in rows.items()} == TABLES


def test_points_are_of_their_regime_and_closed_forms_are_those_of_the_supplement():
    drawn = draw_design(24, 9)
    assert not {*drawn.mass_ratio} & {*draw_design(24, 10).mass_ratio}
    for row in drawn.itertuples():
        found = (row.closed_form_v1, row.closed_form_v2)
        if row.case.startswith("zero"):
            v1, v2, states = ball_ball_rigid(row.mass_ratio, row.e1, row.e2)
            early = row.e1 * row.mass_ratio < 1
            assert row.case == f"zero-{'apart' if len(states) == 3 else 'early' if early else 'late'}"
            assert abs(row.e1 * row.mass_ratio - 1) >= MARGIN * (1 + row.mass_ratio)
            assert found == pytest.approx((v1, v2), abs=1e-13)
        elif row.case == "infinity":
            pair = Collision((1.0, row.mass_ratio), (1.0, 1.0), (row.e1, row.e2), (-1.0, 0.0), table=True)
            as_one = velocities_of_balls(solve(weld_contact(pair, 1)).velocities, 1)
            assert (*found, *as_one) == pytest.approx((row.e1, 0) * 2, abs=1e-14)


def remapped(e, mapped, mass):
    """Return the restitution of a dashpot that was made for the reduced mass `mapped` but acts on another mass.

    Formula of Schwager and Poeschel, Granular Matter 9:465, 2007.
    """
    return restitution(damping_ratio(e) * math.sqrt(mapped / mass))


def test_a_dashpot_law_goes_where_its_own_dashpots_lead_and_not_where_it_is_mapped_anew():
    """By Kelvin-Voigt's law a chain with a very stiff contact moves like the welded chain, to 1e-5.

    The welded chain must have the original dashpots. They are given to it by the restitutions that they have for its
    masses. With dashpots made anew for the welded masses it moves differently, by more than 1e-3.
    """
    for chain, contact in draw_chains(("pile", "middle"), 2, (4, 5), 2):
        anew = weld_contact(chain, contact)
        over = (1 / np.array((*one.masses, math.inf)) for one in (chain, anew))
        mapped, reduced = (1 / (each[1:] + each[:-1]) for each in over)
        kept = tuple(map(remapped, anew.restitutions, np.delete(mapped, contact), reduced))
        asked = [stiffen_contact(chain, contact, 1e6), anew, dataclasses.replace(anew, restitutions=kept)]
        stiff, *forms = get_solver("kelvin-voigt").solve_many(asked, Settings())
        ends = [velocities_of_balls(form.velocities, contact) for form in forms]
        away = kinetic_distance(
            np.divide(chain.masses, chain.masses[0]), np.subtract(ends, [stiff.velocities])
        )
        assert away[0] > 1e-3 > 1e-5 > away[1]


def predicted(case, solver, mu, e1, e2):
    """Return the velocities that a law reaches instead of the closed form, or None if no formula is known.

    The dashpot of a contact that becomes infinitely stiff is infinite, too, and joins the bodies at first touch.
    """
    match case, solver:
        # three single impacts: between the balls, with the table, between the balls
        case "zero-late", "bistiffness" | "kelvin-voigt":
            v = np.array([-1.0, 0.0])
            for _ in range(2):
                impulse = mu / (1 + mu) * (1 + e1) * (v[1] - v[0])
                v += impulse, -impulse / mu
                v[1] = -e2 * v[1] if v[1] < 0 else v[1]
            return tuple(v)
        case "infinity" | "plastic-ball-table", "kelvin-voigt":  # B1 meets a wall
            return remapped(e1, mu / (1 + mu), 1.0), 0.0
        case "plastic-ball-ball", "kelvin-voigt":  # both balls as one body meet the table
            return (remapped(e2, mu, 1 + mu) / (1 + mu),) * 2


def test_verdicts_and_that_refuted_limits_are_those_predicted_without_a_simulation(made):
    verdicts, tried = wholes(made[0] / "verdicts.csv").set_index(["case", "solver"]).verdict, set()
    for limit in (case.key for case in LIMITING_CASES):
        assert [*verdicts[limit][SOLVERS]] == [cell.split(",")[0] for cell in TABLES[limit].split(" | ")]
    for row in pd.read_csv(made[0] / "points.csv").query("verdict == 'refuted'").itertuples():
        form = predicted(row.case, row.solver, row.mass_ratio, row.e1, row.e2)
        if form is not None:
            missed = kinetic_distance((1, row.mass_ratio), np.subtract((row.limit_v1, row.limit_v2), form))
            assert missed < min(2e-3, 0.2 * row.offset), row
            tried.add((row.case, row.solver))
    assert len(tried) == 5


#: A wrong line of a configuration, and parts of the message. Mistakes that any configuration can have are tested
#: elsewhere.
BAD = {
    "contrast = [1e5, 10]": ("contrast = [100000.0, 10.0]", " lo < hi"),
    "plastic_contrast = [0, 10]": ("plastic_contrast", " 1 < lo < hi <= 1e16"),
    "solvers = ['mujoko']": ("solvers = 'mujoko' ", "did you mean 'mujoco'"),
    "[chains]\nballs = [3, 7]": ("chains.balls = [3, 7]", " whole numbers from 4 to 12"),
    "seed = 1.5": ("seed = 1.5", " a whole number from 0 to 2^32"),
    "points = 3": ("points = 3", " from 6 to 500 (points of each limiting case)"),
}


def test_bad_input_is_one_line_and_writes_nothing(tmp_path, refused, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, says in BAD.items():
        Path("h.toml").write_text(text)
        refused("hypothesis h.toml", f"impact-xval: h.toml: {says[0]}", *says[1:])
    assert [*Path().iterdir()] == [Path("h.toml")]


@pytest.mark.nightly
def test_a_test_of_the_hypothesis_is_continued_to_the_same_tables(made, tmp_path, command, refused):
    again = shutil.copytree(made[0], tmp_path / "again")
    lost, table = sorted((again / "exact" / "parts").iterdir())[:2], (again / "verdicts.csv").read_bytes()
    for path in (*lost, again / "verdicts.csv", again / "exact" / "cells.parquet"):
        path.unlink()
    words = ["hypothesis", made[0].parent / "h.toml", "--out", again, "--workers", "2"]
    assert "resumed: " in command(words)
    assert (again / "verdicts.csv").read_bytes() == table
    for folder, says in ((again, "holds another test of the hypothesis"), (tmp_path, "not empty")):
        refused(["hypothesis", "--out", folder], f"{says}; legal: a new or empty folder")


def test_the_page_and_the_command_show_the_verdicts_of_the_tables(made):
    root, said = made
    page = (root / "report.html").read_text()
    table = next(part for part in page.split("</table>") if ">zero-apart</th>" in part)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL) for row in table.split("<tr>")]
    shown = {row[0]: row[1:] for row in cells if row}
    for solver, found in wholes(root / "verdicts.csv").groupby("solver"):
        for row, cell in zip(found.itertuples(), shown[display_name(solver)], strict=True):
            close = "never" if pd.isna(row.close_from) else f"≥{number(row.close_from, 1)}"
            more = {"supported": f"r {row.rate:.2f}", "refuted": f"D {row.offset_least:.2g}"}
            verdict = f"{row.verdict} {getattr(row, f'n_{row.verdict}', row.n_undecided)}/{row.points}"
            assert cell.startswith(f"{verdict} {close}<br>{more.get(row.verdict, '')}")
            assert verdict in said
    assert "they move,<br>the pair parts again" in shown["made one body by"][2]
    assert said.count(LAWS_WITH_LAWS) == page.count(LAWS_WITH_LAWS) == 1


def test_chains_that_move_as_one_are_counted_on_the_page_and_in_the_terminal(made):
    found = wholes(made[0] / "chains.csv")
    assert found.n_supported[found.meets].sum() == 0
    assert 0.4 < found.least_rate.min() <= found.largest_rate.max() < 2.2
    found = found[~found.meets].groupby("solver")[["n_supported", "n_refuted", "points"]].sum()
    assert found.loc["kelvin-voigt"].to_list() == found.loc["kelvin-voigt-textbook"].to_list() == [8, 16, 24]
    assert found.n_refuted[["state-transition", "bistiffness"]].to_list() == [0, 0]
    for row in found.itertuples():
        count = f"{row.n_supported} of {row.points}"
        assert f">{count}</td>" in (made[0] / "report.html").read_text()
        assert f"{display_name(row.Index)} {count}" in " ".join(made[1].split())


@pytest.mark.slow
def test_the_page_is_two_screens_unfolded(made):
    with opened((made[0] / "report.html").as_uri()) as page:
        assert page.evaluate("document.documentElement.scrollHeight") <= 2 * 900
