"""What ``impact-xval calibrate`` shows: tables in words and numbers beside its figure."""

from __future__ import annotations

import itertools
from pathlib import Path

from impact_xval.experiments.commands.calibrate import (
    COLUMNS,
    CONTACTS,
    M1,
    M2,
    STEP_FRACTIONS,
    V0,
    Calibration,
    Frame,
)
from impact_xval.experiments.commands.calibration_figure import draw
from impact_xval.experiments.presentation.style import save
from impact_xval.experiments.tables.document import (
    Block,
    Heading,
    Paragraph,
    Table,
    to_markdown,
)
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.store import write_text
from impact_xval.experiments.tables.streams import replacing

#: Largest error in restitution and, relative, in duration at which a contact counts as the one asked for.
TOLERANCE = 1e-3


def write_page(root: Path, calibration: Calibration) -> list[Block]:
    """Write ``calibration.csv``, ``limits.csv``, ``calibration.md``, ``calibration.png`` and ``.pdf``."""
    for name, table in (("calibration", calibration.steps), ("limits", calibration.limits)):
        with replacing(root / f"{name}.csv") as temporary:
            table.to_csv(temporary, index=False, lineterminator="\n")
    figure, caption = draw(calibration)
    save(figure, root, "calibration", dpi=150)
    document = build(calibration)
    text = to_markdown(document).replace("FIGURE", f"![{caption}](calibration.png)\n\n*{caption}*", 1)
    write_text(root / "calibration.md", text)
    return document


def build(calibration: Calibration) -> list[Block]:
    """Arrange what was found as a document; the word FIGURE stands where the figure goes."""
    masses = f"m1 = {number(M1)} kg, m2 = {number(M2)} kg, v0 = {number(V0)} m/s"
    return [
        Heading("Calibration of single contacts", level=1),
        Paragraph(
            "Each engine was asked for one contact at a time: ball on table, and ball on ball on two free balls, "
            f"without gravity; {masses}. Asked for is F = max(0, k delta + c delta'), with c the damping at which a "
            "contact that ends at zero force has the restitution e; its duration follows. Steps are a thousandth of "
            "the undamped contact's period and three halvings of it; the limit is extrapolated linearly from the "
            "last two."
        ),
        Heading("What was found"),
        *(Paragraph(text) for text in findings(calibration)),
        summary_table(calibration),
        Paragraph("FIGURE"),
        Heading("Calibrated"),
        *(limit_table(calibration, engine) for engine in calibration.engines),
        Heading("The naive mapping beside it"),
        naive_table(calibration),
        Heading("Columns of calibration.csv"),
        Table(
            "A row for each contact and step",
            ("column", "unit", "meaning"),
            [(name, *about) for name, about in COLUMNS.items()],
            text_columns=3,
        ),
    ]


def findings(calibration: Calibration) -> list[str]:
    """Say in plain words whether each engine did what it was asked."""
    texts = []
    for engine in calibration.engines:
        limits, steps = calibration.limits_of(engine, "calibrated"), calibration.steps
        done = limits[limits.restitution.notna()]
        if not len(done):
            reason = steps[steps.engine == engine].reason.iloc[0]
            texts.append(f"{engine} gave no result: {reason}.")
            continue
        e, t = (done.restitution - done.e).abs(), (done.duration_ratio - 1).abs()
        kept = int(((e <= TOLERANCE) & (t <= TOLERANCE)).sum())
        naive = calibration.limits_of(engine, "naive")
        off = (naive.restitution_at_step - naive.e).abs()
        ratio = naive.duration_ratio_at_step
        text = (
            f"{engine} {calibration.versions[engine]}: in the limit of small steps {kept} of {len(limits)} contacts "
            f"are within {number(TOLERANCE)} of what was asked for, in restitution and, relative, in duration; the "
            f"worst by {number(e.max(), 2)} and {number(t.max(), 2)}. At a step of {number(STEP_FRACTIONS[0])} of a "
            f"period they are off by up to {number((done.restitution_at_step - done.e).abs().max(), 2)} and "
            f"{number((done.duration_ratio_at_step - 1).abs().max(), 2)}."
        )
        if off.notna().any():
            text += (
                f" By the naive mapping the restitution is off by {number(off.median(), 2)} in the median and up to "
                f"{number(off.max(), 2)}, and contacts last {number(ratio.min(), 2)} to {number(ratio.max(), 2)} "
                "times as long as asked for."
            )
        failed = naive[naive.restitution_at_step.isna()]
        if len(failed):
            text += (
                f" {len(failed)} of {len(naive)} naive contacts had no result (statuses in calibration.csv)."
            )
        texts.append(text)
    return texts


