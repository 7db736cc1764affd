"""Every error a user can cause, each with the exit code the command line ends with."""


class NeuroAnimatorError(Exception):
    """Base class: one line saying what was wanted, what was given and what to do."""

    exit_code = 1


class ArgumentError(NeuroAnimatorError, ValueError):
    """A name, number or shape the caller gave is not valid."""

    exit_code = 2


class DivergedError(NeuroAnimatorError):
    """A motion ended in numbers that are not finite."""


class BadFileError(NeuroAnimatorError):
    """A file is missing, truncated, of another kind or of another configuration."""

    exit_code = 3


class ResourceError(NeuroAnimatorError):
    """The machine lacks something: disk, a lock another process holds, a graphics library."""

    exit_code = 4
