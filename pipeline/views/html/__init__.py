"""A result as one web page that opens from disk: texts, movie, bodies in 3D, curves, worst cells."""