def summary_table(calibration: Calibration) -> Table:
    """Tabulate the worst of each engine and contact over all e and k."""
    rows = []
    for engine, contact in itertools.product(calibration.engines, CONTACTS):
        limits = calibration.limits_of(engine, "calibrated")
        limits = limits[limits.contact == contact]
        e, t = (limits.restitution - limits.e).abs(), (limits.duration_ratio - 1).abs()
        rows.append(
            (
                engine,
                contact,
                f"{limits.restitution.notna().sum()} of {len(limits)}",
                number(e.max(), 2),
                number(t.max(), 2),
                _range(limits.order),
                _range(limits[limits.e < 1].restitution_order),
                _range(limits[limits.e == 1].restitution_order),
                _range(limits.duration_order),
            )
        )
    return Table(
        "Largest difference from what was asked for in the limit of small steps, over all e and k, and the fitted "
        "order in the step of both together and of each (lowest to highest)",
        (
            "engine",
            "contact",
            "done",
            "restitution",
            "duration (relative)",
            "order",
            "order of e, e < 1",
            "order of e, e = 1",
            "order of duration",
        ),
        rows,
        text_columns=2,
    )


def limit_table(calibration: Calibration, engine: str) -> Table:
    """Tabulate one engine by contact and e: the worst over k."""
    rows = []
    for (contact, e), group in calibration.limits_of(engine, "calibrated").groupby(
        ["contact", "e"], sort=False
    ):
        rows.append(
            (
                str(contact),
                number(e),
                _signed(group.restitution_at_step - group.e),
                _signed(group.duration_ratio_at_step - 1),
                _signed(group.restitution - group.e),
                _signed(group.duration_ratio - 1),
                _range(group.restitution_order),
                _range(group.duration_order),
            )
        )
    return Table(
        f"{engine}: obtained minus asked for, the worst over all stiffnesses, at a step of "
        f"{number(STEP_FRACTIONS[0])} of a period and in the limit of small steps, and the fitted orders (lowest to "
        "highest); durations relative",
        (
            "contact",
            "e",
            "restitution at the step",
            "duration at the step",
            "restitution, limit",
            "duration, limit",
            "order of e",
            "order of duration",
        ),
        rows,
        text_columns=1,
    )


def naive_table(calibration: Calibration) -> Table:
    """Tabulate what the naive mapping gives instead."""
    rows = []
    for engine in calibration.engines:
        naive = calibration.limits_of(engine, "naive")
        for (contact, e), group in naive.groupby(["contact", "e"], sort=False):
            calibrated = calibration.limits_of(engine, "calibrated")
            same = calibrated[(calibrated.contact == contact) & (calibrated.e == e)]
            rows.append(
                (
                    engine,
                    str(contact),
                    number(e),
                    _range(same.restitution_at_step),
                    _range(group.restitution_at_step),
                    _range(same.duration_ratio_at_step),
                    _range(group.duration_ratio_at_step),
                )
            )
    return Table(
        f"Restitution obtained, and duration obtained over asked for, at a step of {number(STEP_FRACTIONS[0])} of a "
        "period: lowest to highest over all stiffnesses, by the calibrated and by the naive mapping",
        (
            "engine",
            "contact",
            "e",
            "restitution, calibrated",
            "restitution, naive",
            "duration, calibrated",
            "duration, naive",
        ),
        rows,
        text_columns=2,
    )


def _signed(values: Frame) -> str:
    known = values.dropna()
    return number(known.loc[known.abs().idxmax()], 2) if len(known) else "-"


def _range(values: Frame) -> str:
    known = values.dropna()
    if not len(known):
        return "-"
    low, high = number(known.min()), number(known.max())
    return low if low == high else f"{low} to {high}"
