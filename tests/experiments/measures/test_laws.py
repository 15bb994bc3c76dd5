"""Solvers that were asked for one law are one vote on it; what a run prints claims no more than was compared."""

import dataclasses
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks import steps
from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.registry import law_of, solver_names
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.measures.laws import by_law, in_order_of_laws, voters
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.figures import write_figures
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.report import write_report, write_tables
from impact_xval.experiments.presentation.views import show_summary
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes
from tests.experiments.conftest import SMALL
from tests.experiments.pages import paragraphs, tables

ROOT = Path(__file__).parents[3]
LAWS_WITH_LAWS = phrase("table.md.j2", "laws_with_laws")
NOTE = "kelvin-voigt, mujoco and pybullet were asked for the same law: one vote, not three."


class Damped(fakes.Shifted):
    """The exact Kelvin-Voigt contacts under the name of an engine, off by a little."""

    def solve_many(self, collisions, settings):
        outcomes = get_solver("kelvin-voigt").solve_many(collisions, settings)
        return [dataclasses.replace(o, solver=self.name, v1=o.v1 + 1e-4) for o in outcomes]


class Other(Damped):
    name = "pybullet"


def damped(name):
    return {"mujoco": Damped, "pybullet": Other}.get(name, lambda: get_solver(name))()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    # An order in which solvers of one law are apart.
    solvers = ["mujoco", "bistiffness", "pybullet", "kelvin-voigt"]
    config = parse_config(
        SMALL | {"solvers": solvers, "step_fraction": 0.004, "convergence": {"enabled": False}}
    )
    return run_sweep(config, tmp_path_factory.mktemp("laws") / "run", isolate=False, resolve=damped)


@pytest.fixture(scope="module")
def summary(folder):
    return summarise(folder)


def printed(summary):
    console = Console(file=io.StringIO(), width=400)
    show_summary(console, summary)
    return console.file.getvalue()


def test_solvers_are_grouped_by_the_law_that_the_registry_says():
    assert by_law(["mujoco", "bistiffness", "pybullet", "kelvin-voigt", "oracle"]) == {
        "kelvin-voigt": ["kelvin-voigt", "mujoco", "pybullet"],
        "bistiffness": ["bistiffness"],
        "state-transition": ["oracle"],
    }
    names = solver_names(on_request=True)
    assert sorted(in_order_of_laws(names)) == sorted(names)
    assert len(voters(names)) == len({law_of(name) for name in names})
    assert voters(["pybullet", "mujoco"]) == ["pybullet"]


def test_the_sentence_counts_the_solvers_of_one_law():
    names = ["mujoco", "pybullet", "kelvin-voigt", "bistiffness"]
    assert phrase("table.md.j2", "one_vote", names) == NOTE
    assert phrase("table.md.j2", "one_vote", ["state-transition", "bistiffness", "mujoco"]) == ""


def test_tables_group_solvers_by_law_and_say_so(summary):
    overall = next(
        table for table in tables(summary) if table.caption.startswith("Divergence of each solver")
    )
    rows = [row[:2] for row in overall.rows]
    order = ["kelvin-voigt", "mujoco", "pybullet", "bistiffness"]
    assert list(dict.fromkeys(name for _, name in rows)) == order
    assert all(law == law_of(name) for law, name in rows)
    listing = [
        table
        for table in tables(summary)
        if {"mujoco", "pybullet"} <= {*table.header, *(row[0] for row in table.rows)}
    ]
    assert len(listing) >= 5
    for table in listing:
        names = [
            name for name in [*table.header, *dict.fromkeys(row[0] for row in table.rows)] if name in order
        ]
        assert names == [name for name in order if name in names], table.caption
    assert NOTE in overall.caption
    assert NOTE in paragraphs(summary)


def test_figures_of_several_solvers_say_which_are_one_vote(folder):
    write_figures(folder)
    captions = json.loads((folder.root / "figures/captions.json").read_text())
    for name in ("divergence-by-stiffness", "divergence-map", "state-paths", "energy", "impulse-curves"):
        assert NOTE in captions[name], name


def test_the_agreement_of_an_engine_with_its_law_is_said_with_the_step(summary):
    said = [text for text in paragraphs(summary) if " and kelvin-voigt, the exact solver of the law" in text]
    assert len(said) == 2  # of the engines, and of no other law
    for text in said:
        assert text.startswith("At the step of this run, 0.004 of the fastest contact period, D between ")
        assert "is 0.0001 (median)" in text
    assert any("it up to a tenth of the contact period" in text for text in paragraphs(summary))


@pytest.mark.slow
def test_what_a_run_prints_claims_no_accuracy(folder, summary):
    """Laws are compared with laws: nothing that was measured is there to be accurate against."""
    write_tables(folder)
    write_figures(folder)
    page = write_report(folder).read_text()
    texts = {"terminal": printed(summary), "report": re.sub(r"data:image/png;base64,[^\"]*", "", page)}
    texts |= {
        name: (folder.root / name).read_text()
        for name in ("summary.md", "summary.tex", "figures/captions.json")
    }
    for name, text in texts.items():
        assert not re.search(r"\baccura|\binaccura", text, re.IGNORECASE), name
    for name in ("terminal", "report", "summary.md", "summary.tex"):
        assert LAWS_WITH_LAWS in texts[name], name
    # Before any table.
    assert texts["summary.md"].index(LAWS_WITH_LAWS) < texts["summary.md"].index("| ---")


def test_the_pages_state_what_is_compared_and_at_which_step():
    top, findings = (
        " ".join((ROOT / page).read_text(encoding="utf-8").split())
        for page in ("README.md", "docs/findings.md")
    )
    top = top.split("## Two commands")[0]
    assert "compares laws of contact with one another; no laboratory measurement is in it" in top
    assert "one vote, not three" in findings
    for text in (top, findings):
        claims = [
            part for part in re.split(r"(?<=[.:]) ", text) if "reproduce the requested contact law" in part
        ]
        assert claims
        for sentence in claims:
            assert "thousandth" in sentence
        assert not re.search(r"\baccura", text, re.IGNORECASE)


def test_an_engine_is_further_from_its_law_at_longer_steps():
    reason = get_solver("mujoco").unavailable()
    if reason is not None:
        pytest.skip(reason)
    D, failed = steps.distances("mujoco", steps.sample(8, 3), (1e-2, 0.1))
    assert D.shape == (2, 8)
    assert not failed[0]
    assert np.nanmedian(D[1]) > 4 * np.nanmedian(D[0])


@pytest.mark.nightly
def test_the_table_of_longer_steps_is_what_the_benchmark_measures(capsys):
    text = (ROOT / "docs/convergence.md").read_text(encoding="utf-8")
    for label, name in (("MuJoCo", "mujoco"), ("PyBullet", "pybullet")):
        solver = get_solver(name)
        if (
            solver.unavailable() is not None
            or f"{label} {solver.version()}" not in text.split("## Longer steps")[1]
        ):
            pytest.skip(f"the table is of another {label}")
    steps.main(["--cells", "208", "--seed", "1"])
    found = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    printed = text.split("<!-- steps -->\n")[1].split("\n\n")[0].splitlines()
    assert len(found) == len(printed) == 10
    for line, expected in zip(found[2:], printed[2:], strict=True):
        (engine, *numbers), (named, *others) = (row.strip("| ").split(" | ") for row in (line, expected))
        assert engine == named
        assert [float(x) for x in numbers] == pytest.approx([float(x) for x in others], rel=0.02)
