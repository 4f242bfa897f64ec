"""A TOML file as a dict, or a one-line error."""

import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pipeline.errors import CaseError, quote_value, shorten


def read_document(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raises CaseError with the reason and, if known, the line."""
    if "\0" in str(path):
        raise CaseError(f"{quote_value(str(path))}: no such file")
    try:
        if path.is_dir():
            raise CaseError(f"{path}: is a folder, not a case file{_mention_cases_in(path)}")
        if not path.exists():
            raise CaseError(f"{path}: no such file{_suggest_path(path)}")
        if not path.is_file():
            raise CaseError(f"{path}: is not a regular file")
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise CaseError(f"{path}: line {line}: not UTF-8") from None
    except OSError as error:
        raise CaseError(f"{path}: cannot be read: {error.strerror}") from None
    return _parse(text, path)


def _parse(text: str, path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason = " ".join(str(error).split())
        end = f"at line {text.count(chr(10)) + 1}, the end of the file"
        raise CaseError(f"{path}: not TOML: {shorten(reason.replace('at end of document', end), 200)}") from None
    except ValueError as error:  # a number with too many digits for Python, or an impossible date
        raise CaseError(f"{path}: not TOML: {' '.join(str(error).split())}") from None


def _mention_cases_in(folder: Path) -> str:
    """Return a hint that lists the case files in a folder, or "" if there are none."""
    names = [file.name for file in _list_cases(folder)]
    listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    return f"; {folder} has {listed}" if names else ""


def _suggest_path(path: Path) -> str:
    """Return a hint with similarly named case files beside the path or else in cases/; "" if there are none."""
    for folder in (path.parent, Path("cases")):
        files = {file.stem: file for file in _list_cases(folder)}
        # the common suffix would make all names similar
        if similar := get_close_matches(path.name.removesuffix(".toml"), files, n=3):
            return f"; did you mean {' or '.join(str(files[name]) for name in similar)}?"
    return ""


def _list_cases(folder: Path) -> list[Path]:
    try:
        return sorted(folder.glob("*.toml"))
    except OSError:
        return []
