"""A result as one web page that opens from disk: texts, movie, bodies in space, curves, worst cells."""
