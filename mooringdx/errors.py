"""One tree of errors. A message says what, where, what is allowed, and the remedy, in one sentence."""

from __future__ import annotations


class MooringdxError(Exception):
    """Root of every error that the user can mend."""


class LogError(MooringdxError):
    """A log cannot be read, or does not hold what the run file asks of it."""


class ConfigError(MooringdxError):
    """A run file, plan or scenario is wrong."""


class FitError(MooringdxError):
    """The no-fault window cannot carry what is asked of it."""


class ReportError(MooringdxError):
    """A stored result is missing, damaged, or of another configuration."""
