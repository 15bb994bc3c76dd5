"""What a newcomer reads first: numbers that are numbers, sentences that fit one cell, and whose cells are compared."""

import re

import pandas as pd
import pytest

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.page.headlines import numbers, subjects, uneven
from impact_xval.experiments.presentation.pages import phrase, render
from impact_xval.experiments.presentation.summary_page import summary_facts
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.numbers import number
from tests.experiments import fakes
from tests.experiments.conftest import SMALL

#: Two causes that are five times as large as the D they leave.
CANCELLING = {"stiffness_ratio": [1e-3], "mass_ratio": [0.5], "e1": [0.5], "e2": [0.5]}


@pytest.fixture(scope="module")
def summary(tmp_path_factory):
    config = parse_config({"solvers": ["bistiffness", "kelvin-voigt", "mujoco"], "grid": CANCELLING})
    return summarise(run_sweep(config, tmp_path_factory.mktemp("one") / "run"))


@pytest.fixture(scope="module")
def facts(summary):
    found = summary_facts(summary)["facts"]
    return found | {"subjects": subjects(found["solvers_found"], found["closest"])}


def test_every_headline_number_is_a_number(facts):
    shown = re.findall(r"<strong>(.*?)</strong>(.*?)</p>", str(numbers(facts, "cells")))
    assert len(shown) == 3
    assert [float(value) > 0 for value, _ in shown] == [True] * 3
    norm = dict(facts["ladder"]["engines"][0]["cancel"])["dissipation law"]
    assert (shown[2][0], "dissipation law; frozen positions" in shown[2][1]) == (norm, True)


def test_causes_that_cancel_are_named_with_their_norms(facts):
    (engine,) = facts["ladder"]["engines"]
    assert [label for label, _ in engine["cancel"]] == ["dissipation law", "frozen positions"]
    pair = " and ".join(f"{label} (norm {norm})" for label, norm in engine["cancel"])
    for template, macro, fact in (
        ("headlines.md.j2", "why", [engine]),
        ("ladder.md.j2", "ladder_findings", facts["ladder"]),
    ):
        said = phrase(template, macro, fact)
        assert f"is what {pair}, which mostly cancel one another, leave." in said
        assert "cancels (norm" not in said


def test_causes_that_cancel_in_one_part_of_the_plane_are_named_there(summary, facts, tmp_path):
    grid = CANCELLING | {"stiffness_ratio": [1e-3, 1.0]}
    both = run_sweep(parse_config({"solvers": ["kelvin-voigt", "mujoco"], "grid": grid}), tmp_path / "run")
    said = phrase("ladder.md.j2", "ladder_findings", summary_facts(summarise(both))["facts"]["ladder"])
    (label, norm), (other, _) = facts["ladder"]["engines"][0]["cancel"]
    assert (
        f"The largest cause is {label}, norm {norm}, which {other} mostly cancels, at k2/k1 < 0.1; " in said
    )


def _page(summary, facts):
    rest = {"figures": {}, "provenance": [], "gravity_number": "", "traps": {"introduction": "", "found": []}}
    return render(
        "report.md.j2", **facts, facts=facts, uneven=uneven(summary, facts["subjects"]), **rest
    ).partition("![Contents]")[0]


def test_sentences_of_one_cell_are_of_one_cell(summary, facts):
    page = _page(summary, facts)
    assert "beside it is 1 such collision by bistiffness (the model's law in time" in page
    for many in ("1 such collisions", "1 cells", "median", "half of", "mean D", "Where does it matter?"):
        assert many not in page + str(numbers(facts, "cells")), many


def test_a_terminal_shows_the_values_of_one_cell(summary):
    shown = render("summary_run.md.j2", **summary_facts(summary))
    row = next(line for line in shown.splitlines() if line.startswith("| kelvin-voigt | mujoco"))
    d, dv1, dv2 = (summary.get("mujoco", name)["max"] for name in ("velocity_divergence", "dv1", "dv2"))
    values = [cell.strip() for cell in row.strip("|").split("|")]
    assert values == ["kelvin-voigt", "mujoco", *map(number, (d, dv1, dv2)), "another", "ok"]
    for many in ("1 cells", "median D |", "95 %", "at most"):
        assert many not in shown


def _losing(name):
    """Give an engine that has no result where e1 = 0.9 and k2/k1 = 2, and otherwise the model's a bit faster."""

    class Losing(fakes.Shifted):
        def solve_many(self, collisions, settings):
            refused = fakes.Refusing().solve_many(collisions, settings)
            pairs = zip(collisions, super().solve_many(collisions, settings), refused, strict=True)
            return [none if (c.e1, c.stiffness_ratio) == (0.9, 2.0) else some for c, some, none in pairs]

    return Losing() if name == "mujoco" else fakes.shifted(name)


@pytest.mark.parametrize(("resolve", "said"), [(fakes.shifted, False), (_losing, True)])
def test_engines_that_are_not_compared_in_the_same_cells_are_said_not_to_be(resolve, said, tmp_path):
    config = parse_config(SMALL | {"solvers": ["mujoco", "bistiffness", "kelvin-voigt"]})
    found = summarise(run_sweep(config, tmp_path / "run", isolate=False, resolve=resolve))
    both = summary_facts(found)["facts"]
    both |= {"subjects": [s for s in both["solvers_found"] if s["solver"] != "kelvin-voigt"]}
    page = _page(found, both)
    words = "mujoco and bistiffness are not compared in the same cells"
    assert (words in page) == said
    if said:
        rows = pd.read_parquet(tmp_path / "run" / "divergence.parquet")
        rows = rows[rows.marked.isna() & rows.velocity_divergence.notna()]
        n = rows.groupby("solver").size()
        assert f"mujoco in {n.mujoco} cells, bistiffness in {n.bistiffness} cells" in page
        n = rows[rows.stiffness_ratio == 2].groupby("solver").size()
        assert f"at k2/k1 = 2 mujoco in {n.mujoco} and bistiffness in {n.bistiffness}." in page
        assert "mujoco has no result in 2 of 12 cells." in page


def test_agreement_to_rounding_is_no_number_of_its_digits():
    found = {"solver": "a", "where": "here", "d": {"n": 2, "median": 3.33e-16, "max": 0.1}}
    assert phrase("headlines.md.j2", "how_far", [found], "cells").startswith("a ends D = 0 to rounding from")
    shown = str(numbers({"subjects": [found], "closest": [], "ladder": {"engines": []}}, "cells"))
    assert "<strong>&lt; 1e-12</strong>" in shown
