"""`hypothesis.md`: what was asked and found, how sure it is, and why; every number is of the run that wrote it."""

from __future__ import annotations

import math

from impact_xval.experiments.hypothesis import (
    mechanism,
    prose,
    prose_sure,
    prose_why,
)
from impact_xval.experiments.hypothesis.cases import CASES
from impact_xval.experiments.hypothesis.figures import Picture
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.tables import (
    class_frame,
    need_frame,
    overview_table,
    rate_text,
    said,
    short,
)
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.laws import LAWS_WITH_LAWS, with_votes
from impact_xval.experiments.tables.document import (
    Block,
    Heading,
    Paragraph,
    Table,
)
from impact_xval.experiments.tables.numbers import number, percent

Part = Block | Picture


def build_page(results: Results, pictures: dict[str, Picture], versions: dict[str, str]) -> list[Part]:
    """Arrange the page."""
    maps = [picture for name, picture in pictures.items() if name.startswith("map-")]

    def picture(name: str) -> list[Part]:
        return [pictures[name]] if name in pictures else []

    return [
        Heading("Does an infinitely stiff pair act as one body?", level=1),
        Paragraph(LAWS_WITH_LAWS),
        Paragraph(prose.abstract(results)),
        Heading("What was asked"),
        *map(Paragraph, prose.question()),
        case_table(),
        Heading("What was found"),
        overview_table(results),
        *map(Paragraph, prose.by_limit(results)),
        *picture("distance"),
        Heading("Why"),
        *map(Paragraph, prose_why.why(results)),
        mechanism_table(results),
        *picture("relative-motion"),
        Heading("Where they go instead"),
        *map(Paragraph, prose_why.instead(results)),
        prediction_table(results),
        Heading("Compliance or mapping"),
        *map(Paragraph, prose_why.mapping(results)),
        Heading("Where the model itself has no limit"),
        *map(Paragraph, prose_why.no_limit(results)),
        *([branch_table(results)] if results.branches else []),
        *picture("no-limit"),
        Heading("How stiff is stiff enough"),
        *map(Paragraph, prose_sure.stiff_enough(results)),
        need_table(results),
        *maps,
        Heading("How sure it is"),
        *map(Paragraph, prose_sure.sureness(results)),
        class_table(results),
        Heading("Method"),
        *map(Paragraph, prose_sure.method(results)),
        Heading("Limits of what this shows"),
        *map(Paragraph, prose_sure.limits(results)),
        Heading("Provenance"),
        Paragraph(
            f"Seed {results.config.seed}. "
            + "; ".join(f"{name} {version}" for name, version in versions.items())
            + ". Every number above is in verdicts.csv, points.csv, outcomes.parquet, mechanism.csv, "
            "maps.parquet and contrast-needed.csv beside this page."
        ),
    ]


def case_table() -> Table:
    """List the limits with their regimes and closed forms."""
    return Table(
        "The limits (m1 = 1, |v0| = 1), and the sources of their closed forms",
        ["limit", "what it is", "contrast", "regime", "closed form"],
        [[case.key, case.title, case.variable, case.regime, case.source] for case in CASES],
        text_columns=5,
    )


def mechanism_table(results: Results) -> Table:
    """Relative motion of the stiff pair at the two ends of the contrasts that were followed."""
    rows = []
    order = {name: i for i, name in enumerate(results.solvers)}
    for key in mechanism.POINTS:
        for name in sorted(order, key=order.__getitem__):
            found = sorted(
                (m for m in results.mechanisms if (m.case, m.solver) == (key, name)), key=lambda m: m.contrast
            )
            if key == "zero-apart" or not found:
                continue
            low, high = found[0], found[-1]
            if not high.joined:
                rows.append([key, name, short(high.contrast), *["-"] * 4, high.status])
                continue
            again = "at once" if high.again_after <= mechanism.AT_ONCE else "-"
            if math.isfinite(high.again_after) and high.opens:
                again = f"{high.again_after:.2f} at {short(round(high.again_speed, 9), 2)}"
            rate = math.nan
            if low.joined and low.largest_rate > 0 < high.largest_rate and low.contrast < high.contrast:
                rate = -math.log(high.largest_rate / low.largest_rate) / math.log(
                    high.contrast / low.contrast
                )
            rows.append(
                [
                    key,
                    name,
                    short(high.contrast),
                    short(high.gap_then),
                    short(high.largest_rate),
                    short(rate, 2),
                    again,
                    "opens" if high.opens else "closed",
                ]
            )
    return Table(
        with_votes(
            "The stiff pair after the instant at which the hypothesis joins it, at the highest contrast "
            "followed: its separation at that instant per largest compression of the soft contact, its largest "
            "relative speed from then on per |v0| and how fast that falls with the contrast (rate), and when, "
            "in half periods of the soft contact, and at what speed per |v0| it collides again",
            results.solvers,
        ),
        [
            "limit",
            "solver",
            "contrast",
            "separation",
            "relative speed",
            "rate",
            "collides again",
            "stiff contact",
        ],
        rows,
        text_columns=2,
    )


