"""What a file may hold, and the line for each value that it may not."""

import math

import numpy as np
import pandas as pd
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.fit.trials import NoTrialsError, read_trials, trials_of
from tests.experiments.fit.planted import table, trials

GOOD = trials("poisson", [0.5, 0.7], [0.5, 1.0, 2.0])


def spoiled(column, value, row=1):
    frame = GOOD.astype(object)
    frame.loc[row, column] = value
    return frame


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("m1 [kg]", 0, "m1 [kg] = 0; legal: a number from 1e-30 to 1e30"),
        ("m2 [kg]", "heavy", "m2 [kg] = 'heavy'; legal: a number from 1e-30 to 1e30"),
        ("m2 [kg]", 5000, "m2 [kg] = 5000; legal: m2/m1 from 0.001 to 1000"),
        ("v1_before [m/s]", 1.0, "v1_before [m/s] = 1.0; legal: a number from -1e30 to -1e-30: ball 1 falls"),
        ("v1_after [m/s]", "", "v1_after [m/s] = missing; legal: a number from -1e30 to 1e30"),
        ("v1_after [m/s]", math.nan, "v1_after [m/s] = missing; legal: a number from -1e30 to 1e30"),
        ("v1_after [m/s]", math.inf, "v1_after [m/s] = inf; legal: a number from -1e30 to 1e30"),
        ("sd_v1_after [m/s]", 0.0, "sd_v1_after [m/s] = 0.0; legal: a number from 1e-30 to 1e30"),
        ("v1_after [m/s]", 2.0, "v1_after [m/s] = 2 m/s: 4.04 of the energy before; legal: at most 1.12, 3 "),
        (
            "v1_after [m/s]",
            0.1,
            "v1_after [m/s] = 0.1 m/s; legal: at least 0.1576, 3 standard errors through",
        ),
        ("v1_before [m/s]", -1e-200, "v1_before [m/s] = -1e-200; legal: a number from -1e30 to -1e-30"),
        ("m2 [kg]", "0_1", "m2 [kg] = '0_1'; legal: a number from 1e-30 to 1e30"),
        ("v2_after [m/s]", -0.1, "v2_after [m/s] = -0.1; legal: at least -0.03, 3 standard errors into"),
    ],
)
def test_what_is_impossible_has_a_line_and_its_row_is_left_out(column, value, says):
    found = trials_of(spoiled(column, value))
    assert found.left_out == 1
    assert found.rows.tolist() == [1, 3]
    assert any(line.startswith(f"row 2, {says}") for line in found.problems), found.problems


@pytest.mark.parametrize("shift", [2.9, 3.1])
def test_three_standard_errors_are_the_limit(shift):
    frame = table([1.0, 1.0], [0.5, 0.5], [0.2, -0.01 * shift])
    assert trials_of(frame).left_out == (shift > 3)


def test_the_unit_of_a_header_is_checked():
    with pytest.raises(UserError, match=r"column 'm1 \[g\]': another unit; legal: 'm1 \[kg\]'"):
        trials_of(GOOD.rename(columns={"m1 [kg]": "m1 [g]"}))
    with pytest.raises(UserError, match=r"column 'm2 \[kg\]': missing"):
        trials_of(GOOD.drop(columns="m2 [kg]"))


def test_heights_become_velocities():
    frame = pd.DataFrame(
        {
            "m1 [kg]": [1.0],
            "m2 [kg]": [2.0],
            "drop_height [m]": [0.5],
            "rebound1_height [m]": [0.08],
            "sd_rebound1_height [m]": [0.002],
        }
    )
    found = trials_of(frame)
    assert found.v1[0] == pytest.approx(math.sqrt(0.08 / 0.5))
    # The change of sqrt(2 g h) between both ends of the standard error, halved.
    change = (math.sqrt(2 * 9.81 * 0.082) - math.sqrt(2 * 9.81 * 0.078)) / 2
    assert found.sd1[0] * found.speed[0] == pytest.approx(change, rel=1e-3)
    assert found.measured == 1


def test_what_is_known_is_shared_by_all_rows():
    frame = GOOD.assign(e1=[0.5, 0.6, 0.5])
    frame["k1 [N/m]"], frame["k2 [N/m]"] = 1e4, 1e5
    found = trials_of(frame)
    assert found.known == {"e1": 0.5, "log_k": pytest.approx(1.0)}
    assert found.rows.tolist() == [1, 3]
    assert found.problems[0].startswith("row 2, e1 = 0.6; legal: 0.5, as most rows have")


def test_one_wrong_value_of_what_is_known_costs_its_own_row():
    assert trials_of(GOOD.assign(e1=[0.05, 0.5, 0.5])).rows.tolist() == [2, 3]
    stiff = trials_of(GOOD.assign(**{"k1 [N/m]": 1.0, "k2 [N/m]": [1e5, 1e3, ""]}))
    assert stiff.problems == ("row 1, k2 [N/m] = 100000; legal: k2/k1 from 1e-4 to 1e4",)


