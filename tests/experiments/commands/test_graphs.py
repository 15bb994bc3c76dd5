"""The command `impact-xval solve --graph`: the table of a contact graph, and its picture."""

import json
import re

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.rigid.graphs import solve_graph_by_rigid_law
from impact_xval.compliant_baselines.rigid.laws import LAWS
from impact_xval.experiments.cells.compared_graph import REFERENCES, GraphComparison
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.graph_options import OPTIONS_OF, parse_graph
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.graph.named import GRAPHS, bernoulli, box, corner, rack

BERNOULLI = [
    "solve",
    "--graph",
    "bernoulli",
    "--angle",
    "30",
    "--stiffness-ratio",
    "4",
    "--restitution",
    "0.5",
]


def test_the_list_has_the_model_the_references_and_the_rigid_laws(command):
    found = json.loads(command([*BERNOULLI, "--json"]), parse_constant=pytest.fail)
    by_name = {each["solver"]: each for each in found}
    assert list(by_name) == ["state-transition", *REFERENCES, *LAWS]
    scene = bernoulli(30, stiffness_ratio=4, restitution=0.5)
    for name in ("state-transition", *REFERENCES):
        (outcome,) = get_solver(name).solve_graphs([scene], Settings())
        assert by_name[name]["velocities"] == [list(v) for v in outcome.velocities]
        assert by_name[name]["diagnostics"].keys() == outcome.diagnostics.keys()
    assert by_name["state-transition"]["D"] == 0
    change = np.subtract(by_name["kelvin-voigt"]["velocities"], by_name["state-transition"]["velocities"])
    assert by_name["kelvin-voigt"]["D"] == pytest.approx(np.sqrt((change**2).sum()), rel=1e-12)
    speeds = np.array(by_name["kelvin-voigt"]["velocities"])
    assert by_name["kelvin-voigt"]["retained_energy"] == pytest.approx((speeds**2).sum(), rel=1e-12)


def test_solvers_that_are_named_are_asked_instead(command):
    names = ["pymunk", "newton-restitution", "hunt-crossley"]
    words = [*BERNOULLI, *(word for name in names for word in ("--solver", name))]
    found = json.loads(command([*words, "--json"]))
    assert {each["solver"] for each in found} == {*names, "state-transition"}
    refused = next(each for each in found if each["solver"] == "hunt-crossley")
    assert (refused["status"], refused["D"]) == ("unrepresentable", None)
    assert refused["velocities"] == [[None, None]] * 3
    table = command(words)
    assert "hunt-crossley: unrepresentable: hunt-crossley is not a linear contact" in table
    row = next(line for line in table.splitlines() if line.startswith("hunt-crossley "))
    assert row.split() == ["hunt-crossley", "unrepresentable", *"-----"]


def test_the_table_has_velocities_of_all_bodies(command):
    lines = command([*BERNOULLI, "--solver", "kelvin-voigt"]).splitlines()
    assert (
        lines[0]
        == "Bernoulli, angle 30, stiffness ratio 4, restitution 0.5. Without gravity (scenario impact)."
    )
    words = {line.partition(" ")[0]: line.split() for line in lines}
    assert " ".join(words["solver"]) == "solver status v1 (x, z) v2 (x, z) v3 (x, z) D E/E0"
    model = words["state-transition"]
    assert model[1:4] == ["ok", "-0.0801,", "-0.0915"]
    assert model[-2] == "0"


@pytest.mark.parametrize("name", GRAPHS)
def test_defaults_of_options_are_those_of_the_model(name):
    assert parse_graph({"graph": name})[0] == GRAPHS[name]()


def test_the_description_of_a_graph_has_the_defaults_too():
    _, setup = parse_graph({"graph": "bridge", "e1": "0.8"})
    assert setup == "bridge, angle 30, table stiffness ratio 3, mass ratio 2, e1 0.8, e2 0.7"


