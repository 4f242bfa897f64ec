"""The files of a series: the instants that a path names, their times and parts, and how their files are read."""
