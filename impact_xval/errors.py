"""The base of the errors of this project that a user may want to catch."""


class ImpactXvalError(Exception):
    """Something that was asked for cannot be done; the message is one line that says why.

    Its kinds are `SolverError` (`impact_xval.plugins`), where a solver has no result, `UserError`, where an experiment,
    a file or a folder cannot be used, and `InterruptedRunError`, where a run was stopped before its end. An illegal
    value of a collision is a plain ValueError.
    """
