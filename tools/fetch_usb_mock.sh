#!/bin/sh
# What the tests of USB devices in software run on: umockdev with its Python bindings, and libusb.
set -eu

. "$(dirname "$0")/system_packages.sh"
install_packages usb-mock umockdev libumockdev0 gir1.2-umockdev-1.0 python3-gi usbutils libusb-1.0-0
