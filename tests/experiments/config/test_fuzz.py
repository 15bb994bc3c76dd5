"""A hundred configurations and twenty folders, spoiled at random: one line, exit code 2, nothing lost.

The mutations are random, from a fixed seed, and each is illegal by construction: a value of the wrong kind or
range, an unknown key, a table for a number, broken TOML.
"""

import json
import random
import shutil
import time
import tracemalloc

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import load_config, parse_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes
from tests.experiments.conftest import SMALL

#: What no value of a field may be, by the field.
ILLEGAL = {
    "scenario": ["'Drop'", "1", "true", "['drop']"],
    "gravity": ["0", "-9.81", "nan", "inf", "'9.81'", "true", "[9.81]"],
    "m1": ["0.0", "-1", "nan", "inf", "'one'", "false", "{}"],
    "k1": ["0", "-1e8", "inf", "nan", "1979-05-27", "''"],
    "v0": ["0", "0.0", "1", "-inf", "nan", "true"],
    "solvers": ["[]", "['mujoco', 'mujoco']", "[['mujoco']]", "['MuJoCo']", "{mujoco = 1}", "true"],
    "step_fraction": ["0", "0.11", "-1e-3", "nan", "inf", "'1e-3'"],
    "max_steps": ["0", "-1", "1.5", "1e6", "true", "10_000_000_000_000"],
    "shortest_state": ["-1e-3", "0.2", "'3'", "inf"],
    "mapping": ["'Naive'", "1", "[]"],
    "stiffness_ratio_cutoff": ["1", "0", "-1e5", "nan", "true"],
    "grazing_threshold": ["-1e-9", "1.1", "nan", "inf", "'0'"],
    "chunk_size": ["0", "100001", "16.0", "true", "-16"],
    "cell_timeout": ["0", "-1", "inf", "nan", "'5 s'", "2e6"],
    "workers": ["0", "5000", "2.0", "'2'", "true"],
    "name": ["''", "'   '", "1", '"a\\u0000b"', "[]"],
    "cells": ["''", "1", "['a.csv']", "'no-such.csv'"],
    "grid": ["1", "[]", "'grid'"],
    "sample": ["1", "[]", "'sobol'", "true"],
    "search": ["1", "[]", "'mujoco'"],
    "figure_cell": ["1", "[1, 1, 0.9, 0.7]"],
    "column": ["1", "[]", "'cradle'"],
}
TABLES = {
    "grid": {
        "stiffness_ratio": [
            "[-1]",
            "[nan]",
            "{log = [0, 1, 3]}",
            "{log = [1, 10]}",
            "1.0",
            "['1']",
            "[true]",
        ],
        "mass_ratio": ["[0]", "[inf]", "[-2.0]", "{linear = [2, 1, 3]}", "{log = [1, inf, 3]}", "[[1]]"],
        "e1": ["[1.1]", "[-0.1]", "[0.5, 0.5]", "{linear = [0, 1, 1]}", "{cubic = [0, 1, 3]}", "[]", "{}"],
        "e2": ["[nan]", "{linear = [0, 1, 3.5]}", "{linear = [0, 1, 3], log = [0.1, 1, 3]}", "0.7"],
        "e3": ["[0.5]"],
    },
    "sample": {
        "method": ["'Sobol'", "1", "[]"],
        "n": ["0", "-5", "1e3", "true", "100_000_000"],
        "seed": ["-1", "0.5", "'now'"],
        "stiffness_ratio": ["-1", "nan", "[1, 2]", "{log = [0, 1]}", "{log = [2, 1]}", "{linear = [0, inf]}"],
        "mass_ratio": ["0", "inf", "{linear = [0, 1]}", "{log = [1, 2, 3]}", "'any'"],
        "e1": ["1.5", "true", "{linear = [0.5, 1.5]}", "{}"],
        "e4": ["1"],
    },
    "column": {
        "arrangement": ["'pile'", "1", "[]", "['drop', 'drop']", "[['drop']]", "{}"],
        "balls": ["0", "1001", "2.5", "true", "'two'", "[]", "{linear = [2, 5, 3]}", "inf", "nan"],
        "strike": ["0", "'one'", "1000", "[[1]]"],
        "e": ["1.5", "nan", "{linear = [0, 1]}", "[0.5, 0.5]", "{}"],
        "gap": ["-1", "inf", "nan", "'wide'"],
        "mass_taper": ["0", "-1", "inf", "{log = [0, 1, 3]}", "1e300"],
        "exponent": ["0.9", "3.1", "'hertz'"],
        "e6": ["1"],
    },
    "search": {
        "solver": ["'state-transition'", "'none'", "1"],
        "measure": ["'D'", "1"],
        "population": ["7", "1e9", "'many'"],
        "generations": ["0", "-1", "1.5"],
        "e2": ["2", "{log = [0, 1]}"],
    },
    "figure_cell": {
        "stiffness_ratio": ["-1", "nan", "'inf'", "[1]"],
        "mass_ratio": ["0", "inf", "true"],
        "e1": ["1.01", "'0.9'"],
        "e5": ["0"],
    },
}


