import json
import math
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.aggregates import between
from impact_xval.experiments.measures.summary import SUMMARISED, summarise
from impact_xval.experiments.presentation.apart import process_apart
from impact_xval.experiments.presentation.figures import draw_divergences, write_figures
from impact_xval.experiments.presentation.page.charts import scripts
from impact_xval.experiments.presentation.report import Apart, write_report, write_tables
from impact_xval.experiments.sweep.curves import CURVES
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox
from impact_xval.experiments.tables.numbers import number
from tests.experiments import fakes
from tests.experiments.conftest import SMALL
from tests.experiments.pages import tables

HOSTILE = "<script>alert(1)</script> 100% of $x_1^2$ & {a} \\input{b} | #1 ~ `c` *d* [e](f)"


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    config = parse_config(SMALL | {"name": HOSTILE, "grazing_threshold": 0.05})
    return run_sweep(
        config, tmp_path_factory.mktemp("hostile") / "run", isolate=False, resolve=fakes.crashing
    )


def test_statistics_are_those_of_the_table(hostile):
    summary = summarise(hostile)
    table = pq.read_table(hostile.root / "divergence.parquet").to_pandas()
    table = table[(table.solver == "mujoco") & table.velocity_divergence.notna()]
    regular = table[~(table.model_grazing_margin < 0.05)]
    assert len(regular) > 0
    for measure in SUMMARISED:
        row = summary.get("mujoco", measure)
        sizes = np.abs(regular[measure].to_numpy(dtype=float))
        assert row.n == len(sizes)
        assert row["median"] == pytest.approx(np.median(sizes))
        assert row.p95 == pytest.approx(np.percentile(sizes, 95))
        assert row["max"] == sizes.max()
        for value, part in regular.groupby("stiffness_ratio"):
            row = summary.get("mujoco", measure, "stiffness_ratio", float(str(value)))
            assert row["max"] == np.abs(part[measure].to_numpy(dtype=float)).max()
    assert summary.get("mujoco", "states_equal")["mean"] == 1
    grazing = summary.get("mujoco", "velocity_divergence", cells="grazing")
    assert grazing.n + len(regular) == len(table)
    assert summary.statuses.loc["mujoco"].to_dict() == {"ok": 6, "crashed": 6, "unavailable": 0}
    assert summary.worst.velocity_divergence.is_monotonic_decreasing


def test_a_solver_without_results_has_no_statistics(hostile):
    row = summarise(hostile).get("pybullet", "velocity_divergence")
    assert row.n == 0
    assert math.isnan(row["median"])


def test_summary_files(hostile):
    write_tables(hostile)
    table = pd.read_csv(hostile.root / "summary.csv")
    assert {"solver", "axis", "value", "measure", "n", "median", "p95", "max"} <= set(table.columns)
    assert set(table.axis) == {"all", "stiffness_ratio", "mass_ratio", "e1", "e2", "stiffness_band"}
    text = (hostile.root / "summary.md").read_text()
    assert "<script>" not in text
    assert (
        "and the share of equal paths. mujoco and pybullet were asked for the same law: one vote, not two._"
        in text
    )
    assert "ZeroDivisionError: a bug of the engine \\| here" in text
    assert "mujoco diverges from the model by D = 0.01 (median)" in text
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        columns = {len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}
        assert len(columns) == 1, block


def test_latex_is_well_formed(hostile):
    write_tables(hostile)
    text = (hostile.root / "summary.tex").read_text()
    assert r"\usepackage{booktabs}" in text
    assert r"\textless{}script\textgreater{}" in text
    body = re.sub(
        r"\\[\\{}$&#_%]", lambda m: r"\\" if m[0] == r"\\" else "x", text.split(r"\begin{document}")[1]
    )
    assert not set(body) & set("$#%~^_")
    assert body.count("{") == body.count("}")
    environments = re.findall(r"\\(begin|end)\{(\w+)\}", text)
    opened = []
    for kind, name in environments:
        opened.append(name) if kind == "begin" else opened.remove(name)
    assert not opened
    for table in re.findall(r"\\begin\{longtable\}.*?\\end\{longtable\}", body, flags=re.DOTALL):
        columns = len(re.findall("[lr]", re.findall(r"\{longtable\}\{([lr]+)\}", table)[0]))
        lines = [line for line in table.splitlines() if line.endswith(r"\\")]
        rows = [line for line in lines if not line.startswith((r"\caption", r"\multicolumn"))]
        assert {line.count("&") for line in rows} == {columns - 1}


class _Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


