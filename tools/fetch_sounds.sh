#!/bin/sh
# Real sounds for the bench: explosions, shots, engines, footsteps, ambience, speech, music, drums.
#
# Of the packages that tools/bench/sounds/real_sounds.txt names (600 MB), the files that it chooses (100 MB) are
# unpacked into .cache/sounds/CLASS/ (or the folder CUSHION_SOUNDS, relative to the project).
set -eu

unset CDPATH
cd "$(dirname "$0")/.."
. tools/unpacked_files.sh
who=sounds
consequence='the bench leaves out what needs them'
list=tools/bench/sounds/real_sounds.txt

begin_folder "${CUSHION_SOUNDS:-.cache/sounds}" python3
# shellcheck disable=SC2046
download_packages $(sed -n 's/^[a-z]\{1,\} \{1,\}\([^ ]*\) .*/\1/p' "$list" | sort -u)
python3 tools/bench/sounds/unpack_sounds.py "$list" "$partial/ready" "$partial" || without "they cannot be unpacked"
finish_folder 150
