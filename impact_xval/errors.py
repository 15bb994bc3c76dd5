"""The base class of the errors of this project that a user may want to catch."""


class ImpactXvalError(Exception):
    """Base class of errors whose message says in one line why a request cannot be fulfilled.

    There are three derived classes. `SolverError` (`impact_xval.plugins`): a solver has no result. `UserError`: an
    experiment, a file or a folder cannot be used. `InterruptedRunError`: a run was stopped before its end.

    An illegal value of a collision raises a plain ValueError instead.
    """
