"""Names of fields in a dataset: those of the files, unless they are taken, or netCDF and zarr cannot store them."""

import re
import unicodedata
from collections.abc import Iterable

from pipeline.errors import shorten

KINDS = {"point": "point field", "cell": "cell field", "field": "field data"}  # as messages call each kind
_LONGEST = 200  # bytes; netCDF allows 256, and a suffix may follow
_REFUSED = re.compile(r"[/\x00-\x1f\x7f]")


def clean_name(name: str) -> str:
    """Return a name that netCDF and zarr can store: no slash, no control character, a letter or digit first."""
    text = unicodedata.normalize("NFC", _REFUSED.sub("_", name)).strip()
    if not text or not (text[0].isalnum() or text[0] == "_" or ord(text[0]) > 127) or text.startswith("__"):
        text = f"field_{text}".rstrip("_")  # zarr keeps names that begin with two underscores for itself
    return text.encode()[:_LONGEST].decode(errors="ignore")


def choose_names(
    fields: Iterable[tuple[str, str]], taken: Iterable[str]
) -> tuple[dict[tuple[str, str], str], list[str]]:
    """Return a name for each field (kind, name in the files), and a note on each that differs.

    A field whose name is taken, by the dataset itself or by a field before it, gets its kind as a suffix: the cell
    field T beside the point field T is T_cell.
    """
    used, names, notes = set(taken), dict[tuple[str, str], str](), list[str]()
    for kind, original in fields:
        base = clean_name(original)
        name, count = base, 1
        while name in used:
            count += 1
            name = f"{base}_{kind}" if count == 2 else f"{base}_{kind}_{count - 1}"
        used.add(name)
        names[kind, original] = name
        if name != original:
            reason = "that name is taken" if base == original else "netCDF cannot store that name"
            notes.append(f"the {KINDS[kind]} {shorten(original)} is named {shorten(name)}: {reason}")
    return names, notes
