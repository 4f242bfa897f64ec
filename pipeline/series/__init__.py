"""A recorded series, ours or another program's: read back as Frames and as an xarray dataset."""

from pipeline.series.body.layout import Options
from pipeline.series.series import Series, read_series

__all__ = ["Options", "Series", "read_series"]
