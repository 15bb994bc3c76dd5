"""The hypothesis for a single collision of a user, compared with computations by hand; the output of the command."""

import math

import numpy as np
import pytest

from impact_xval import Collision, get_solver, solve
from impact_xval.compliant_baselines.restitution import damping_ratio, restitution
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.hypothesis.own import judge_own_pair, load_own_collision, own_pair_blocks
from impact_xval.plugins import Settings

PAIR = "hypothesis --mass-ratio 2 --e1 0.8 --e2 0.6"


def _laws(own):
    return {law.solver: law for law in own.laws if not law.keeps_dashpots}


def _laws_with_kept_dashpots(own):
    return {law.solver: law for law in own.laws if law.keeps_dashpots}


def test_a_stiff_table_is_joined_by_the_model_and_d_is_that_of_a_hand_computation():
    """With a stiff table D is that of a computation by hand: the welded pair ends with v = (e1 |v0|, 0)."""
    collision = Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e9, e1=0.8, e2=0.6, v0=-3.0)
    own = judge_own_pair(collision)
    assert (own.contact, own.contrast, own.meets, own.bodies) == (1, 1e3, False, "ball 2 and the table")
    at_hand = solve(collision, stiffness_ratio_cutoff=math.inf)
    by_hand = math.hypot(at_hand.v1 - 0.8 * 3, math.sqrt(2) * at_hand.v2) / 3
    model = _laws(own)["state-transition"]
    assert model.distances[0] == pytest.approx(by_hand, rel=1e-9)
    assert model.as_one == "yes"
    assert model.verdict == "supported"
    assert model.trend.startswith("D falls as contrast^-")


def test_bodies_that_meet_first_keep_energy_that_welding_removes():
    """Infinitely stiff elastic balls rebound from each other before the table acts: they are not one body.

    With equal masses ball 1 stops, ball 2 is thrown back by the table, and the balls exchange velocities again: v = (1,
    0). The welded pair goes back with half the momentum each: v = (1/2, 1/2). So D = sqrt(1/4 + 1/4), which is compared
    to 5 %.
    """
    own = judge_own_pair(Collision.two_balls(m1=1.0, m2=1.0, k1=1e9, k2=1e6, e1=1.0, e2=1.0, v0=-1.0))
    assert (own.contact, own.contrast, own.meets, own.bodies) == (0, 1e3, True, "ball 1 and ball 2")
    for solver in ("bistiffness", "kelvin-voigt"):  # with e = 1 both laws are springs only
        law = _laws(own)[solver]
        assert (law.as_one, law.verdict) == ("no", "refuted")
        assert law.distances[-1] == pytest.approx(math.sqrt(0.5), rel=0.05)


def test_the_command_judges_a_pair_given_by_ratios_and_writes_nothing(tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = command(f"{PAIR} --stiffness-ratio 40")
    assert said.startswith("Contact 2, between ball 2 and the table, is 40 times as stiff as any other;")
    assert "D at 40 (yours)" in said
    for law in (
        "the model",
        "exact bistiffness",
        "exact Kelvin-Voigt",
        "exact Hunt-Crossley",
        "kelvin-voigt-anchored",
    ):
        assert f"\n{law} " in said, law
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_masses_and_stiffnesses_is_the_same_collision_as_options(tmp_path, command):
    file = tmp_path / "pair.toml"
    file.write_text("masses = [2.0, 4.0]\nstiffnesses = [1e5, 4e6]\nrestitutions = [0.8, 0.6]\n")
    assert command(["hypothesis", file]) == command(f"{PAIR} --stiffness-ratio 40 --m1 2 --k1 1e5")
    file.write_text("masses = [1.0, 2.0, 0.5]\nstiffnesses = [1e6, 1e8, 2e6]\nvelocities = [-1.0, -1.0, 0.0]")
    collision, stiff = load_own_collision(file)
    assert collision == Collision((1.0, 2.0, 0.5), (1e6, 1e8, 2e6), (0.9,) * 3, (-1.0, -1.0, 0.0), table=True)
    assert stiff is None
    assert "between ball 2 and ball 3, is 50 times as stiff" in command(["hypothesis", file])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("masses = [1.0]\nstiffnesses = [1e5]", ["masses", "numbers > 0 (kg)"]),
        ("masses = [1.0, -1.0]\nstiffnesses = [1e5, 1e6]", ["masses", "-1"]),
        ("masses = [1.0, 1.0]", ["stiffnesses is missing; legal: ", "one a contact"]),
        ("masses = [1.0, 1.0]\nstiffnesses = [1e5, 1e6]\nstiff = 3", ["stiff = 3", "from 1 to 2"]),
        (
            "masses = [1.0, 1.0]\nstiffnesses = [1e6, 1e6]",
            ["contact 1", "is 1; legal: a contact more than 1"],
        ),
        ("masses = [1.0, 1.0]\nstiffnesses = [1e5]", ["one contact", "nothing is left"]),
        (
            "masses = [1.0, 1.0]\nstiffnesses = [1e5, 1e6]\nvelocity = [-1.0, 0.0]",
            ["velocity", "unknown key", "did you mean 'velocities'"],
        ),
    ],
)
def test_a_wrong_collision_is_one_line(text, says, tmp_path, refused):
    file = tmp_path / "pair.toml"
    file.write_text(text)
    refused(["hypothesis", file], *says)


