"""H.264 encoding while the next frames are drawn: a thread feeds ffmpeg, which runs in a process of its own."""

import os
import subprocess
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from queue import Queue
from types import TracebackType
from typing import IO

from pipeline.errors import OutputError

WAITING_FRAMES = 4  # enough to keep ffmpeg busy; more would only take memory


def _find_ffmpeg() -> str:
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise OutputError(f"movie: ffmpeg is missing ({error}); pip install imageio-ffmpeg") from error


class Encoder:
    """Writes RGB frames to a complete .mp4 or leaves none: a temporary file beside it is renamed at the end.

    ffmpeg is started directly: imageio_ffmpeg.write_frames lets its messages through to the terminal and ignores
    its exit code, so a full disk would pass for success.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self._path = path
        self._temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
        # yuv420p: the encoder would pick 4:4:4 for RGB, which browsers and players cannot show
        video = ["-an", "-c:v", "libx264", "-crf", "20", "-preset", "veryfast", "-pix_fmt", "yuv420p"]
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-"]
        options = ["-hide_banner", "-loglevel", "error", "-y"]
        command = [_find_ffmpeg(), *options, *source, *video, "-movflags", "+faststart", "-f", "mp4"]
        self._messages: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (lives as long as the process)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._process = subprocess.Popen(
                [*command, str(self._temporary)], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                stderr=self._messages,
            )  # fmt: skip
        except OSError as error:
            self._messages.close()
            raise OutputError(f"{path}: the encoder cannot be started: {error}") from error
        self._queue: Queue[bytes | None] = Queue(WAITING_FRAMES)
        self._broken = False
        self._thread = threading.Thread(target=self._feed, name="movie-encoder", daemon=True)
        self._thread.start()

    def _feed(self) -> None:
        """Pass frames on; after a broken pipe discard them, so that write() never blocks."""
        stdin = self._process.stdin
        assert stdin is not None
        while (frame := self._queue.get()) is not None:
            try:
                if not self._broken:
                    stdin.write(frame)
            except OSError:
                self._broken = True
        try:
            stdin.close()
        except OSError:
            self._broken = True

    def write(self, frame: bytes) -> None:
        """Encode one frame, RGB row by row; raises OutputError if ffmpeg has failed."""
        if self._broken:
            raise OutputError(self._describe_failure())
        self._queue.put(frame)

    def _describe_failure(self) -> str:
        code = self._process.wait()
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").strip().splitlines()
        return f"{self._path}: the encoder failed (exit code {code}): {' | '.join(lines[-3:]) or 'no message'}"

    def __enter__(self) -> "Encoder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file and move it into place; after an exception remove it."""
        if kind is not None:
            self._process.kill()
        self._queue.put(None)
        self._thread.join()
        try:
            failed = self._process.wait() != 0 or self._broken
            if kind is None and failed:
                raise OutputError(self._describe_failure())
            if kind is None:
                os.replace(self._temporary, self._path)
        except OSError as problem:
            raise OutputError(f"{self._path}: {problem}") from problem
        finally:
            self._messages.close()
            with suppress(OSError):  # its folder may be gone
                self._temporary.unlink(missing_ok=True)
