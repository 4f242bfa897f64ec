"""H.264 encoding beside the drawing: a thread feeds ffmpeg, which runs in a process of its own."""

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


def _executable() -> str:
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise OutputError(f"movie: no ffmpeg to encode with ({error}); pip install imageio-ffmpeg") from error


class Encoder:
    """Takes RGB frames and leaves a complete .mp4, or nothing: written beside it and renamed at the end.

    ffmpeg is started directly: imageio_ffmpeg.write_frames lets its messages go to the terminal and does
    not look at its exit code, so that a full disk would pass for success.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self._path = path
        self._temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
        # without these an encoder from elsewhere would pick 4:4:4, which browsers and players cannot show
        video = ["-an", "-c:v", "libx264", "-crf", "20", "-preset", "veryfast", "-pix_fmt", "yuv420p"]
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-"]
        options = ["-hide_banner", "-loglevel", "error", "-y"]
        command = [_executable(), *options, *source, *video, "-movflags", "+faststart", "-f", "mp4"]
        self._messages: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (lives as long as the process)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._process = subprocess.Popen(
                [*command, str(self._temporary)], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                stderr=self._messages,
            )  # fmt: skip
        except OSError as error:
            self._messages.close()
            raise OutputError(f"{path}: the encoder does not start: {error}") from error
        self._queue: Queue[bytes | None] = Queue(WAITING_FRAMES)
        self._broken = False
        self._thread = threading.Thread(target=self._feed, name="movie-encoder", daemon=True)
        self._thread.start()

    def _feed(self) -> None:
        """Hand frames on; after a broken pipe take them without effect, so that nobody waits for ever."""
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
        """Take one frame, RGB row by row; raises OutputError when ffmpeg has given up."""
        if self._broken:
            raise OutputError(self._failure())
        self._queue.put(frame)

    def _failure(self) -> str:
        code = self._process.wait()
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").strip().splitlines()
        return f"{self._path}: the encoder failed (exit code {code}): {' | '.join(lines[-3:]) or 'no message'}"

    def __enter__(self) -> "Encoder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the file and put it in place; after an error of any kind leave nothing of it."""
        if kind is not None:
            self._process.kill()
        self._queue.put(None)
        self._thread.join()
        try:
            failed = self._process.wait() != 0 or self._broken
            if kind is None and failed:
                raise OutputError(self._failure())
            if kind is None:
                os.replace(self._temporary, self._path)
        except OSError as problem:
            raise OutputError(f"{self._path}: {problem}") from problem
        finally:
            self._messages.close()
            with suppress(OSError):  # its folder may have gone
                self._temporary.unlink(missing_ok=True)
