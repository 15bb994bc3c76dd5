"""The sentences that mark an outcome of the model, and the change by which a cut-off marks it.

Used by `model.solving` and `graph.outcome`.
"""

#: A cut-off marks a result if it changes (v1, v2) by more than this number, in the kinetic norm divided by
#: sqrt(m1) abs(v0).
CUTOFF_THRESHOLD = 1e-9

GRAZING = (
    "grazing: a compression rate turned around next to zero (grazing_margin), and the outcome jumps where one "
    "reaches zero"
)
CUTOFF = (
    f"cut-off: the outcome without a cut-off differs by more than {CUTOFF_THRESHOLD:g} |v0|, or is not known"
)

#: Sentences that mark outcomes. Index 1 is for grazing, 2 for a cut-off, 3 for both, and 0 for an outcome without a
#: mark.
MARKS = ("", GRAZING, CUTOFF, f"{GRAZING}; {CUTOFF}")
