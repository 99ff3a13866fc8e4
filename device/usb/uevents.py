"""The kernel's own word that devices come and go: something to wait for, where it may be heard.

It only says when to look; what is there is read from /sys. Nothing depends on it: containers often
get no such messages although the socket opens, and polling finds the same a little later.
"""

from __future__ import annotations

import socket

_PROTOCOL = 15
"""NETLINK_KOBJECT_UEVENT (linux/netlink.h)."""

_KERNEL_GROUP = 1
"""Messages of the kernel; group 2 has udevd's, which not every machine has."""

_LONGEST = 16_384
"""Bytes; the kernel's own are below 2.5 kB (UEVENT_BUFFER_SIZE)."""

_SUBSYSTEMS = (b"SUBSYSTEM=usb", b"SUBSYSTEM=sound")


class Uevents:
    """An open socket of messages from the kernel, which never makes the caller wait.

    channel: the socket, non-blocking, one message a datagram. One thread may use it.
    """

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel

    @classmethod
    def open(cls) -> Uevents | None:
        """Return the socket, None where this machine or container has none."""
        try:
            channel = socket.socket(
                socket.AF_NETLINK, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK, _PROTOCOL
            )
        except (OSError, AttributeError):
            return None
        try:
            channel.bind((0, _KERNEL_GROUP))
        except OSError:
            channel.close()
            return None
        return cls(channel)

    def fileno(self) -> int:
        """Return the descriptor to select on; it is readable when there is something to drain."""
        return self._channel.fileno()

    def drain(self) -> bool:
        """Take all messages that are there. Returns whether USB or sound devices may have changed.

        Messages that were lost, because too many came, count as a change.
        """
        changed = False
        while True:
            try:
                message = self._channel.recv(_LONGEST)
            except BlockingIOError:
                return changed
            except OSError:  # ENOBUFS: some were lost
                return True
            if not message:
                return changed
            changed = changed or any(part in _SUBSYSTEMS for part in message.split(b"\0"))

    def close(self) -> None:
        """Close the socket; more than once does no harm."""
        self._channel.close()
