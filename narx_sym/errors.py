"""Every error a user may see."""

INTERRUPTED = "narx-sym: interrupted; files are either whole or as they were"


class NarxError(ValueError):
    """Base of all errors of this package; the message says what is wrong, where, and what to do."""


class DataError(NarxError):
    """A file, a column or an array cannot be used as data."""


class ModelError(NarxError):
    """A model is inconsistent or does not have what was asked of it."""


class ParseError(NarxError):
    """A term, an equation or a model file cannot be read."""


class NotInvertible(NarxError):  # noqa: N818
    """The model has no closed-form compensation law."""


class Diverged(NarxError):  # noqa: N818
    """A free run left the finite numbers.

    Attributes
    ----------
    at : int
        The first bad sample.
    trajectory : (N,) array or None
        The output of a model, else the state that is not finite first; valid before `at`.
    """

    def __init__(self, message: str, at: int = -1, trajectory: object = None):
        super().__init__(message)
        self.at, self.trajectory = at, trajectory


class Unreachable(NarxError):  # noqa: N818
    """The model cannot follow a reference: its input saturates, or no input gives the wanted output.

    Attributes
    ----------
    at : int
        The first sample that is missed.
    """

    def __init__(self, message: str, at: int = -1):
        super().__init__(message)
        self.at = at


class FitError(NarxError):
    """The parameters or the structure cannot be estimated."""
