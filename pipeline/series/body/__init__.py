"""The body in the files of a series: its cells, rest state and displacement, decided by the numbers of the files."""
