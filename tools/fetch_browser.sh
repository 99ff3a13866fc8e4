#!/bin/sh
# What the tests marked `browser` need besides a sound server: Debian's Chromium.
set -eu

. "$(dirname "$0")/system_packages.sh"

install_packages browser chromium fonts-dejavu-core