def test_contradictory_options_are_refused_in_one_line(tmp_path, refused):
    refused(f"{PAIR} --stiffness-ratio inf", "contact 2", "legal: a contact more than 1")
    out = ["--out", tmp_path / "a"]
    refused([*PAIR.split(), "--stiffness-ratio", "40", *out], "--out = ", "no file is written")
    refused(f"{PAIR} --stiffness-ratio 40 --workers 2", "--workers = 2", "no file is written")
    refused(f"{PAIR}", "--stiffness-ratio missing")
    file = tmp_path / "h.toml"
    file.write_text("points = 6")
    refused(
        ["hypothesis", file, "--e1", "0.9"], "h.toml and --e1 are given", "a file, or a collision by options"
    )
    assert load_own_collision(file) is None


def test_a_longer_chain_is_solved_by_the_laws_for_any_number_of_balls():
    own = judge_own_pair(
        Collision((1.0, 2.0, 1.0, 3.0), (1e6, 5e8, 2e6), (0.9,) * 3, (-1.0, 0.0, 0.0, 0.0), table=False)
    )
    assert (own.contact, own.contrast, own.meets) == (1, 250.0, False)
    assert set(_laws(own)) == {"state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-textbook"}
    assert all(np.isfinite(law.distances).all() for law in own.laws)
    assert _laws(own)["bistiffness"].as_one == "yes"
    assert "Welded, they are one body of 3 kg" in next(iter(own_pair_blocks(own)))


def test_a_contact_that_is_named_is_the_one_in_question():
    pair = Collision.two_balls(m1=1.0, m2=1.0, k1=1e6, k2=1e8, e1=0.9, e2=0.9, v0=-1.0)
    with pytest.raises(UserError, match=r"contact 1: .* is 0\.01; legal"):
        judge_own_pair(pair, 0)


@pytest.mark.parametrize("law", ["kelvin-voigt", "kelvin-voigt-textbook", "compression-dashpot"])
def test_a_law_with_dashpots_has_a_second_verdict_in_which_they_are_kept(law):
    """With a stiff table D falls as 1/contrast if the dashpot of ball on ball is kept, and not with the same e.

    Where the table holds ball 2, the reduced mass of ball on ball is m1, and not m1 m2/(m1 + m2). A welded collision
    with any other dashpot has another final velocity of ball 1, so that D would not fall.
    """
    own = judge_own_pair(Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e8, e1=0.8, e2=0.6, v0=-1.0))
    assert _laws(own)[law].verdict == "refuted"
    assert _laws(own)[law].offset > 0.02
    kept = _laws_with_kept_dashpots(own)[law]
    assert kept.verdict == "supported"
    assert kept.rate == pytest.approx(1, abs=0.1)
    assert kept.distances[-1] < 1e-4
    assert kept.name.endswith(", dashpots kept")


def test_only_dashpots_that_welding_changes_have_a_second_verdict():
    lossy = Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e8, e1=0.8, e2=0.6, v0=-1.0)
    kept = {"kelvin-voigt", "kelvin-voigt-textbook", "compression-dashpot", "linear-dashpot"}
    assert set(_laws_with_kept_dashpots(judge_own_pair(lossy))) == kept
    elastic = Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e8, e1=1.0, e2=0.6, v0=-1.0)
    assert not _laws_with_kept_dashpots(judge_own_pair(elastic))
    plastic = Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e8, e1=0.0, e2=0.6, v0=-1.0)
    assert not _laws_with_kept_dashpots(judge_own_pair(plastic))


def test_dashpots_that_welding_does_not_change_have_no_second_verdict():
    masses, velocities = (1.0, 2.0, 0.5, 1.0), (-1.0, -1.0, 0.0, 0.0)
    row = Collision(masses, (1e8, 1e6, 1e6), (0.9, 1.0, 0.7), velocities, table=False)
    assert not _laws_with_kept_dashpots(judge_own_pair(row))


