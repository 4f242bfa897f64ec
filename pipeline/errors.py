"""Everything that this package raises on purpose; the command line turns each into one line and an exit code."""


class PipelineError(Exception):
    """A fault that its reader can mend: the message names the file, the key or step, the number and the remedy."""

    exit_code = 2


class CaseError(PipelineError):
    """A case file, an override or a combination of its settings is wrong."""


class MeshError(PipelineError):
    """A mesh cannot be simulated or measured."""


class SeriesError(PipelineError):
    """A recorded time series cannot be read or measured."""


class SolveError(PipelineError):
    """A step could not be computed; what was computed before it stands."""

    exit_code = 3


class OutputError(PipelineError):
    """A result could not be written or drawn."""

    exit_code = 4
