"""What a run of columns shows, and what other commands make of its folder."""

import json
import re

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import load_config
from impact_xval.experiments.measures.columns.summary import summarise_columns
from impact_xval.experiments.presentation.columns.figures import draw_columns, shown_until
from impact_xval.experiments.presentation.report import present
from impact_xval.experiments.sweep.curves import needed
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folders import finished

CONFIG = """
name = "few columns"
solvers = ["bistiffness", "kelvin-voigt", "mujoco"]
[column]
arrangement = ["cradle", "drop"]
balls = [2, 3, 4]
e = [0.6, 0.9]
exponent = [1.0, 1.5]
stiffness_taper = 1.0
[figure_column]
balls = 4
e = 0.8
"""
FIGURES = [
    *("divergence-by-balls", "energy-by-balls", "velocities"),
    *("ladder-by-balls", "ladder-by-column", "ladder-norms", "wave"),
]


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("columns")
    (folder / "c.toml").write_text(CONFIG)
    run_sweep(
        load_config(folder / "c.toml"),
        folder / "run",
        isolate=False,
        present=lambda folder, _: present(folder),
    )
    return folder / "run"


def test_every_median_is_that_of_the_table(root):
    summary = summarise_columns(finished(root))
    rows = pq.read_table(root / "divergence.parquet").to_pandas()
    assert (summary.n_cells, list(summary.axes)) == (24, ["balls", "arrangement", "e", "exponent"])
    for name in ("bistiffness", "kelvin-voigt", "mujoco"):
        of_solver = rows[(rows.solver == name) & rows.marked.isna()]
        found = summary.get(name, "velocity_divergence")
        assert found["median"] == of_solver.velocity_divergence.median()
        assert found["n"] == of_solver.velocity_divergence.notna().sum()
        for n in (2, 3, 4):
            some = of_solver[of_solver.balls == n].velocity_divergence
            assert summary.get(name, "velocity_divergence", "balls", n)["median"] == some.median()
        worst = summary.worst[summary.worst.solver == name]
        assert worst.velocity_divergence.iloc[0] == of_solver.velocity_divergence.max()
    assert summary.statuses.loc["mujoco", "unrepresentable"] == 12
    assert summary.statuses.loc["kelvin-voigt", "ok"] == 24
    (reason,) = {row.reason for row in summary.reasons.itertuples() if row.solver == "mujoco"}
    assert "exponent = 1.5" in reason
    statistics = pd.read_csv(root / "summary.csv")
    assert set(statistics.axis) == {"all", "balls", "arrangement", "strike", "e", "exponent", "mass_taper",
                                    "stiffness_taper", "gap"}  # fmt: skip


def test_the_page_shows_it(root):
    page = (root / "report.html").read_text(encoding="utf-8")
    page = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    captions = json.loads((root / "figures/captions.json").read_text(encoding="utf-8"))
    assert list(captions) == FIGURES
    assert page.count("data:image/png;base64,") == len(FIGURES)
    assert "a cradle of 4 balls, 1 striking, e = 0.8" in captions["velocities"]
    summary = summarise_columns(finished(root))
    for words in ("N = 2", "N = 3", "N = 4", "unrepresentable", "state-transition", "few columns"):
        assert words in page
    median = summary.get("kelvin-voigt", "velocity_divergence")["median"]
    assert f"kelvin-voigt diverges from the model by D = {median:.3g} (median)" in page
    assert "None" not in page.partition("Provenance</h2>")[0]
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", page))


