"""Numbers in the names of files: their order, the times that decimals are, and the pattern of a series."""

import re
from collections.abc import Sequence
from pathlib import Path

_NUMBER = re.compile(r"\d+(?:\.\d+)*(?:[eE][-+]\d+)?")
_DECIMAL = re.compile(r"\d+(?:\.(\d+))?(?:[eE][-+]\d+)?")


def make_template(name: str) -> str:
    """Return a name with * for each of its numbers."""
    return _NUMBER.sub("*", name)


def make_natural_key(file: Path) -> list[tuple[int, str]]:
    """Return a key that sorts frame_9 before frame_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", str(file))]


def read_decimals(files: Sequence[Path]) -> list[float] | None:
    """Return the last number that varies in the paths if it is a decimal, as in result-0.0005; None if it is not.

    In mesh_4.9, mesh_4.10 the numbers are counters: their last digits are not those of fractions.
    """
    found = [_NUMBER.findall(str(file).removesuffix(file.suffix)) for file in files]
    if len({len(numbers) for numbers in found}) != 1:
        return None
    texts = next(([*column] for column in reversed([*zip(*found, strict=True)]) if len(set(column)) > 1), [])
    matches = [_DECIMAL.fullmatch(text) for text in texts]
    if not any("." in text or "e" in text.lower() for text in texts) or not all(matches):  # nor if there are none
        return None
    fractions = [match[1] or "" for match in matches if match is not None]
    # counters such as 4.9, 4.10
    if len({len(fraction) for fraction in fractions}) > 1 and any(f.endswith("0") and f != "0" for f in fractions):
        return None
    whole = {text.split(".")[0] for text in texts}
    if len(whole) == 1 and whole != {"0"} and not any("e" in text.lower() for text in texts):
        return None
    values = [float(text) for text in texts]
    return values if len(set(values)) == len(values) else None


def list_numbers(files: Sequence[Path]) -> list[tuple[int, ...]]:
    """Return the whole numbers in each path that are not the same in all; empty tuples if their counts differ."""
    numbers = [tuple(int(text) for text in re.findall(r"\d+", str(file))) for file in files]
    if len({len(own) for own in numbers}) != 1:
        return [()] * len(files)
    varying = [k for k in range(len(numbers[0])) if len({own[k] for own in numbers}) > 1]
    return [tuple(own[k] for k in varying) for own in numbers]