def _cases(count):
    rng = random.Random(2026)
    for _ in range(count):
        kind = rng.random()
        if kind < 0.4:
            field = rng.choice(sorted(ILLEGAL))
            yield f"{field} = {rng.choice(ILLEGAL[field])}\n", field
        elif kind < 0.75:
            table = rng.choice(sorted(TABLES))
            field = rng.choice(sorted(TABLES[table]))
            yield f"[{table}]\n{field} = {rng.choice(TABLES[table][field])}\n", table
        elif kind < 0.85:
            word = "".join(rng.choices("abcdefghij-_", k=rng.randint(1, 12))) + "q"
            yield f'"{word}" = {rng.choice(["1", "true", "[]", "{}", "nan"])}\n', word
        elif kind < 0.95:
            text = 'name = "x"\ngravity = 9.81\n[grid]\ne1 = [0.5, 0.7]\n'
            place = rng.randrange(len(text))
            yield text[:place] + rng.choice(['"""', "[[", "= =", "\x00", "}", "\u2028="]) + text[place:], ""
        else:
            yield bytes(rng.randrange(128, 256) for _ in range(40)), ""


@pytest.mark.parametrize("case", list(_cases(100)), ids=range(100))
def test_a_spoiled_configuration_is_one_line(case, tmp_path, capsys):
    text, named = case
    path = tmp_path / "c.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("impact-xval: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    assert len(captured.err) < 2000
    assert named in captured.err
    assert [each.name for each in tmp_path.iterdir()] == ["c.toml"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (".".join("a" * 20_000) + " = 1", "a key of 20000 parts; legal: at most 8"),
        ("[" + ".".join("a" * 20_000) + "]", "a key of 20000 parts; legal: at most 8"),
        ("x = {" + " . ".join(["'a.b'", '"c"'] * 5_000) + " = 1}", "a key of 10000 parts; legal: at most 8"),
        ("name = 'x'\n" + "#" * 1_000_000, "larger than 1000000 bytes; legal: at most that"),
        ("\u00e4" * 500_001, "larger than 1000000 bytes; legal: at most that"),
        ("x = " + "[" * 200_000, "nested too deeply"),
        ("".join(f"a{i}.b.c.d.e.f.g.h = 1\n" for i in range(2_000)), "unknown key"),
        ('"' + '\\"' * 50_000, "not TOML"),
        ('"""' + '\\"' * 50_000 + "\\", "not TOML"),
    ],
    ids=range(9),
)
def test_a_file_that_would_take_the_memory_is_one_line(text, says, tmp_path, capsys):
    path = tmp_path / "c.toml"
    path.write_text(text)
    start = time.perf_counter()
    tracemalloc.start()
    try:
        assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    error = capsys.readouterr().err
    assert f"{path}: " in error
    assert says in error
    assert error.count("\n") == 1
    assert len(error) < 2000
    assert peak < 5e8
    assert time.perf_counter() - start < 30


def test_dots_in_texts_and_numbers_are_no_keys(tmp_path):
    path = tmp_path / "c.toml"
    dots = ".".join("a" * 50)
    path.write_text(
        f'name = \'{dots}\' # {dots}\ncells = "{dots}\\""\ngravity = 9.5\n[figure_cell]\nstiffness_ratio = 1.5\n'
    )
    assert load_config(path).name == dots


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    root = tmp_path_factory.mktemp("finished") / "run"
    run_sweep(parse_config(SMALL), root, isolate=False, resolve=fakes.shifted)
    return root


READERS = {
    "manifest.json": ["table", "figures", "report", "status"],
    "cells.parquet": ["table", "report"],
    "divergence.parquet": ["table", "report", "figures"],
    "curves.parquet": ["figures"],
}


@pytest.mark.parametrize("seed", range(20))
def test_a_spoiled_folder_is_one_line_and_is_left_as_it_is(seed, tmp_path, finished, capsys):
    rng = random.Random(seed)
    root = tmp_path / "run"
    shutil.copytree(finished, root)
    name = list(READERS)[seed % len(READERS)]
    path = root / name
    data = path.read_bytes()
    kind = rng.choice(["cut", "flip", "empty", "gone", "other", "folder"])
    if kind == "cut":
        path.write_bytes(data[: rng.randrange(1, len(data) - 1)])
    elif kind == "flip":
        place = rng.randrange(len(data)) if name != "manifest.json" else data.index(b"format")
        path.write_bytes(data[:place] + bytes([data[place] ^ (1 << rng.randrange(7))]) + data[place + 1 :])
    elif kind == "empty":
        path.write_bytes(b"")
    else:
        path.unlink()
        if kind == "other":
            path.write_bytes(b'{"format": 7}' if name == "manifest.json" else b"cell,solver\n1,2\n")
        elif kind == "folder":
            path.mkdir()
    before = {each: each.read_bytes() for each in sorted(root.rglob("*")) if each.is_file()}
    command = rng.choice(READERS[name])
    assert main([command, str(root)]) == 2, (kind, name, command)
    captured = capsys.readouterr()
    assert captured.err.startswith("impact-xval: "), captured.err
    assert captured.err.count("\n") == 1
    assert str(root) in captured.err
    assert "Traceback" not in captured.err
    assert {each: each.read_bytes() for each in sorted(root.rglob("*")) if each.is_file()} == before


@pytest.mark.parametrize(
    "spoil",
    [
        {"configuration": None},
        {"configuration": {"m1": -1}},
        {"configuration": {"grid": {"e1": [7]}}},
        {"configuration": []},
        {"configuration": parse_config(SMALL | {"solvers": ["kelvin-voigt"]}).canonical()},
        {"cells": None, "state": "running"},
        {"chunks": "3", "state": "running"},
    ],
)
def test_a_manifest_with_other_values_is_one_line(spoil, tmp_path, finished, capsys):
    root = tmp_path / "run"
    shutil.copytree(finished, root)
    manifest = json.loads((root / "manifest.json").read_text()) | spoil
    (root / "manifest.json").write_text(json.dumps(manifest))
    command = "status" if "state" in spoil else "table"
    assert main([command, str(root)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "manifest.json" in error