def test_report_is_one_safe_page(hostile):
    write_figures(hostile)
    page = write_report(hostile).read_text()
    parser = _Tags()
    parser.feed(page)
    names = [tag for tag, _ in parser.tags]
    # Its own scripts, the charts and the cells that open, and no other.
    assert names.count("script") == scripts().count("<script") + 2
    assert HOSTILE in parser.text
    images = [attributes for tag, attributes in parser.tags if tag == "img"]
    assert len(images) >= 5
    assert all(image["src"].startswith("data:image/png;base64,") and image["alt"] for image in images)
    figures = re.findall(r"<figcaption><b>Figure \d+\.</b> (.*?)</figcaption>", page, re.DOTALL)
    assert len(figures) == len(images)
    assert all(len(caption) > 60 for caption in figures)
    bare = re.sub(
        r"<script.*?</script>", "", page, flags=re.DOTALL
    )  # a browser test has what scripts ask for
    assert not re.search(r"(src|href)=[\"']?(https?:|//)", bare)
    captions = json.loads((hostile.root / "figures/captions.json").read_text())
    assert len(captions) == len(images)
    for name in captions:
        assert (hostile.root / "figures" / f"{name}.png").stat().st_size > 5000
        assert (hostile.root / "figures" / f"{name}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.nightly
def test_a_report_of_a_known_summary_is_the_same(hostile):
    write_figures(hostile)
    alone = write_report(hostile).read_bytes()
    assert write_report(hostile, summarise(hostile)).read_bytes() == alone


@pytest.mark.nightly
def test_a_report_brings_no_engine_into_the_process_that_writes_it(hostile):
    code = (
        "import sys; from impact_xval.experiments.commands.cli import main\n"
        f"main(['report', {str(hostile.root)!r}]); print({{'mujoco', 'pybullet'}} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
    page = (hostile.root / "report.html").read_text()
    assert "were examined by impact-xval doctor (mujoco" in page


def test_a_report_says_that_scenes_could_not_be_examined(hostile):
    def died():
        raise FaultError("crashed", "its process died: SIGSEGV")

    page = write_report(hostile, summarise(hostile), Apart(died, died)).read_text()
    assert (
        "Cells do not open here: what is shown of them could not be collected (its process died: SIGSEGV)."
        in page
    )
    assert "were examined by impact-xval doctor, which failed: its process died: SIGSEGV." in page


@pytest.mark.nightly
def test_figures_drawn_by_a_process_of_its_own_are_the_same(hostile, monkeypatch):
    def drawn():
        return {path.name: path.read_bytes() for path in (hostile.root / "figures").glob("*[!f]")}

    def apart():
        shutil.rmtree(hostile.root / "figures")
        with process_apart(hostile) as begin:
            write_figures(hostile, divergences=begin(draw_divergences))
        return drawn()

    write_figures(hostile)
    here = drawn()
    assert len(here) > 5
    assert apart() == here

    def dies(*arguments, **others):
        raise FaultError("crashed", "of nothing")

    with monkeypatch.context() as patched:
        patched.setattr(Sandbox, "call", dies)
        assert apart() == here
    (hostile.root / CURVES).rename(hostile.root / "elsewhere")
    with pytest.raises(UserError, match=CURVES):
        apart()
    (hostile.root / "elsewhere").rename(hostile.root / CURVES)


@pytest.mark.slow
@pytest.mark.parametrize(
    "grid",
    [
        {"stiffness_ratio": [0, float("inf")]},
        {"stiffness_ratio": [0, 1, float("inf")], "mass_ratio": [1.0], "e1": [0.0], "e2": [0.0, 1.0]},
        {"stiffness_ratio": [2.0], "mass_ratio": [1.0], "e1": [0.9], "e2": [0.9]},
    ],
)
def test_odd_grids_have_all_their_figures(grid, tmp_path):
    config = parse_config(SMALL | {"grid": SMALL["grid"] | grid, "grazing_threshold": 0.0})
    folder = run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    assert len(write_figures(folder)) >= 5
    write_tables(folder)
    write_report(folder)


def test_long_axes_are_tabulated_in_part(tmp_path):
    config = parse_config(
        SMALL | {"grid": {"stiffness_ratio": {"log": [0.5, 2, 90]}, "mass_ratio": [1], "e1": [0.9]}}
    )
    folder = run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    by_stiffness = next(
        table for table in tables(summarise(folder)) if table.caption.startswith("D by k2/k1")
    )
    assert len(by_stiffness.rows) <= 40
    assert "of 90 values" in by_stiffness.caption


def test_numbers_for_readers():
    assert [number(x) for x in (1000.0, 0.12345, 1e-5, float("nan"), 2 / 3, float("inf"))] == [
        "1000",
        "0.123",
        "1e-05",
        "-",
        "0.667",
        "inf",
    ]


def test_marked_rows_are_in_no_comparison_of_two_solvers(tmp_path):
    columns = {
        "cell": [0, 0, 0, 1, 1, 1],
        "solver": ["state-transition", "kelvin-voigt", "mujoco"] * 2,
        "status": ["ok"] * 6,
        "marked": [None, None, None, None, "beside a jump", None],
        "v0": [-1.0] * 6,
        "v1": [0.5, 0.5, 0.51, 0.5, 0.5, 0.9],
        "v2": [0.1] * 6,
        "mass_ratio": [1.0] * 6,
    }
    pq.write_table(pa.table(columns), tmp_path / "cells.parquet")
    config = parse_config({"solvers": ["kelvin-voigt", "mujoco"]})
    (row,) = between(tmp_path / "cells.parquet", config).itertuples()
    assert (row.n, row.max) == (1, pytest.approx(0.01))
