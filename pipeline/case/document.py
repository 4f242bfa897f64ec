"""A TOML file as a dict, or one line that says why not."""

import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pipeline.errors import CaseError, quote_value, shorten


def read_document(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. CaseError names what is in the way, with the line where there is one."""
    if "\0" in str(path):
        raise CaseError(f"{quote_value(str(path))}: no such file")
    try:
        if path.is_dir():
            raise CaseError(f"{path}: is a folder, not a case file{_inside(path)}")
        if not path.exists():
            raise CaseError(f"{path}: no such file{_near(path)}")
        if not path.is_file():
            raise CaseError(f"{path}: is not a regular file")
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise CaseError(f"{path}: line {line}: not UTF-8") from None
    except OSError as error:
        raise CaseError(f"{path}: cannot be read: {error.strerror}") from None
    return _parsed(text, path)


def _parsed(text: str, path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason = " ".join(str(error).split())
        end = f"at line {text.count(chr(10)) + 1}, the end of the file"
        raise CaseError(f"{path}: not TOML: {shorten(reason.replace('at end of document', end), 200)}") from None
    except ValueError as error:  # a number beyond Python's limit of digits, a day that no month has
        raise CaseError(f"{path}: not TOML: {' '.join(str(error).split())}") from None


def _inside(folder: Path) -> str:
    """What a folder has instead of being a case file."""
    names = [file.name for file in _cases(folder)]
    listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    return f"; {folder} has {listed}" if names else ""


def _near(path: Path) -> str:
    """The case files that may be meant: those named alike beside it or, where there are none, in cases/."""
    for folder in (path.parent, Path("cases")):
        files = {file.stem: file for file in _cases(folder)}
        # without the ending, which makes all names alike
        if found := get_close_matches(path.name.removesuffix(".toml"), files, n=3):
            return f"; did you mean {' or '.join(str(files[name]) for name in found)}?"
    return ""


def _cases(folder: Path) -> list[Path]:
    try:
        return sorted(folder.glob("*.toml"))
    except OSError:
        return []
