"""Sentences that warn of outcomes of the model near a jump or a cut-off, and the threshold for cut-offs.

Used by `model.solving` and `graph.outcome`.
"""

#: Largest change of (v1, v2) by a cut-off for which a result gets no mark. A mark is a sentence that warns of a result.
#: The change is measured in the kinetic norm, divided by sqrt(m1) abs(v0).
CUTOFF_THRESHOLD = 1e-9

GRAZING = (
    "grazing: a compression rate turned around next to zero (grazing_margin), and the outcome jumps where one "
    "reaches zero"
)
CUTOFF = (
    f"cut-off: the outcome without a cut-off differs by more than {CUTOFF_THRESHOLD:g} |v0|, or is not known"
)

#: The mark of an outcome: a sentence that warns of it. Index 1 is for grazing, 2 for a cut-off, 3 for both, and 0 for
#: an outcome without a mark.
MARKS = ("", GRAZING, CUTOFF, f"{GRAZING}; {CUTOFF}")
