"""Messages between processes: they arrive unchanged, and bytes that are no message are recognized."""

import os
import pickle
import threading
import time

import numpy as np
import pytest

from pipeline.errors import OutputError
from pipeline.system import child
from pipeline.system.channel import Channel
from pipeline.system.child import ChildProcess


@pytest.fixture
def loop():
    """A Channel whose messages come back to itself."""
    reading, writing = os.pipe()
    with open(reading, "rb") as incoming, open(writing, "wb") as outgoing:
        yield Channel(incoming, outgoing.fileno())


def send_and_receive(channel, message, **options):
    thread = threading.Thread(target=channel.send, args=(message,))  # it waits for the reader if the pipe is full
    thread.start()
    answer = channel.receive(**options)
    thread.join()
    return answer


@pytest.mark.parametrize("trusted", [True, False])
@pytest.mark.parametrize("count", [1, 3, 2500])
@pytest.mark.parametrize("size", [0, 5, 100_000])
def test_messages_arrive_unchanged(loop, size, count, trusted):
    """Also more arrays than one call of the system can write, empty ones, and those that are not contiguous."""
    if size * count > 10**7:
        count = 20
    arrays = [np.arange(size) + i for i in range(count)]
    fixed = np.arange(3.0)
    fixed.flags.writeable = False
    odd = np.eye(4)[:, ::2]
    message = {
        "arrays": arrays,
        "odd": odd,
        "fixed": fixed,
        "number": np.asarray(1.5),
        "text": "ü",
        "n": 3,
    }
    answer = send_and_receive(loop, message, trusted=trusted)
    assert answer.keys() == message.keys() and (answer["text"], answer["n"]) == ("ü", 3)
    for sent, received in zip(arrays, answer["arrays"], strict=True):
        assert np.array_equal(sent, received) and sent.dtype == received.dtype and received.flags.writeable
    assert np.array_equal(answer["odd"], message["odd"]) and answer["number"] == 1.5
    assert not answer["fixed"].flags.writeable


def test_large_arrays_are_not_copied(loop, monkeypatch):
    big, parts = np.zeros(10**6), []
    genuine = os.writev

    def write(descriptor, buffers):
        parts.extend(buffers)
        return genuine(descriptor, buffers)

    monkeypatch.setattr(os, "writev", write)
    send_and_receive(loop, big)
    assert any(np.shares_memory(np.frombuffer(part, dtype=np.uint8), big) for part in parts)


def test_an_untrusted_message_calls_nothing(loop):
    with pytest.raises(pickle.UnpicklingError, match="is not an array"):
        send_and_receive(loop, OutputError("not an array"), trusted=False)


def test_other_bytes_and_an_early_end_are_recognized():
    for content, error in ((b"none of ours", pickle.UnpicklingError), (b"", EOFError), (b"MSG\n\x01", EOFError)):
        reading, writing = os.pipe()
        with open(reading, "rb") as incoming:
            os.write(writing, content)
            os.close(writing)
            with pytest.raises(error):
                Channel(incoming, -1).receive()


def echo(channel: Channel) -> None:
    while True:
        try:
            message = channel.receive()
        except EOFError:
            return
        print("a print is no message")
        channel.send((message, os.environ["OMP_NUM_THREADS"]))


def test_a_child_answers_until_it_is_closed():
    process = ChildProcess("tests.system.test_channel:echo", name="the echo", quiet=True)
    process.send([1, 2])
    assert process.receive() == ([1, 2], "1") and process.is_alive()
    process.close(patience=60.0)
    assert not process.is_alive() and process.wait() == 0


def test_a_child_without_patience_is_killed():
    process = ChildProcess("time:sleep", name="the sleeper", quiet=True)
    began = time.monotonic()
    process.close()
    assert process.wait() != 0 and time.monotonic() - began < 10


def test_a_child_that_cannot_be_started_is_named(monkeypatch):
    monkeypatch.setattr(child.sys, "executable", "/no/python")
    with pytest.raises(OutputError, match=r"^the echo cannot be started \(No such file or directory\)$"):
        ChildProcess("tests.system.test_channel:echo", name="the echo")
