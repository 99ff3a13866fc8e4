#!/bin/sh
# Real recordings for the tests: speech of alsa-utils, sounds of sound-theme-freedesktop.
#
# They are unpacked into .cache/recordings (or the folder CUSHION_RECORDINGS, relative to the project):
# alsa/*.wav and freedesktop/*.oga.
set -eu

unset CDPATH
cd "$(dirname "$0")/.."
. tools/unpacked_files.sh
who=recordings
consequence='the tests that need them will skip'

begin_folder "${CUSHION_RECORDINGS:-.cache/recordings}"
download_packages alsa-utils sound-theme-freedesktop
for package in "$partial"/*.deb; do
    dpkg-deb -x "$package" "$partial/unpacked"
done
mkdir "$partial/ready/alsa" "$partial/ready/freedesktop"
# links are other names of the same sounds: left out
sounds=$partial/unpacked/usr/share/sounds
find "$sounds/alsa" -type f -name '*.wav' -exec cp {} "$partial/ready/alsa" \;
find "$sounds/freedesktop" -type f -name '*.oga' -exec cp {} "$partial/ready/freedesktop" \;
finish_folder 1