def prediction_table(results: Results) -> Table:
    """How far the extrapolated limits lie from the closed form and from the prediction."""
    frame: Frame = class_frame(results)
    rows = []
    for row in frame[(frame["class"] == "all") & (frame.n_refuted > 0)].itertuples():
        rows.append(
            [
                row.case,
                row.law,
                row.solver,
                f"{row.n_refuted} of {row.points}, {percent(row.share_refuted)}",
                f"{short(row.offset_least, 2)} to {short(row.offset_largest, 2)}",
                short(row.offset_median, 2),
                short(row.limit_error_largest, 1),
                short(row.missed_prediction_largest, 1),
                row.prediction or "-",
            ]
        )
    return Table(
        with_votes(
            "Where the hypothesis is refuted: points at which it is, distance of the extrapolated limit from the "
            "closed form (range and median over these points), largest error of the extrapolation, and largest "
            "distance from what the solver's law alone predicts",
            results.solvers,
        ),
        ["limit", "law", "solver", "points", "off by", "median", "error", "off prediction", "prediction"],
        rows,
        text_columns=4,
    )


def branch_table(results: Results) -> Table:
    """Shares of the first two outcomes of the model without a limit."""
    rows = [
        [
            number(b.point.mass_ratio),
            number(b.point.e2),
            f"{b.once:.4f}",
            f"{b.twice:.4f}",
            percent(b.predicted),
            f"{100 * b.measured:.1f} ± {100 * b.uncertainty:.1f} %",
            f"{100 * b.elsewhere:.1f} %",
        ]
        for b in results.branches
    ]
    return Table(
        "The model at e1 = 1, balls united while the table contact is compressed: its velocities after one "
        "and two ends of compression, per |v0|, how often the second one occurs, and how often neither "
        "(m2/m1 < 0.121: more ends)",
        ["m2/m1", "e2", "one end", "two ends", "two ends, closed form", "two ends, counted", "neither"],
        rows,
        text_columns=0,
    )


def need_table(results: Results) -> Table:
    """Contrasts from which on the hypothesis is good to 1, 5 and 20 %."""
    frame: Frame = need_frame(results)
    e1, e2 = results.config.map.restitutions[0]
    chosen = frame[(frame.e1 == e1) & (frame.e2 == e2) & frame.mass_ratio.isin([0.5, 1.0, 5.0])]
    rows = [
        [
            row.solver,
            row.side,
            number(row.mass_ratio),
            *(short(x, 2) for x in (row.contrast_1pct, row.contrast_5pct, row.contrast_20pct)),
        ]
        for row in chosen.itertuples()
    ]
    return Table(
        with_votes(
            "Contrast (max(k2/k1, k1/k2)) from which on, to the end of the map, treating the stiff pair as one "
            f"body is good to 1, 5 and 20 % of the impact's kinetic norm, at e1 = {e1:g}, e2 = {e2:g}",
            results.solvers,
        ),
        ["solver", "side", "m2/m1", "1 %", "5 %", "20 %"],
        rows,
        text_columns=2,
    )


def class_table(results: Results) -> Table:
    """Every verdict by class, with its rate and its stability."""
    rows = []
    for result in results.verdicts:
        for group in result.classes:
            again = results.redrawn.get((result.solver, result.case.key, group.name))
            rows.append(
                [
                    result.case.key,
                    result.law,
                    result.solver,
                    group.name,
                    said(group) + (" within error" if group.agrees else ""),
                    "/".join(str(group.counts.get(w, 0)) for w in ("supported", "refuted", "undecided")),
                    rate_text(group),
                    said(group, shifted=True) if result.shiftable else "-",
                    said(again) if again else "-",
                ]
            )
    return Table(
        with_votes(
            "Every class of points: verdict with the points at which it was reached (of an undecided one: that "
            "refute), points supported/refuted/undecided, median rate of the supported points with its 95 % "
            "interval, the verdict of the fit a decade before, and that of a design drawn with another seed",
            results.solvers,
        ),
        ["limit", "law", "solver", "class", "verdict", "points", "rate", "a decade before", "redrawn"],
        rows,
        text_columns=5,
        detail=True,
    )
