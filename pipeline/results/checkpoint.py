"""Checkpoints: everything that a run needs to continue bit for bit, with a checksum; the last two are kept.

A file is a SHA-256 in hexadecimal, a line of JSON (step, energy guard, effort since the last frame, summary of the
written frames) and an .npz of float64 arrays. It is written after a step and before that step's frame, once every frame
of an earlier step is on the disk.
"""

import io
import json
import shutil
import time
import zipfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from pipeline.errors import OutputError
from pipeline.formats.atomic import write_whole
from pipeline.linear.work import Work
from pipeline.run.recording import RunSummary
from pipeline.stepping.report import Effort, ModelChoice
from pipeline.stepping.state import EnergyRecord, Memory, State

_COUNT = 2
_OWNERS = ("stepper", "inversion")  # of the arrays in a state's memory: stored as "owner.name"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A state, the effort since the last frame and the summary of the written frames."""

    state: State
    effort: Effort
    summary: RunSummary


class CheckpointFolder:
    """Keeps the last two checkpoints of a run in a folder; at least `seconds` pass between two."""

    def __init__(self, folder: Path, *, seconds: float) -> None:
        self.folder = Path(folder)
        self.seconds = seconds
        self._since: float | None = None  # from the first step, so that compiling kernels does not count

    def is_due(self, solved: float) -> bool:
        """Return whether a checkpoint is due; `solved` is the solving time since the first step [s]."""
        now = time.monotonic()
        if self._since is None:
            self._since = now - solved
        return now - self._since >= self.seconds

    def write(self, checkpoint: Checkpoint) -> None:
        """Write a checkpoint and remove all but the last two; raises OutputError."""
        write_whole(self.folder / f"step_{checkpoint.state.step:09d}.checkpoint", encode_checkpoint(checkpoint))
        for old in self._paths()[_COUNT:]:
            old.unlink(missing_ok=True)
        self._since = time.monotonic()

    def iterate_readable(self) -> Iterator[Checkpoint | str]:
        """Yield the checkpoints, the latest first, with a note in place of each damaged one."""
        for path in self._paths():
            try:
                yield decode_checkpoint(path.read_bytes())
            except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
                yield f"{path}: damaged ({error}); the checkpoint before it is used instead"

    def remove(self) -> None:
        """Remove the folder, which a run that has ended no longer needs."""
        try:
            if self.folder.exists():
                shutil.rmtree(self.folder)
        except OSError as error:
            raise OutputError(f"{self.folder}: cannot be removed ({error.strerror})") from error

    def _paths(self) -> list[Path]:
        return sorted(self.folder.glob("step_*.checkpoint"), reverse=True)


def encode_checkpoint(checkpoint: Checkpoint) -> bytes:
    """Return the bytes of a checkpoint file."""
    state = checkpoint.state
    arrays = {"x": state.x, "v": state.v}
    for owner in _OWNERS:
        arrays |= {f"{owner}.{name}": value for name, value in getattr(state.memory, owner).items()}
    numbers = {
        "step": state.step,
        "energy": state.memory.energy,
        "work": asdict(checkpoint.effort.work),
        "choices": checkpoint.effort.choices,
        "summary": asdict(checkpoint.summary),
    }
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    # JSON writes the repr of a float, which reads back as the same float
    body = json.dumps(numbers).encode() + b"\n" + file.getvalue()
    return sha256(body).hexdigest().encode() + b"\n" + body


def decode_checkpoint(data: bytes) -> Checkpoint:
    """Return the checkpoint in the bytes of a file; raises ValueError if they are damaged."""
    checksum, _, body = data.partition(b"\n")
    if sha256(body).hexdigest().encode() != checksum:
        raise ValueError("its checksum is wrong")
    line, _, archive = body.partition(b"\n")
    numbers = json.loads(line)
    with np.load(io.BytesIO(archive), allow_pickle=False) as arrays:
        named = {
            owner: {
                name.removeprefix(f"{owner}."): arrays[name] for name in arrays.files if name.startswith(f"{owner}.")
            }
            for owner in _OWNERS
        }
        energy = None if numbers["energy"] is None else EnergyRecord(*numbers["energy"])
        state = State(numbers["step"], arrays["x"], arrays["v"], Memory(**named, energy=energy))
    effort = Effort(Work(**numbers["work"]), tuple(ModelChoice(*choice) for choice in numbers["choices"]))
    summary = numbers["summary"]
    return Checkpoint(state, effort, RunSummary(**summary | {"work": Work(**summary["work"])}))
