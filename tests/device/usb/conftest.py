"""A tree of files in the place of /sys, /dev and /proc."""

import pytest

from tests.support.usb_tree import UsbTree


@pytest.fixture
def tree(tmp_path):
    return UsbTree(tmp_path)
