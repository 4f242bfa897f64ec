"""Frames handed on by a thread: order, bounds, failures."""

import threading

import pytest

from pipeline.errors import OutputError, SolveError
from pipeline.frame import Frame
from pipeline.mesh.shapes import box
from pipeline.run import Recording, drive
from pipeline.sinks.overlapped import Overlapped

MESH = box((1.0, 1.0, 1.0), (1, 1, 1))
PATIENCE = 30.0  # seconds until a test that would wait for ever fails instead


class Listing:
    """Keeps the indices of the frames it got; calls `before` with each first."""

    def __init__(self, before=lambda frame: None) -> None:
        self.before, self.indices, self.closed = before, [], 0

    def write(self, frame, measured):
        self.before(frame)
        self.indices.append(frame.index)

    def close(self):
        self.closed += 1


def some_frames(count: int, before=lambda index: None):
    for index in range(count):
        before(index)
        yield Frame(index, 0.1 * index, MESH, MESH.points * (1 + 0.01 * index))


def overlapped(source, sinks, **options):
    recording = Recording(sinks)
    drive(source, Overlapped(recording, **options))
    return recording


def failing(frame):
    if frame.index == 2:
        raise OutputError(f"frame {frame.index}: no room")


def test_a_frame_is_written_while_the_next_one_is_solved():
    solved = threading.Event()
    sink = Listing(lambda frame: frame.index or solved.wait(PATIENCE) or pytest.fail("nothing was solved meanwhile"))
    overlapped(some_frames(3, lambda index: index == 2 and solved.set()), [sink])
    assert sink.indices == [0, 1, 2] and sink.closed == 1


def test_the_queue_is_bounded_and_keeps_the_order():
    go, solved = threading.Event(), []
    sink = Listing(lambda frame: go.wait(PATIENCE))
    run = threading.Thread(target=lambda: overlapped(some_frames(20, solved.append), [sink], waiting=2))
    run.start()
    run.join(0.3)
    # one being written, two waiting, one that has no room
    assert run.is_alive() and sink.indices == [] and len(solved) <= 4
    go.set()
    run.join(PATIENCE)
    assert sink.indices == list(range(20)) and sink.closed == 1


def test_drain_returns_when_all_is_written_and_raises_what_failed():
    sink, other = Listing(failing), Listing()
    writer = Overlapped(Recording([sink, other]))
    for frame in some_frames(2):
        writer.take(frame)
    writer.drain()
    assert sink.indices == other.indices == [0, 1]
    writer.take(next(iter(some_frames(1))))
    writer.take(list(some_frames(3))[2])
    with pytest.raises(OutputError, match="frame 2: no room"):
        writer.drain()
    writer.close()  # told once
    assert other.indices == [0, 1, 0] and (sink.closed, other.closed) == (1, 1)


def test_a_writer_that_fails_stops_the_run_with_its_own_message():
    solved = []
    sink, other = Listing(failing), Listing()
    with pytest.raises(OutputError, match="frame 2: no room"):
        overlapped(some_frames(1000, solved.append), [other, sink], waiting=1)
    assert len(solved) <= 6 and sink.indices == [0, 1] and other.indices == [0, 1, 2]
    assert (sink.closed, other.closed) == (1, 1)


def test_a_failure_at_the_last_frame_is_raised_on_closing():
    with pytest.raises(OutputError, match="frame 2: no room"):
        overlapped(some_frames(3), [Listing(failing)])


def test_what_cannot_be_closed_is_told_and_the_others_are_closed():
    class Stuck(Listing):
        def close(self):
            raise OutputError("cannot be closed")

    other = Listing()
    with pytest.raises(OutputError, match="cannot be closed"):
        overlapped(some_frames(3), [Stuck(), other])
    assert other.closed == 1 and other.indices == [0, 1, 2]


def test_a_solver_that_fails_leaves_the_frames_before_it():
    def broken(index):
        if index == 3:
            raise SolveError("diverged")

    sink = Listing()
    with pytest.raises(SolveError, match="diverged"):
        overlapped(some_frames(9, broken), [sink])
    assert sink.indices == [0, 1, 2] and sink.closed == 1
    assert [thread.name for thread in threading.enumerate() if thread.name == "writer"] == []


def test_nothing_written_closes_what_it_has():
    sink = Listing()
    Overlapped(Recording([sink])).close()
    assert sink.closed == 1


def test_the_seconds_of_writing_are_those_of_the_writer():
    recording = overlapped(some_frames(5), [Listing(lambda frame: threading.Event().wait(0.02))], waiting=100)
    assert 5 * 0.02 <= recording.summary.writing_seconds <= recording.summary.wall_seconds + 1e-6
