"""Files that appear whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pipeline.errors import OutputError


@contextmanager
def whole_file(path: Path, *, synced: bool = True) -> Iterator[Path]:
    """Yield a hidden name beside path to write to; on leaving it is synced and takes the place of path.

    Syncing waits for the disk, some ms a file: of what can be made again it may be left to the system. Without it the
    file is whole or not there after the program died, but may be empty or partial after a loss of power. Raises
    OutputError, and removes the hidden file, where the system refuses.
    """
    hidden = path.with_name(f".{path.stem}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield hidden
        if synced:
            with open(hidden, "rb+") as written:
                os.fsync(written.fileno())
        os.replace(hidden, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with suppress(OSError):  # its folder may not exist, or be no folder
            hidden.unlink(missing_ok=True)


def write_whole(path: Path, data: str | bytes, *, synced: bool = True) -> None:
    """Write a text or bytes so that path holds the old or the new content, never a part; raises OutputError.

    Not `synced`, it may hold a part after a loss of power, as whole_file says.
    """
    with whole_file(path, synced=synced) as hidden:
        hidden.write_bytes(data.encode() if isinstance(data, str) else data)
