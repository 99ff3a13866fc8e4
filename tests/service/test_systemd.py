"""What systemd is told."""

from __future__ import annotations

import os
import socket

import pytest

from audioflinger_hook.service.systemd import Notifier


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A service manager's socket, and the name of it that a service is given."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        name = f"{tmp_path.name}-{os.getpid()}"
        if request.param == "path":
            # pytest's folders may be deeper than an address is long
            link = f"/proc/self/fd/{os.open(tmp_path, os.O_PATH)}/notify"
            end.bind(link)
            given = link
        else:
            end.bind(f"\0{name}")
            given = f"@{name}"
        end.settimeout(5.0)
        yield end, given
        if request.param == "path":
            os.close(int(link.split("/")[4]))


def test_every_message_arrives_as_systemd_reads_it(manager):
    end, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name})
    sent = [
        (("READY=1",), "running", b"READY=1\nSTATUS=running"),
        ((), "waiting-for-device", b"STATUS=waiting-for-device"),
        (("RELOADING=1", "MONOTONIC_USEC=12"), "", b"RELOADING=1\nMONOTONIC_USEC=12"),
        (("WATCHDOG=1",), "", b"WATCHDOG=1"),
    ]
    for assignments, status, message in sent:
        assert notifier.send(*assignments, status=status)
        assert end.recv(4096) == message


def test_a_status_cannot_smuggle_in_another_assignment(manager):
    end, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name})
    notifier.send(status="no sink\nMAINPID=1\udc80")
    assert end.recv(4096) == b"STATUS=no sink MAINPID=1?"


@pytest.mark.parametrize("name", ["", "@", "/", "relative", "vsock:2:1234"])
def test_without_a_manager_nothing_is_sent(name):
    notifier = Notifier({"NOTIFY_SOCKET": name} if name else {})
    assert not notifier.send("READY=1")


@pytest.mark.parametrize("name", ["/no/such/socket", "@no-such-socket", "/" + "x" * 300, "/a\0b"])
def test_a_manager_that_is_gone_does_not_disturb(name):
    notifier = Notifier({"NOTIFY_SOCKET": name})
    assert not notifier.send("WATCHDOG=1")


def test_a_manager_that_reads_nothing_is_not_waited_for_long(manager):
    _, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name})
    sent = 0
    while notifier.send(status="x" * 200):
        sent += 1
        assert sent < 100_000