def test_a_strong_dashpot_is_judged_where_the_stiff_contact_is_quicker():
    """D first stays at 0.3 as if the lower ball were free, falls, and goes to the D of the welded collision.

    For e1 = 0.02 the dashpot in compression has 2 zeta = 50. D falls at contrasts around 2500, until 1e5. An
    integration by matrix exponentials gave D = 0.00447 at 1e5 and 1e6 with the same e.
    """
    own = judge_own_pair(Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e8, e1=0.02, e2=0.5, v0=-1.0))
    same_e = _laws(own)["compression-dashpot"]
    assert same_e.verdict == "refuted"
    assert same_e.offset == pytest.approx(0.00447, rel=0.01)
    kept = _laws_with_kept_dashpots(own)["compression-dashpot"]
    assert kept.verdict == "supported"
    assert kept.rate == pytest.approx(1, abs=0.1)


def test_a_dashpot_that_is_too_strong_to_be_overtaken_has_no_verdict():
    own = judge_own_pair(Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e8, e1=3e-4, e2=0.5, v0=-1.0))
    for laws in (_laws(own), _laws_with_kept_dashpots(own)):
        verdict = laws["compression-dashpot"]
        assert verdict.trend.startswith("undecided: damping this strong needs contrasts up to ")


def test_a_welded_collision_in_which_nothing_meets_is_refused():
    with pytest.raises(UserError, match=r"contact 1, with its two bodies welded: .* nothing meets"):
        judge_own_pair(Collision((1, 1, 1), (1e8, 1e6), (0.9, 0.9), (-1, 1, 0), table=False))


def test_a_contact_that_may_pull_lets_go_of_a_stiff_table():
    """A ball that is pulled leaves a table however stiff, so no dashpot makes it a part of the table.

    The contact of ball on ball pulls ball 2 up before it ends. The contact with the table ends at depth 0, which an
    infinitely stiff contact reaches as soon as it is pulled. So ball 2 leaves the table with a velocity, with the same
    dashpot too.
    """
    own = judge_own_pair(Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=1e8, e1=0.5, e2=0.6, v0=-1.0))
    kept = _laws_with_kept_dashpots(own)["linear-dashpot"]
    assert kept.verdict == "refuted"
    # Ball 2 at rest until the force of ball on ball is 0, then a free damped pair until their depth is 0.
    assert kept.offset == pytest.approx(0.026174, rel=1e-3)


def _reduced_mass(masses, contact):
    """Return the reduced mass of the two bodies of a contact; the last contact is with the table."""
    return 1 / (1 / masses[contact] + sum(1 / m for m in masses[contact + 1 : contact + 2]))


def test_dashpots_that_are_kept_make_the_stiff_pair_one_body():
    """Balls 2 and 3 rest on a table with a stiff contact between them, and Kelvin-Voigt contacts lose energy.

    Welded with the same e, the other contacts have other dashpots, and D does not fall. Welded with the same dashpots
    (c in N s/m), D falls about in inverse proportion to the contrast.
    """
    solver, settings = get_solver("kelvin-voigt"), Settings(mark=False)
    rng = np.random.default_rng(5)
    for _ in range(6):
        masses, e = np.exp(rng.uniform(-0.7, 0.7, 3)), rng.uniform(0.55, 0.97, 3)
        stiffnesses = 1e6 * np.exp(rng.uniform(-1, 1, 3))
        welded = np.array([masses[0], masses[1] + masses[2]])
        growth = [_reduced_mass(masses, i) / _reduced_mass(welded, j) for i, j in ((0, 0), (2, 1))]
        kept = [restitution(damping_ratio(e[i]) * np.sqrt(x)) for i, x in zip((0, 2), growth, strict=True)]
        distances = []
        for contrast in (1e2, 1e4, 1e6):
            stiffnesses[1] = contrast * max(stiffnesses[0], stiffnesses[2])
            apart = Collision(masses, stiffnesses, e, (-1, 0, 0), table=True)
            v = np.array(solver.solve(apart, settings).velocities)
            row = []
            for its_e in (e[[0, 2]], kept):
                united = Collision(welded, stiffnesses[[0, 2]], its_e, (-1, 0), table=True)
                w = np.array(solver.solve(united, settings).velocities)[[0, 1, 1]]
                row.append(float(np.sqrt(masses @ (v - w) ** 2 / masses[0])))
            distances.append(row)
        same_e, same_c = np.transpose(distances)
        apart = Collision(masses, stiffnesses, e, (-1, 0, 0), table=True)
        verdict = _laws_with_kept_dashpots(judge_own_pair(apart, 1))["kelvin-voigt"]
        assert verdict.verdict == "supported"
        assert verdict.distances[0] == pytest.approx(same_c[-1], rel=1e-6)
        assert same_e[-1] > 0.005
        assert same_e[-1] == pytest.approx(same_e[-2], rel=1e-2)
        # The stiff contact oscillates, and D depends on its phase too.
        assert math.log(same_c[0] / same_c[-1], 1e4) == pytest.approx(1, abs=0.1)
