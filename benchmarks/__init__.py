"""Measurements that compare this package with other programs, or parts of it with each other; not in the wheel."""