@pytest.mark.parametrize("name", GRAPHS)
def test_the_help_beside_a_graph_has_the_options_of_this_graph_with_their_defaults(command, name):
    shown = command(f"solve --graph {name} --help")
    head, _, defaults = shown.partition(f"Defaults of {name}: ")
    options = set(re.findall(r"^  --([a-z0-9-]+)", head.partition("Options:")[2], re.M))
    own = {key.replace("_", "-") for key in OPTIONS_OF[name]}
    assert options == own | {"graph", "step-fraction", "cell-timeout", "solver", "plot", "json"}
    assert set(re.findall(r"--([a-z0-9-]+) \S", defaults)) == own
    if name == "corner":
        assert defaults.split("\n")[0] == "--angle 90 --stiffness-ratio 1 --e1 1 --e2 1 --velocity -1,-0.3"
        assert "e1 and e2 are the restitutions of the two walls." in defaults
    assert command(f"solve --graph={name} --help") == shown
    # The help without a graph has the options of two balls again, and says how to see those of a graph.
    assert "--angle" not in (plain := command("solve --help"))
    assert "--mass-ratio" in plain
    assert "--graph NAME --help shows its options." in " ".join(plain.split())


def test_e1_and_e2_are_the_restitutions_of_a_corner(command):
    words = "solve --graph corner --angle 60 --e1 0.9 --e2 0.7 --velocity -2,-0.6 --json --solver newton-restitution"
    model = json.loads(command(words.split()))[0]
    expected = 2 * np.array([(0.38155485401021, 0.68399552358526)])
    np.testing.assert_allclose(model["velocities"], expected, atol=1e-10)


@pytest.mark.parametrize(
    ("suffix", "first", "options"),
    [
        ("png", b"\x89PNG", "bernoulli"),
        ("svg", b"<?xml", "box --stiffness-ratio 3"),
        ("pdf", b"%PDF", "corner"),
    ],
)
def test_a_picture_has_a_caption(tmp_path, capsys, suffix, first, options):
    file = tmp_path / f"one.{suffix}"
    words = ["solve", "--graph", *options.split(), "--solver", "kelvin-voigt", "--plot", str(file), "--json"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert len(json.loads(out)) == 2
    assert "by solver. Black arrows: normals of contacts. Grey arrows: velocities before" in " ".join(
        err.split()
    )
    assert file.read_bytes().startswith(first)
    if suffix == "svg":
        text = " ".join(file.read_text(encoding="utf-8").split())
        # matplotlib writes texts as comments
        assert "Box, inertia 0.333333, stiffness ratio 3, restitution 0.8, by solver." in text
        assert "m/s" in text
        assert "rad/s" in text


def test_a_picture_of_nothing_is_refused():
    scene = box()
    failure = GraphCollisionOutcome.failure("state-transition", scene, "timeout", "for a test")
    compared = GraphComparison(scene, {"state-transition": failure}, "box")
    with pytest.raises(ValueError, match="no solver has a result to draw"):
        compared.plot()
    assert np.isnan(compared.divergences["state-transition"])


def test_rigid_laws_of_bodies():
    (x, z) = solve_graph_by_rigid_law("newton-restitution", corner(90)).velocities[0]
    assert (x, z) == pytest.approx((1.0, 0.3), abs=1e-12)
    top, bottom = (
        solve_graph_by_rigid_law(f"sequential-{end}", bernoulli(31)).velocities for end in ("top", "bottom")
    )
    np.testing.assert_allclose(top[0], np.array(bottom[0]) * (-1, 1), atol=1e-12)
    mixed = solve_graph_by_rigid_law("generalised-reflection", corner(60, restitutions=(0.9, 0.7)))
    assert (mixed.status, "one e for all" in mixed.reason) == ("unrepresentable", True)
    assert len(solve_graph_by_rigid_law("poisson-restitution", rack()).velocities) == 4
    with pytest.raises(ValueError, match="law = 'newton'; legal: newton-restitution"):
        solve_graph_by_rigid_law("newton", box())
