"""A result as one web page that opens from disk: text, movie, bodies in 3D, curves, worst cells."""
