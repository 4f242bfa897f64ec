"""XDMF 2 and 3: the document, its numbers, its instants, their cells and fields."""