def test_the_curves_are_of_the_column_of_the_figures(root):
    curves = {row["solver"]: row for row in pq.read_table(root / "curves.parquet").to_pylist()}
    model, law = curves["state-transition"], curves["kelvin-voigt"]
    assert [len(row["velocities"]) for row in curves.values() if row["velocities"]][:3] == [4] * 3
    assert len(model["forces"]) == 3
    assert {len(forces) for forces in model["forces"]} == {len(model["time"])}
    assert max(len(row["time"]) for row in curves.values()) < 400
    # The impulse of the first contact is what ball 1 loses, per m1 |v0|.
    for row in (model, law, curves["mujoco"]):
        time, force = row["time"], row["forces"][0]
        impulse = sum(
            (b - a) * (f + g) / 2 for a, b, f, g in zip(time, time[1:], force, force[1:], strict=False)
        )
        assert impulse == pytest.approx(1 + row["velocities"][0], rel=2e-2)


def test_the_points_that_are_kept_of_forces_are_enough_to_draw_them():
    time = np.concatenate([np.linspace(0, 10, 9000), np.linspace(1e6, 1e6 + 1, 1000)])
    forces = np.column_stack([np.sin(3 * time), np.zeros_like(time)])
    forces[5000, 1] = 7.0
    forces[5000:5005, 1] = 7.0
    time[5004:5006] = time[5004]  # a force that ends at once
    forces[9000:, 0] = 0.0
    kept = needed(time, forces)
    assert len(kept) < 250
    assert {0, 5000, 5004, 5005, 9999} <= set(kept)
    assert forces[kept].max(axis=0).tolist() == forces.max(axis=0).tolist()
    other = np.delete(np.arange(len(time)), 5004)  # of the two at one instant
    drawn = np.column_stack([np.interp(time[other], time[kept], force[kept]) for force in forces.T])
    assert np.abs(drawn - forces[other]).max() < 1.001e-3 * 7


def test_a_meeting_long_after_does_not_stretch_the_axis_of_time(root):
    summary = summarise_columns(finished(root))
    figures = {name: figure for name, figure, _ in draw_columns(finished(root), summary)}
    axes = [ax for ax in figures["wave"].axes if ax.get_visible()]
    assert [ax.get_title() for ax in axes] == ["state-transition", "bistiffness", "kelvin-voigt", "mujoco"]
    ends = [max(line.get_xdata().max() for line in ax.lines) for ax in axes]
    assert 0.9 * max(ends) < axes[0].get_xlim()[1] <= 1.05 * max(ends)
    late = {"time": np.array([0, 1, 2, 1e6, 1e6 + 1]), "forces": [np.array([0, 1, 0, 0, 1e-4])]}
    assert shown_until(late) == 2


def test_what_the_model_refuses_is_unsolved_and_engines_are_still_beside_their_law(tmp_path, capsys):
    (tmp_path / "c.toml").write_text(
        "solvers = ['kelvin-voigt', 'mujoco', 'hunt-crossley']\n"
        "[column]\nballs = 3\ngap = [0.0, 1e-5]\ne = [0.8, 0.9]\nstiffness_taper = 1.0\narrangement = 'cradle'\n"
    )
    folder = run_sweep(
        load_config(tmp_path / "c.toml"),
        tmp_path / "run",
        isolate=False,
        present=lambda folder, _: present(folder),
    )
    (engine,) = summarise_columns(folder).engines
    assert (engine["solver"], engine["n"]) == ("mujoco", 4)
    assert main(["table", str(tmp_path / "run")]) == 0
    shown = capsys.readouterr().out
    for name in ("kelvin-voigt", "mujoco", "hunt-crossley"):
        (row,) = re.findall(rf"^\S+ +{name} +(\d+) .* (\d+)$", shown, flags=re.MULTILINE)
        assert row == ("2", "2")


def test_nothing_compared_is_said_in_whole_numbers(tmp_path, capsys):
    (tmp_path / "c.toml").write_text(
        "solvers = ['mujoco']\n[column]\nballs = 3\nexponent = 1.5\ne = 0.9\narrangement = ['drop', 'stack']\n"
    )
    run_sweep(
        load_config(tmp_path / "c.toml"),
        tmp_path / "run",
        isolate=False,
        present=lambda folder, _: present(folder),
    )
    assert main(["table", str(tmp_path / "run")]) == 0
    assert re.search(r"^kelvin-voigt +mujoco +0 .* 6$", capsys.readouterr().out, flags=re.MULTILINE)


