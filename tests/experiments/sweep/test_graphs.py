"""Runs of named contact graphs: cells, rows, tables, output on terminal and page, and the continuation of a run."""

import io
import math
from itertools import pairwise

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from markupsafe import Markup
from rich.console import Console

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import REFERENCE, load_config, parse_config
from impact_xval.experiments.config.graph_options import parse_graph
from impact_xval.experiments.config.graphs import GRAPH_SPECS, GraphGrid
from impact_xval.experiments.measures.divergence import asymmetry, results_of_graphs
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation import views
from impact_xval.experiments.presentation.findings import summary_blocks
from impact_xval.experiments.presentation.page.opened import collect_cells
from impact_xval.experiments.presentation.report import present_run
from impact_xval.experiments.sweep.run import present_once, run_sweep
from impact_xval.experiments.tables.comparison import compare_runs
from impact_xval.experiments.tables.folder import CONFIGURATION, finished_run_of_pairs
from impact_xval.model.graph import GraphCollisionOutcome, bernoulli, bridge, corner, rack
from tests.experiments import fakes
from tests.experiments.conftest import tables_of

GRAPHS = {
    "name": "few graphs",
    "solvers": ["kelvin-voigt", "newton-restitution", "sequential-top", "mujoco"],
    "chunk_size": 5,
    "graph": {"stiffness_ratio": [0.1, 1.0, 10.0], "angle": [30, 60], "balls": [3], "e": [0.5, 1.0]},
}
SETTINGS = Settings()
SCALES = {"m1": 2.0, "k1": 1e6, "v0": -3.0}


@pytest.fixture(scope="module")
def graph_run(tmp_path_factory):
    """A small run of graphs, with its page and an engine that is 0.01 m/s off. Tests must not change it."""
    root = tmp_path_factory.mktemp("graphs") / "run"
    result = run_sweep(
        parse_config(GRAPHS), root, isolate=False, to_be_presented=True, resolve=fakes.shifted_graphs
    )
    present_once(result, present_run, isolate=False)
    return result.folder


def test_cells_are_the_named_graphs_in_the_scales_of_the_experiment():
    axes = {"stiffness_ratio": [0.5, 4.0], "angle": [35, 50], "mass_ratio": 3.0, "balls": [6], "e": [0.8]}
    cells = experiment_cells(parse_config({"graph": axes} | SCALES))
    block = cells.block(range(len(cells)))
    assert block.parameters["graph"].tolist() == ["bernoulli"] * 4 + ["corner"] * 4 + ["bridge"] * 4 + [
        "rack"
    ]
    by_hand = [
        bernoulli(50, stiffness_ratio=0.5, restitution=0.8),
        corner(35, stiffness_ratio=4.0, restitutions=(0.8, 0.8)),
        bridge(35, table_stiffness_ratio=0.5, mass_ratio=3.0, restitutions=(0.8, 0.8)),
        rack(6, restitution=0.8),
    ]
    for place, unit in zip((1, 6, 8, 12), by_hand, strict=True):
        graph = block.graphs[place]
        assert np.allclose(graph.masses, 2.0 * np.array(unit.masses), rtol=1e-15)
        assert np.allclose(graph.velocities, 3.0 * np.array(unit.velocities), rtol=1e-15)
        for made, given in zip(graph.contacts, unit.contacts, strict=True):
            assert (made.bodies, made.normal, made.restitution) == (given.bodies, given.normal, 0.8)
            assert math.isclose(made.stiffness, 1e6 * given.stiffness, rel_tol=1e-15)
    assert np.isnan(block.parameters["stiffness_ratio"][12])
    assert np.isnan(block.parameters["balls"][0])


def test_angles_by_default_are_legal_for_each_graph_and_axes_that_no_graph_has_are_not_written(tmp_path):
    assert GraphGrid().axes("corner")["angle"] == [60.0, 90.0, 120.0]
    alone = parse_config({"graph": {"name": "rack"}})
    assert alone.graph is not None
    assert alone.graph.count() == 8
    (tmp_path / "a.toml").write_text(alone.toml())
    assert "stiffness_ratio" not in alone.toml().partition("[graph]")[2].partition("[convergence]")[0]
    assert load_config(tmp_path / "a.toml").identity() == alone.identity()
    assert parse_config({"graph": {"name": "rack", "e": 0.5}}).identity() != alone.identity()


