"""Questions that take many runs of a case: which setting is enough, what breaks, how cost grows."""
