"""Files that appear whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pipeline.errors import OutputError


@contextmanager
def replace_file(path: Path, *, synced: bool = True) -> Iterator[Path]:
    """Yield a hidden name beside path to write to; on exit, the file is synced and takes the place of path.

    Syncing waits for the disk, a few ms per file; `synced` = False leaves it to the system, for files that can be made
    again. Such a file is whole or missing if the program is killed, but may be empty or partial after a power loss.
    Raises OutputError, and removes the hidden file, if the system refuses.
    """
    hidden = path.with_name(f".{path.stem}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield hidden
        if synced:
            with open(hidden, "rb+") as file:
                os.fsync(file.fileno())
        os.replace(hidden, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with suppress(OSError):  # its folder may not exist or not be a folder
            hidden.unlink(missing_ok=True)


def write_whole(path: Path, data: str | bytes, *, synced: bool = True) -> None:
    """Write text or bytes so that path holds the old or the new content, never part of it; raises OutputError.

    Unless `synced`, it may hold only part of it after a power loss: see replace_file.
    """
    with replace_file(path, synced=synced) as hidden:
        hidden.write_bytes(data.encode() if isinstance(data, str) else data)
