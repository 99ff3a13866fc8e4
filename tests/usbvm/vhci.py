"""A USB DAC in software on this kernel's virtual host controller: all above it is the real thing.

The kernel module vhci_hcd takes a socket and speaks USB/IP over it (Documentation/usb/
usbip_protocol.rst of the kernel, version 1.1.1): control requests go to a `SoftwareDac`, samples
are taken at the pace of the DAC's own clock. For root, on a machine that is there for tests.
"""

import errno
import heapq
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

from tests.support.usb_builder import split
from tests.support.usbmock.software_dac import SoftwareDac

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
FULL_SPEED, HIGH_SPEED = 2, 3
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
IN = 1
HEADER = struct.Struct(">5I")
BEHIND_S = 0.25  # a stream whose clock is further behind has stood still, and begins anew


class VirtualDac:
    """One DAC, plugged in from the moment it is made.

    dac: what it says and answers. ppm: how much faster than nominal its clock runs; with a feedback
    endpoint it asks for that many more frames, else it takes packets so much faster. take: is given
    the bytes that were played, on a thread of its own. frame_bytes: of one frame.
    """

    def __init__(self, dac: SoftwareDac, take: Callable[[bytes], object], *, ppm=0.0) -> None:
        self.dac = dac
        self._take = take
        self._ppm = ppm
        self._endpoints = {
            each[2]: each
            for each in split(dac.descriptors[18:])
            if each[1] == 5 and each[3] & 3 == 1
        }
        self._feedback = any(each[3] & 0x30 == 0x10 for each in self._endpoints.values())
        self._high_speed = dac.uac > 1
        self._due: list[tuple[float, int]] = []
        self._pending: dict[int, tuple[int, int, bytes, list[tuple[int, int]], int]] = {}
        self._clocks: dict[int, float] = {}
        self._socket, kernels = socket.socketpair()
        self._port = self._free_port()
        self._thread = threading.Thread(target=self._serve, name="virtual-dac", daemon=True)
        self._thread.start()
        speed = HIGH_SPEED if self._high_speed else FULL_SPEED
        (CONTROLLER / "attach").write_text(f"{self._port} {kernels.fileno()} {1 << 16 | 1} {speed}")
        kernels.close()

    def close(self) -> None:
        """Pull it out; once more does nothing."""
        if self._thread.is_alive():
            (CONTROLLER / "detach").write_text(str(self._port))
            self._thread.join(5.0)

    def _free_port(self) -> int:
        for line in (CONTROLLER / "status").read_text().splitlines()[1:]:
            hub, port, status, *_ = line.split()
            if hub == "hs" and int(status) == 4:
                return int(port)
        raise OSError(errno.EBUSY, "all ports of vhci_hcd are taken")

    def _serve(self) -> None:
        try:
            while True:
                wait_s = max(0.0, self._due[0][0] - time.monotonic()) if self._due else None
                readable, _, _ = select.select([self._socket], [], [], wait_s)
                if readable:
                    self._receive()
                while self._due and self._due[0][0] <= time.monotonic():
                    self._complete(heapq.heappop(self._due)[1])
        except (EOFError, OSError):
            self._socket.close()

    def _read(self, count: int) -> bytes:
        read = b""
        while len(read) < count:
            part = self._socket.recv(count - len(read))
            if not part:
                raise EOFError
            read += part
        return read

    def _receive(self) -> None:
        head = self._read(48)
        command, sequence, _, direction, endpoint = HEADER.unpack(head[:20])
        if command == UNLINK:
            (unlinked,) = struct.unpack(">I", head[20:24])
            status = -errno.ECONNRESET if self._pending.pop(unlinked, None) else 0
            head = HEADER.pack(UNLINKED, sequence, 0, 0, 0)
            self._socket.sendall(head + struct.pack(">i24x", status))
            return
        _, length, start, packets, _ = struct.unpack(">IiIiI", head[20:40])
        data = self._read(length) if direction != IN and length > 0 else b""
        places = []
        if endpoint and packets > 0:
            raw = self._read(16 * packets)
            places = [(at, size) for at, size, _, _ in struct.iter_unpack(">4I", raw)]
        if endpoint:
            self._wait(sequence, direction, endpoint, data, places, start)
            return
        answer = self.dac.control(head[40:48], data)
        if answer is None:
            self._reply(sequence, -errno.EPIPE, 0, b"")
        elif direction == IN:
            self._reply(sequence, 0, len(answer), answer)
        else:
            self._reply(sequence, 0, length, b"")

    def _wait(self, sequence, direction, endpoint, data, places, start):
        """Have packets answered when the DAC's clock has come to the end of them."""
        interval = self._endpoints[endpoint | direction << 7][6]
        packet_s = (125e-6 if self._high_speed else 1e-3) * 2 ** (interval - 1)
        if not self._feedback:
            packet_s /= 1.0 + 1e-6 * self._ppm
        now_s = time.monotonic()
        began_s = self._clocks.get(endpoint | direction << 7, -BEHIND_S)
        due_s = (began_s if began_s > now_s - BEHIND_S else now_s) + packet_s * len(places)
        self._clocks[endpoint | direction << 7] = due_s
        self._pending[sequence] = (direction, endpoint, data, places, start)
        heapq.heappush(self._due, (due_s, sequence))

    def _complete(self, sequence: int) -> None:
        pending = self._pending.pop(sequence, None)
        if pending is None:  # unlinked meanwhile
            return
        direction, _, data, places, start = pending
        if direction != IN:
            self._take(b"".join(data[at : at + size] for at, size in places))
            sizes = [(at, size, size, 0) for at, size in places]
            answer = b""
        else:
            frames = self.dac.samplerate * (1.0 + 1e-6 * self._ppm) / 8_000.0
            word = round(frames * 65_536.0).to_bytes(4, "little")
            sizes = [(at, size, 4, 0) for at, size in places]
            answer = word * len(places)
        rest = b"".join(struct.pack(">4I", *each) for each in sizes)
        total = sum(actual for _, _, actual, _ in sizes)
        self._reply(sequence, 0, total, answer + rest, start, len(places))

    def _reply(self, sequence, status, length, data, start=0, packets=0) -> None:
        head = HEADER.pack(SUBMITTED, sequence, 0, 0, 0)
        rest = struct.pack(">iiiiI8x", status, length, start, packets, 0)
        self._socket.sendall(head + rest + data)