@pytest.mark.parametrize("name", [*GRAPH_SPECS])
def test_the_mirror_of_a_symmetric_graph_maps_its_contacts_onto_themselves(name):
    numbers = {"angle": 60.0, "stiffness_ratio": 1.0, "mass_ratio": 2.0, "balls": 6, "e": 0.9}
    spec = GRAPH_SPECS[name]
    graph, mirror = spec.make(numbers), spec.mirror(numbers)
    if mirror is None:
        assert name == "corner"
        return
    image_of = {number + 1: image + 1 for number, image in enumerate(mirror.images)} | {None: None}
    signs = [-1 if coordinate == mirror.coordinate else 1 for coordinate in (0, 1)]

    def key(bodies, normal, stiffness):
        (a, b), n = bodies, np.round(normal, 12) + 0.0
        swapped = b is not None and b < a
        return ((b, a), tuple(-n + 0.0), stiffness) if swapped else ((a, b), tuple(n), stiffness)

    contacts = {key(c.bodies, c.normal, c.stiffness) for c in graph.contacts}
    mirrored = {
        key([image_of[b] for b in c.bodies], np.multiply(signs, c.normal), c.stiffness)
        for c in graph.contacts
    }
    assert contacts == mirrored
    images = np.array(graph.velocities)[list(mirror.images)] * signs
    assert np.array_equal(images, graph.velocities)
    assert GRAPH_SPECS["bernoulli"].mirror(numbers | {"stiffness_ratio": 2.0}) is None


def test_asymmetry_is_the_largest_difference_from_the_mirror_image():
    parameters = {"graph": np.array(["bernoulli", "corner"], dtype=object), "v0": np.array([-2.0, -2.0])}
    parameters |= {
        name: np.array([1.0, 1.0]) for name in ("stiffness_ratio", "angle", "mass_ratio", "balls", "e")
    }
    outcomes = [
        GraphCollisionOutcome("a", ((0.0, 0.2), (-0.3, -0.6), (0.4, -0.7))),
        GraphCollisionOutcome("a", ((0.1, 0.2),)),
    ]
    names = ("1x", "1z", "2x", "2z", "3x", "3z")
    found = asymmetry(parameters, results_of_graphs(outcomes, np.array([2.0, 2.0]), names))
    assert math.isclose(found[0], 0.05)
    assert math.isnan(found[1])


def test_tables_hold_the_outcomes_of_solvers_and_their_measures_by_hand(graph_run):
    cells = pd.read_parquet(graph_run.root / "cells.parquet")
    d = pd.read_parquet(graph_run.root / "divergence.parquet")
    assert not [name for name in cells if name.startswith(("impulse", "states", "n_events"))]
    row = cells[
        (cells.graph == "bernoulli") & (cells.angle == 30) & (cells.stiffness_ratio == 1) & (cells.e == 1)
    ]
    by_solver = row.set_index("solver")
    assert np.allclose(by_solver.loc[REFERENCE, ["v1x", "v1z"]].astype(float), [0, 0.2], atol=1e-12)
    assert np.isnan(by_solver.loc[REFERENCE, "v4x"])
    assert math.isclose(by_solver.loc[REFERENCE, "retained_energy"], 1.0, rel_tol=1e-12)
    assert math.isclose(by_solver.loc[REFERENCE, "retained_momentum"], 1.0, rel_tol=1e-12)
    assert cells[cells.graph.isin(["corner", "bridge"])].retained_momentum.isna().all()
    shifted = d[(d.solver == "mujoco") & (d.graph == "bernoulli")]
    assert np.allclose(shifted.velocity_divergence, 0.01, rtol=1e-9)
    assert np.allclose(shifted.dv1x, 0.01, rtol=1e-9)
    assert np.allclose(shifted.dv1z, 0.0, atol=1e-12)
    exact = [c for c in (REFERENCE, "kelvin-voigt", "newton-restitution")]
    assert (cells[cells.solver.isin(exact)].asymmetry.dropna() < 1e-12).all()
    assert cells[(cells.graph == "bernoulli") & (cells.stiffness_ratio != 1)].asymmetry.isna().all()
    symmetric = (cells.graph == "bernoulli") & (cells.stiffness_ratio == 1) & (cells.solver == "mujoco")
    assert np.allclose(cells[symmetric].asymmetry, 0.02, rtol=1e-9)
    types = pq.read_schema(graph_run.root / "cells.parquet")
    assert types.field("v2z").metadata[b"meaning"] == b"velocity of ball 2 along z when the collision is over"


def test_rigid_laws_answer_graphs_by_the_solver_of_their_name():
    graph = bernoulli(stiffness_ratio=4.0)
    x = {}
    for name in ("newton-restitution", "poisson-restitution", "sequential-top", "sequential-bottom"):
        (outcome,) = get_solver(name).solve_graphs([graph], SETTINGS)
        x[name] = outcome.velocities[0]
    assert np.allclose(x["newton-restitution"], [0, 0.2], atol=1e-12)
    assert np.allclose(x["sequential-top"], [0.21650635, 0.125], atol=1e-8)
    assert np.allclose(x["sequential-bottom"], [-0.21650635, 0.125], atol=1e-8)
    unequal = corner(60, restitutions=(0.9, 0.5))
    (refused,) = get_solver("generalised-reflection").solve_graphs([unequal], SETTINGS)
    assert refused.status == "unrepresentable"
    assert "one e" in refused.reason


