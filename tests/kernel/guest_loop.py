"""Recorded video through a real capture device: what vivid is told to put out comes back on its input."""

import ctypes
import select
import threading

import numpy as np

from drivers.v4l2.calls import LinuxCalls, Node
from drivers.v4l2.constants import MEMORY_MMAP, BufferType, FieldOrder, StandardBits, fourcc
from drivers.v4l2.structs import BufferDescription, Format, Request, RequestBuffers
from tests.kernel.conftest import settled

S_OUTPUT = 0xC004562F
"""VIDIOC_S_OUTPUT, which a grabber has no use for."""
OUT = BufferType.VIDEO_OUTPUT
SIZE_PX = (720, 576)


class Player:
    """Puts pictures out in turn, each as often as the device takes them, until stopped."""

    def __init__(self, path: str, pictures: list[np.ndarray]):
        self._pictures = pictures
        self._node = Node.open(LinuxCalls(), path)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._play, name="player")
        self._set_up()
        self._memory = self._buffers(4)

    def _set_up(self):
        self._node.system.ioctl(self._node.fd, S_OUTPUT, ctypes.c_int(0))
        self._node.ask(Request.S_STD, ctypes.c_uint64(StandardBits.PAL))
        wish = Format(type=OUT)
        wish.fmt.pix.width, wish.fmt.pix.height = SIZE_PX
        wish.fmt.pix.pixelformat, wish.fmt.pix.field = fourcc("GREY"), FieldOrder.INTERLACED
        granted = self._node.ask(Request.S_FMT, wish).fmt.pix
        assert (granted.width, granted.height, granted.pixelformat) == (*SIZE_PX, fourcc("GREY"))

    def _buffers(self, count: int) -> list:
        count = self._node.ask(Request.REQBUFS, RequestBuffers(count=count, type=OUT, memory=MEMORY_MMAP)).count
        told = [self._node.ask(Request.QUERYBUF, self._description(index)) for index in range(count)]
        return [self._node.system.mmap(self._node.fd, b.length, b.m.offset) for b in told]

    def _description(self, index: int, used: int = 0) -> BufferDescription:
        return BufferDescription(index=index, type=OUT, memory=MEMORY_MMAP, bytesused=used, field=FieldOrder.INTERLACED)

    def _play(self):
        for number in range(len(self._memory)):
            self._put(number, number)
        self._node.ask(Request.STREAMON, ctypes.c_int(OUT))
        number = len(self._memory)
        poll = select.poll()
        poll.register(self._node.fd, select.POLLOUT)
        while not self._over.is_set():
            if poll.poll(200):
                self._put(self._node.ask(Request.DQBUF, self._description(0)).index, number)
                number += 1

    def _put(self, index: int, number: int):
        picture = self._pictures[number % len(self._pictures)]
        self._memory[index][: picture.nbytes] = picture.tobytes()
        self._node.ask(Request.QBUF, self._description(index, picture.nbytes))

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join(10.0)
        self._node.ask(Request.STREAMOFF, ctypes.c_int(OUT))
        for memory in self._memory:
            memory.close()
        self._node.close()


def numbered(picture: np.ndarray, number: int) -> np.ndarray:
    """Put a picture on a grey canvas, whose last line says which one it is."""
    canvas = np.full(SIZE_PX[::-1], 90, np.uint8)
    canvas[: picture.shape[0], : picture.shape[1]] = picture
    canvas[-1] = number
    return canvas


def test_recorded_video_comes_back_bit_for_bit(vivid, exchange, measured):
    pictures = np.load(exchange / "pictures.npy")
    height, width = pictures.shape[1:]
    canvases = [numbered(picture, number) for number, picture in enumerate(pictures)]
    vivid.set("Loop Video")
    caught = {}
    with vivid.grabber(size_px=SIZE_PX) as grabber, Player(vivid.nodes()[1], canvases):
        grabber.start()
        settled(lambda: not grabber.read(10.0).pixels[-1].any(), "the first picture", 60.0)
        for _ in range(20 * len(canvases)):
            frame = grabber.read(10.0)
            number = int(frame.pixels[-1, 0])
            assert frame.defect is None
            np.testing.assert_array_equal(frame.pixels, canvases[number])
            caught.setdefault(number, frame.pixels[:height, :width].copy())
            if len(caught) == len(canvases):
                break
        measured(f"{len(caught)} of {len(canvases)} pictures came back bit for bit")
    assert len(caught) == len(canvases)
    np.save(exchange / "caught.npy", np.stack([caught[number] for number in range(len(canvases))]))