HEIGHTS = pd.DataFrame(
    {
        "m1 [kg]": [1.0],
        "m2 [kg]": [2.0],
        "drop_height [m]": [0.5],
        "rebound1_height [m]": [0.08],
        "sd_rebound1_height [m]": [0.002],
        "rebound2_height [m]": [0.0],
        "sd_rebound2_height [m]": [0.002],
    }
)


def test_a_ball_that_stays_down_has_a_height_of_zero():
    """Its velocity is at most that of a height of one standard error."""
    found = trials_of(HEIGHTS)
    assert found.v2[0] == 0
    assert found.sd2[0] == pytest.approx(math.sqrt(0.002 / 0.5))
    higher = trials_of(HEIGHTS.assign(**{"rebound2_height [m]": [0.0005]}))
    assert higher.sd2[0] == pytest.approx(found.sd2[0])


@pytest.mark.parametrize("name", ["v2_after [m/s]", "v1_before [m/s]"])
def test_heights_and_velocities_are_not_mixed(name):
    assert trials_of(HEIGHTS.assign(**{name: ""})).heights
    with pytest.raises(UserError, match="legal: velocities or heights, not both"):
        trials_of(HEIGHTS.assign(**{name: -9.0}))
    with pytest.raises(UserError, match=r"'sd_drop_height \[m\]': beside 'v1_after"):
        trials_of(GOOD.assign(**{"sd_drop_height [m]": 0.1}))


def test_too_high_a_rebound_is_named_as_a_velocity():
    (line,) = trials_of(pd.concat([HEIGHTS, HEIGHTS.assign(**{"rebound1_height [m]": 0.9})])).problems
    assert line.startswith("row 2, velocity of rebound1_height [m] = 4.20214 m/s: 1.8 of the energy before")


def test_a_row_that_begins_with_a_hash_is_left_out_and_said(tmp_path):
    text = "# above\ntrial," + GOOD.to_csv(index=False).replace("\n0.5", "\n#1,0.5", 1).replace(
        "\n0.5", "\na,0.5"
    )
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    found = trials_of(read_trials(tmp_path / "a.csv"))
    assert found.rows.tolist() == [2, 3]
    assert found.problems == ("row 1, '#1': begins with #, so it is a comment",)


def test_a_table_is_the_same_from_csv_and_parquet(tmp_path):
    text = "# a comment\n" + GOOD.to_csv(index=False)
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    GOOD.to_parquet(tmp_path / "a.parquet")
    one, other = (trials_of(read_trials(tmp_path / f"a.{suffix}")) for suffix in ("csv", "parquet"))
    assert np.array_equal(one.v1, other.v1)
    assert one.groups == other.groups


def test_no_row_left_names_every_value(tmp_path, capsys):
    with pytest.raises(NoTrialsError) as caught:
        trials_of(GOOD.assign(**{"sd_v1_after [m/s]": 0}))
    assert len(caught.value.problems) == 3
    file = tmp_path / "bad.csv"
    GOOD.assign(**{"sd_v1_after [m/s]": 0}).to_csv(file, index=False)
    assert main(["fit", str(file), "--out", str(tmp_path / "out")]) == 2
    assert (
        capsys.readouterr().err.count("sd_v1_after [m/s] = '0'; legal") == 6
    )  # a line a row, and the last word
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.txt", b"", "legal: a file that ends in .csv or .parquet"),
        ("a.csv", b"\xff\xfe\x00", "not text in UTF-8"),
        ("a.csv", b"# nothing\n", "not a table: it has no header"),
        ("a.csv", b"trial;m1 [kg];m2 [kg]\na;1;2\n", "its columns are separated by ';'; legal: ','"),
        ("a.csv", b"m1 [kg],m2 [kg]\n1,2\n1,2,3\n", "row 2, fields = 3; legal: 2, as its header"),
        ("a.csv", b"m1 [kg],m2 [kg]\n1\n", "row 1, fields = 1; legal: 2, as its header"),
        ("a.csv", b"m1 [kg],m1 [kg]\n1,2\n", "column 'm1 [kg]': there twice"),
        ("a.parquet", b"nothing", "not a Parquet file"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(name, content, says, tmp_path, capsys):
    (tmp_path / name).write_bytes(content)
    assert main(["fit", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1


def test_known_stiffnesses_are_held_together_from_whichever_rows_they_are():
    frame = table([0.4] * 6, [0.6] * 6, [0.2] * 6)
    frame["k1 [N/m]"], frame["k2 [N/m]"] = [1e-30, None] * 3, [None, 1e30] * 3
    with pytest.raises(
        UserError, match=r"k2 \[N/m\] = 1e\+30, k1 \[N/m\] = 1e-30; legal: k2/k1 from 1e-4 to 1e4"
    ):
        trials_of(frame)