def test_a_run_that_is_continued_or_sharded_has_the_same_tables(graph_run, tmp_path):
    config = parse_config(GRAPHS)
    for shard in ((1, 2), (2, 2)):
        result = run_sweep(config, tmp_path / "run", shard=shard, isolate=False, resolve=fakes.shifted_graphs)
    assert result.tables_complete
    kept = load_config(tmp_path / "run" / CONFIGURATION)
    again = run_sweep(kept, tmp_path / "run", isolate=False, resolve=fakes.shifted_graphs).folder
    assert again.manifest()["sessions"][-1]["parts_computed"] == 0
    whole, parts = tables_of(graph_run.root), tables_of(again.root)
    assert all(
        parts[name] == whole[name] for name in ("cells.parquet", "divergence.parquet", "divergence.csv")
    )
    assert compare_runs(graph_run, again, 0.0).moved == 0


def test_another_kind_of_run_is_refused(graph_run, chain_run):
    with pytest.raises(
        UserError, match=r"of contact graphs.*of chains of N balls; legal: two runs of one kind"
    ):
        compare_runs(graph_run, type(graph_run)(chain_run), 0.0)
    with pytest.raises(UserError, match=r"a run of contact graphs; legal: a run of collisions of two balls"):
        finished_run_of_pairs(graph_run.root)


def test_the_terminal_says_how_far_solvers_are_and_who_breaks_symmetry(graph_run):
    said = "\n".join(Markup(str(block)).striptags() for block in summary_blocks(summarise(graph_run)))
    assert "keep the mirror symmetry of a scene to rounding, in 18 symmetric graphs" in said
    assert "MuJoCo breaks the mirror symmetry" in said
    assert "by up to 0.02 |v0|" in said
    console = Console(file=io.StringIO(), width=200)
    views.show_cell(console, 0, views.rows_of_cell(graph_run, 0), graph_run.config())
    shown = console.file.getvalue()
    assert "graph = bernoulli" in shown
    assert "v1x/|v0|" in shown
    assert "v3z/|v0|" in shown
    assert "v4x" not in shown


def test_the_page_says_what_was_compared_what_came_out_and_why(graph_run):
    page = (graph_run.root / "report.html").read_text(encoding="utf-8")
    for text in (
        "a ball falls between two equal balls at rest (bernoulli)",
        "Does a symmetric scene stay symmetric?",
        "do not use the stiffness of contacts. Their D changes with k2/k1 only because",
        "At e = 1 contacts are plain springs, so exact Kelvin-Voigt has the contact law of the model",
        "|v0| is the largest asymmetry of sequential-top",
        "D by angle in degrees",
        "in a corner, the angle is between the normals".replace("in", "In", 1),
    ):
        assert text in page, text
    assert "Causes" not in page
    assert "state paths" not in page.lower()
    names = {path.stem for path in (graph_run.root / "figures").glob("*.svg")}
    assert names == {"divergence-by-stiffness", "divergence-by-angle", "divergence-by-restitution"}


def test_the_command_of_a_cell_solves_the_same_graph(graph_run):
    cells = pd.read_parquet(graph_run.root / "cells.parquet").drop_duplicates("graph")
    shown = collect_cells(graph_run, cells.cell.tolist())
    blocks = experiment_cells(graph_run.config())
    for number, name in zip(cells.cell, cells.graph, strict=True):
        contents = shown[number]
        command = contents["commands"][1][1].split()
        typed = {key[2:].replace("-", "_"): value for key, value in pairwise(command) if key.startswith("--")}
        graph, _ = parse_graph(typed)
        unit = blocks.block(range(number, number + 1)).graphs[0]
        assert graph.velocities == unit.velocities
        assert graph.masses == unit.masses
        assert [c.restitution for c in graph.contacts] == [c.restitution for c in unit.contacts]
        assert np.allclose([1e8 * c.stiffness for c in graph.contacts], [c.stiffness for c in unit.contacts])
        of_model = contents["results"][0]["velocities"]
        assert len(of_model) == 2 * len(graph.masses), name


def test_a_rigid_engine_is_held_against_the_rigid_laws_of_its_run(tmp_path):
    def resolve(name):
        fake = fakes.ShiftedGraphs()
        fake.name = name
        return fake if name == "pymunk" else get_solver(name)

    def said(*laws):
        grid = {"name": "bernoulli", "stiffness_ratio": [1.0], "angle": [40], "e": [1.0]}
        config = parse_config({"solvers": [*laws, "pymunk"], "graph": grid})
        root = tmp_path / "-".join(("run", *laws))
        folder = run_sweep(config, root, isolate=False, resolve=resolve).folder
        return "\n".join(Markup(str(block)).striptags() for block in summary_blocks(summarise(folder)))

    of_laws = said("sequential-top", "newton-restitution")
    assert (
        "The rigid law in this run that is nearest to Pymunk is newton-restitution. In the median" in of_laws
    )
    assert "their velocities differ by 0.01 |v0|. The largest difference is 0.01 |v0|." in of_laws
    assert "This run has no rigid law. To see which law Pymunk follows, add newton-restitution" in said()