@pytest.mark.slow
def test_it_is_shown_again_and_written_again(root, capsys):
    before = {name: (root / name).read_bytes() for name in ("summary.md", "summary.csv", "report.html")}
    pictures = {name: (root / f"figures/{name}.png").read_bytes() for name in FIGURES}
    assert main(["table", str(root)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"kelvin-voigt +kelvin-voigt +24 ", shown)
    assert "mujoco: unrepresentable in 12: exponent = 1.5" in shown
    assert main(["figures", str(root)]) == 0
    assert main(["report", str(root)]) == 0
    assert {name: (root / name).read_bytes() for name in before} == before
    assert {name: (root / f"figures/{name}.png").read_bytes() for name in FIGURES} == pictures


@pytest.mark.parametrize("command", [["doctor"], ["export-scene", "--cell", "0"]])
def test_what_is_for_two_balls_refuses_it(root, command, capsys):
    assert main([command[0], str(root), *command[1:]]) == 2
    error = capsys.readouterr().err
    assert "columns of N balls; legal: " in error
    assert error.count("\n") == 1


def test_the_ladder_is_shown_of_the_run_of_a_column_and_by_way_of_a_law(root, capsys):
    ladder = pq.read_table(root / "ladder.parquet").to_pandas()
    ok = ladder[ladder.status == "ok"]
    assert (len(ladder), len(ok)) == (24, 12)
    assert main(["ladder", str(root)]) == 0
    shown = capsys.readouterr().out
    # Shares of a region are sums over it.
    for name, of in (("all", ok), ("arrangement = drop", ok[ok.arrangement == "drop"])):
        mean = of.velocity_divergence.mean()
        share = (of.frozen_positions_share * of.velocity_divergence).sum() / of.velocity_divergence.sum()
        row = re.search(rf"mujoco +{name} +{len(of)} +(\S+) +(\S+) %", shown)
        assert float(row[1]) == pytest.approx(mean, rel=5e-3)
        assert float(row[2]) == pytest.approx(100 * share, abs=0.051)
    assert "two switches between the model" in " ".join(shown.split())
    assert main(["ladder", str(root), "--cell", "0", "--law", "hunt-crossley"]) == 0
    shown = capsys.readouterr().out
    assert "cell 0: balls = 2, arrangement = cradle" in shown
    assert re.search(r"cause +dv1/\|v0\| +dv2/\|v0\| +kinetic norm", shown)
    assert "choice of the dashpot" in shown
    assert main(["ladder", str(root), "--cell", "2"]) == 0
    assert "mujoco: unrepresentable: mujoco: exponent = 1.5" in capsys.readouterr().out
    assert main(["ladder", str(root), "--law", "kelvin-voigt-anchored"]) == 2
    assert "legal: kelvin-voigt, kelvin-voigt-textbook, hunt-crossley" in capsys.readouterr().err


def test_a_search_and_an_examination_of_columns_are_refused(root, tmp_path, capsys):
    file = str(root.parent / "c.toml")
    for command in (["search", file, "--out", str(tmp_path / "a")], ["doctor", file]):
        assert main(command) == 2
        error = capsys.readouterr().err
        assert "columns of N balls" in error or "search and column are given" in error
        assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_who_keeps_more_energy_is_a_finding_of_the_run(root):
    rows = pq.read_table(root / "divergence.parquet").to_pandas()
    median = rows[(rows.solver == "mujoco") & rows.marked.isna()].dretained_energy.median()
    page = (root / "report.html").read_text(encoding="utf-8")
    more = f"{abs(100 * median):.1f} % of the kinetic energy before the collision {'more' if median > 0 else 'less'}"
    assert f"mujoco keeps {more} than the model in the median of " in page
    assert "Above zero a solver" not in page.partition("Who keeps more energy?")[2].partition("<figure")[0]
