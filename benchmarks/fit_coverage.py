"""Whether intervals of `fit` are what they say, it finds the true law, and it knows what it cannot know.

Synthetic experiments: twelve collisions computed by a law with known parameters, with Gaussian errors of 1 % of the
speed of impact added to both velocities. `python -m benchmarks.fit_coverage coverage --experiments 100` prints, for
every law in turn, how many of the 95 % intervals hold the true value; `choice`, how often the true law has the
least AIC among laws that differ from it by more than three standard errors in some trial once both are fitted;
`unknowable`, whether a stiffness ratio beyond 100 and restitutions of 1 are reported as open; `next`, how much the
suggested next experiment shortens the interval of k2/k1, beside one at a random mass ratio.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
import pandas as pd

from impact_xval.experiments.fit.fitting import FitResult, fit
from impact_xval.experiments.fit.laws import LAWS, Floats, Law
from impact_xval.experiments.fit.next_experiment import mass_ratios

ERROR = 0.01
RATIOS = np.geomspace(0.3, 3.0, 12)
#: Restitutions that are planted; k2/k1 within 10^+-1.5.
RESTITUTIONS, STIFFNESS = (0.4, 0.95), 1.5
#: A parameter can be known if its standard error, from the information of the trials, is below this share of its box,
#: and four of them do not reach the end of the box.
IDENTIFIABLE = 0.05


def synthetic(law: Law, point: Floats, ratios: Floats, random: np.random.Generator | None) -> pd.DataFrame:
    """Compute trials by a law, with errors unless there is no generator of them."""
    noise = np.zeros((2, len(ratios))) if random is None else ERROR * random.standard_normal((2, len(ratios)))
    v1, v2 = np.array(law.velocities(point, ratios)) + noise
    return pd.DataFrame(
        {
            "m1 [kg]": 1.0,
            "m2 [kg]": ratios,
            "v1_before [m/s]": -1.0,
            "v1_after [m/s]": v1,
            "v2_after [m/s]": v2,
            "sd_v1_after [m/s]": ERROR,
            "sd_v2_after [m/s]": ERROR,
        }
    )


def information(law: Law, point: Floats, ratios: Floats) -> Floats:
    """Give J^T J of the residuals of trials, from differences over a thousandth of the box, shape (P, P)."""
    low, high = law.box.T
    slopes = []
    for i, step in enumerate(1e-3 * (high - low)):
        ends = np.tile(point, (2, 1))
        ends[:, i] = np.clip([point[i] + step, point[i] - step], low[i], high[i])
        v = np.array(law.velocities(ends, ratios))
        slopes.append((v[:, 0] - v[:, 1]).ravel() / (ends[0, i] - ends[1, i]) / ERROR)
    jacobian = np.nan_to_num(slopes)
    return jacobian @ jacobian.T


def planted(law: Law, random: np.random.Generator, ratios: Floats = RATIOS) -> Floats:
    """Draw parameters of a law that the trials can tell."""
    while True:
        point = np.array(
            [
                random.uniform(-STIFFNESS, STIFFNESS) if name == "log_k" else random.uniform(*RESTITUTIONS)
                for name in law.parameters
            ]
        )
        told = information(law, point, ratios)
        if np.linalg.matrix_rank(told) < len(point):
            continue
        sd, width = np.sqrt(np.diag(np.linalg.inv(told))), np.ptp(law.box, axis=1)
        inside = (point - 4 * sd >= law.box[:, 0]) & (point + 4 * sd <= law.box[:, 1])
        if inside.all() and (sd <= IDENTIFIABLE * width).all():
            return point


def coverage(experiments: int, random: np.random.Generator, names: Sequence[str]) -> None:
    """Count intervals that hold the true value, law by law."""
    total = []
    for law in map(LAWS.__getitem__, names):
        held = []
        start = time.perf_counter()
        for _ in range(experiments):
            point = planted(law, random)
            (best,) = fit(synthetic(law, point, RATIOS, random), law.name, leave_out=False).fitted
            held.append([each.low <= x <= each.high for each, x in zip(best.intervals, point, strict=True)])
        share = np.mean(held, axis=0)
        total += np.ravel(held).tolist()
        words = ", ".join(
            f"{name} {100 * one:.1f} %" for name, one in zip(law.parameters, share, strict=True)
        )
        print(f"{law.name}: {words}; {(time.perf_counter() - start) / experiments:.2f} s each", flush=True)
    error = np.sqrt(0.95 * 0.05 / len(total))
    print(f"all: {100 * np.mean(total):.1f} % of {len(total)} intervals (95 +- {100 * error:.1f} % expected)")


def choice(experiments: int, random: np.random.Generator, names: Sequence[str]) -> None:
    """Count how often the true law is preferred to others that differ from it."""
    pairs = right = alone = 0
    decided = []
    for at in range(experiments):
        law = LAWS[names[at % len(names)]]
        point = planted(law, random)
        found = fit(synthetic(law, point, RATIOS, random), leave_out=False)
        mine = next(each for each in found.fitted if each.law is law)
        others = [each for each in found.fitted if each.law is not law and _differ(mine, each)]
        wins = [mine.evidence.aic < each.evidence.aic for each in others]
        pairs, right = pairs + len(wins), right + sum(wins)
        alone += len(others) == len(LAWS) - 1
        decided.append(all(wins))
        if not all(wins):
            print(f"{law.name} at {point.round(3)}: {found.best.law.name} is preferred", flush=True)
    print(
        f"the true law is before all that differ in {sum(decided)} of {experiments}; pairs: {right} of {pairs}"
    )
    print(f"in {alone} of {experiments} all other laws differ by three standard errors")


def _differ(one, other) -> bool:
    apart = one.objective.residuals(one.best) - other.objective.residuals(other.best)
    return bool(np.abs(apart).max() > 3)


def unknowable(experiments: int, random: np.random.Generator, names: Sequence[str]) -> None:
    """Report what is said of stiffness ratios beyond 100, and of restitutions of 1."""
    laws = [LAWS[name] for name in names if "log_k" in LAWS[name].parameters]
    ratios = np.full(12, 1.0)
    for at in range(experiments):
        law, chain = laws[at % len(laws)], at % 2
        log_k = random.uniform(-1, 1) if chain else random.uniform(2.2, 3.8)
        e1, e2 = (1.0, 1.0) if chain else random.uniform(0.5, 0.9, 2)
        point = np.array([log_k, e1, e2])
        (best,) = fit(synthetic(law, point, ratios, random), law.name, leave_out=False).fitted
        said = ", ".join(
            f"{i.parameter} {i.low:.3g} to {i.high:.3g}{' open' * (i.open_low or i.open_high)}"
            for i in best.intervals
        )
        named = best.intervals[0].flat or any(i.open_high for i in best.intervals[1:])
        holds = all(i.low <= x <= i.high for i, x in zip(best.intervals, point, strict=True))
        print(
            f"{law.name} at {point.round(3)}: {said}; reported {named}, holds the truth {holds}", flush=True
        )


def following(experiments: int, random: np.random.Generator, names: Sequence[str]) -> None:
    """Compare the suggested next experiment with one at a random mass ratio."""
    laws = [LAWS[name] for name in names if "log_k" in LAWS[name].parameters]
    ratios = np.geomspace(0.8, 1.25, 12)
    gains, lengths = [], []
    for at in range(experiments):
        law = laws[at % len(laws)]
        point = planted(law, random, RATIOS)
        data = synthetic(law, point, ratios, random)
        before = fit(data, law.name, leave_out=False)
        if before.narrows is None:
            continue
        other = float(random.choice(mass_ratios(before.trials)))
        after = [
            _length(
                fit(
                    pd.concat([data, synthetic(law, point, np.array([ratio]), random)]),
                    law.name,
                    leave_out=False,
                )
            )
            for ratio in (before.narrows[0], other)
        ]
        now = _length(before)
        gains.append((now - after[0]) / max(now - after[1], 1e-3 * now))
        lengths.append((after[0] / now, after[1] / now))
        print(
            f"{law.name} at {point.round(2)}: {now:.3f} decades; at m2/m1 = {before.narrows[0]:.3g} {after[0]:.3f}, "
            f"at {other:.3g} {after[1]:.3f}",
            flush=True,
        )
    suggested, random_one = np.median(lengths, axis=0)
    print(
        f"median of {len(gains)}: interval {suggested:.2f} of what it was, by a random one {random_one:.2f}"
    )
    print(f"it shrinks {np.median(gains):.2f} times as much as by a random one (median)")


def _length(found: FitResult) -> float:
    interval = found.best.interval("log_k")
    assert interval is not None
    return interval.high - interval.low


PARTS = {"coverage": coverage, "choice": choice, "unknowable": unknowable, "next": following}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--experiments", type=int, default=10, help="of each law, for coverage; else in all")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument(
        "--law", action="append", choices=LAWS, help="that is planted; by default every one in turn"
    )
    asked = parser.parse_args()
    PARTS[asked.part](asked.experiments, np.random.default_rng(asked.seed), asked.law or list(LAWS))


if __name__ == "__main__":
    main()
