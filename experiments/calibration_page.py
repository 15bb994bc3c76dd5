"""What ``impact-xval calibrate`` shows: tables in words and numbers, and one figure."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from experiments.calibrate import COLUMNS, CONTACTS, M1, M2, STEP_FRACTIONS, V0, Calibration, Frame
from experiments.document import Block, Heading, Paragraph, Table, to_markdown
from experiments.errors import UserError
from experiments.figures import FORMATS
from experiments.findings import number
from experiments.store import write_text
from experiments.streams import replacing
from experiments.style import drawing, look

#: Errors are drawn no smaller than this.
_FLOOR = 1e-9

#: Largest error in restitution and, relative, in duration at which a contact counts as the one asked for.
TOLERANCE = 1e-3


def open_page(root: Path) -> None:
    """Make the folder of a calibration.

    Raises
    ------
    UserError
        If it holds anything, or cannot be made.
    """
    try:
        root.mkdir(parents=True, exist_ok=True)
        if next(root.iterdir(), None) is not None:
            raise UserError(f"--out {root}: not empty; legal: a new or empty folder")
    except OSError as error:
        raise UserError(f"--out {root}: cannot be written to: {error.strerror}") from None


def write_page(root: Path, calibration: Calibration) -> list[Block]:
    """Write ``calibration.csv``, ``limits.csv``, ``calibration.md``, ``calibration.png`` and ``.pdf``."""
    for name, table in (("calibration", calibration.steps), ("limits", calibration.limits)):
        with replacing(root / f"{name}.csv") as temporary:
            table.to_csv(temporary, index=False, lineterminator="\n")
    figure, caption = draw(calibration)
    for extension in FORMATS:
        with replacing(root / f"calibration.{extension}") as temporary:
            metadata = {"CreationDate": None} if extension == "pdf" else None
            figure.savefig(temporary, format=extension, dpi=150, metadata=metadata)
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
        *(limit_table(calibration, engine) for engine in _engines(calibration)),
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


def _engines(calibration: Calibration) -> list[str]:
    return list(calibration.versions)


def _limits(calibration: Calibration, engine: str, mapping: str) -> Frame:
    table = calibration.limits
    return table[(table.engine == engine) & (table.mapping == mapping)]


def findings(calibration: Calibration) -> list[str]:
    """Say in plain words whether each engine did what it was asked."""
    texts = []
    for engine in _engines(calibration):
        limits, steps = _limits(calibration, engine, "calibrated"), calibration.steps
        done = limits[limits.restitution.notna()]
        if not len(done):
            reason = steps[steps.engine == engine].reason.iloc[0]
            texts.append(f"{engine} gave no result: {reason}.")
            continue
        e, t = (done.restitution - done.e).abs(), (done.duration_ratio - 1).abs()
        kept = int(((e <= TOLERANCE) & (t <= TOLERANCE)).sum())
        naive = _limits(calibration, engine, "naive")
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
    for engine, contact in itertools.product(_engines(calibration), CONTACTS):
        limits = _limits(calibration, engine, "calibrated")
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
    for (contact, e), group in _limits(calibration, engine, "calibrated").groupby(
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
    for engine in _engines(calibration):
        naive = _limits(calibration, engine, "naive")
        for (contact, e), group in naive.groupby(["contact", "e"], sort=False):
            calibrated = _limits(calibration, engine, "calibrated")
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


def draw(calibration: Calibration) -> tuple[Figure, str]:
    """Draw convergence in the step, and restitution and duration by both mappings."""
    with drawing(11.0, 3.6) as figure:
        by_step, by_e, by_k = figure.subplots(1, 3)
        for position, engine in enumerate(_engines(calibration)):
            style = look(engine, position)
            _convergence(by_step, calibration, engine, style)
            for mapping, line in (("calibrated", "-"), ("naive", ":")):
                limits = _limits(calibration, engine, mapping)
                if not limits.restitution_at_step.notna().any():
                    continue
                label = f"{engine}, {mapping}"
                for ax, axis, value in (
                    (by_e, "e", "restitution_at_step"),
                    (by_k, "k", "duration_ratio_at_step"),
                ):
                    grouped = limits.groupby(axis)[value]
                    middle, low, high = grouped.median(), grouped.min(), grouped.max()
                    marker = style.marker if mapping == "calibrated" else ""
                    ax.plot(
                        middle.index,
                        middle,
                        color=style.color,
                        linestyle=line,
                        marker=marker or None,
                        label=label,
                    )
                    ax.fill_between(middle.index, low, high, color=style.color, alpha=0.15, linewidth=0)
        by_step.set(xscale="log", yscale="log", xlabel="time step / contact period (-)")
        by_step.set_ylabel("error of restitution (-)")
        by_step.set_xticks(
            STEP_FRACTIONS, [f"{1e3 * fraction:g}e-3" for fraction in STEP_FRACTIONS], minor=False
        )
        by_step.xaxis.set_minor_locator(NullLocator())
        by_step.invert_xaxis()
        by_e.plot([0.2, 1], [0.2, 1], color="0.4", linewidth=0.8)
        by_e.set(xlabel="restitution asked for (-)", ylabel="restitution obtained (-)")
        by_k.set(xscale="log", xlabel="stiffness asked for (N/m)")
        by_k.set_ylabel("duration / duration asked for (-)")
        for ax, title in (
            (by_step, "a  calibrated, in the step"),
            (by_e, "b  restitution"),
            (by_k, "c  duration"),
        ):
            ax.set_title(title, loc="left", fontsize=9)
        for ax in (by_step, by_e):
            if ax.get_legend_handles_labels()[0]:
                ax.legend()
    caption = (
        "Single contacts, ball on table and ball on ball. a: largest error of the restitution over e = 0.2 to 0.9, "
        "six decades of stiffness and both contacts against the time step, by the calibrated mapping; grey lines have "
        f"the slope of first order. b: restitution obtained at a step of {number(STEP_FRACTIONS[0])} of a period, "
        "median and range over stiffness and contact, by the calibrated and by the naive mapping; the grey line is "
        "what was asked for. c: duration over that asked for against stiffness, median and range over e and contact. "
        "MuJoCo's naive numbers are per kilogram: with the masses of about 1 kg used here they come closer than with "
        "others."
    )
    return figure, caption


def _convergence(ax: Any, calibration: Calibration, engine: str, style: Any) -> None:
    steps = calibration.steps
    rows = steps[
        (steps.engine == engine) & (steps.mapping == "calibrated") & (steps.status == "ok") & (steps.e < 1)
    ]
    if not len(rows):
        return
    worst = (rows.restitution - rows.e).abs().groupby(rows.step_fraction).max().clip(lower=_FLOOR)
    ax.plot(worst.index, worst, color=style.color, marker=style.marker or None, label=engine)
    fraction = np.array([worst.index.min(), worst.index.max()])
    first_order = 0.7 * worst.iloc[-1] * fraction / fraction[-1]
    ax.plot(fraction, first_order, color="0.4", linewidth=0.8, zorder=1)
