#!/bin/sh
# Real sounds for the bench: explosions, shots, engines, footsteps, ambience, speech, music, drums.
#
# The Debian packages that tools/bench/sounds/real_sounds.txt names (600 MB) are downloaded, not installed, and
# the files that it chooses are unpacked into .cache/sounds/CLASS/ (or the folder CUSHION_SOUNDS, relative to the
# project; 100 MB). The folder appears whole or not at all. Where the packages cannot be had this says so and
# exits 0: the bench then lists what it could not measure.
set -eu

unset CDPATH
cd "$(dirname "$0")/.."
cache=${CUSHION_SOUNDS:-.cache/sounds}
cache=${cache%/}
list=tools/bench/sounds/real_sounds.txt

say() { printf 'sounds: %s\n' "$*" >&2; }

without() {
    say "none: $*; the bench leaves out what needs them"
    exit 0
}

if [ -d "$cache" ] && [ -n "$(ls -A "$cache")" ]; then
    exit 0
fi
for tool in apt-get dpkg-deb python3; do
    command -v "$tool" >/dev/null 2>&1 || without "they come from Debian's packages and $tool is not here"
done

mkdir -p "$(dirname "$cache")"
find "$(dirname "$cache")" -maxdepth 1 -name "$(basename "$cache").part.*" -mmin +60 -exec rm -rf {} +
partial=$(mktemp -d "$cache.part.XXXXXX")
partial=$(cd "$partial" && pwd)
trap 'rm -rf "$partial"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
chmod 755 "$partial"

elevate=
if [ "$(id -u)" -ne 0 ]; then
    elevate='sudo -n'
fi
packages=$(sed -n 's/^[a-z]\{1,\} \{1,\}\([^ ]*\) .*/\1/p' "$list" | sort -u)

download() {
    # shellcheck disable=SC2086
    (cd "$partial" && apt-get -q -o APT::Sandbox::User=root download $packages) >/dev/null 2>&1
}

update() {
    # shellcheck disable=SC2086
    $elevate apt-get -q -o DPkg::Lock::Timeout=120 update >/dev/null 2>&1 </dev/null
}

if ! download && ! { update && download; }; then
    # shellcheck disable=SC2086
    without "apt-get cannot download" $packages "(no network, or run: sudo apt-get update)"
fi

mkdir "$partial/ready"
python3 tools/bench/sounds/unpack_sounds.py "$list" "$partial/ready" "$partial" || without "they cannot be unpacked"
count=$(find "$partial/ready" -type f | wc -l)
[ "$count" -ge 150 ] || without "the packages no longer contain them ($count files)"

# an empty folder gives way; a full one means that somebody else was quicker
if mv -T "$partial/ready" "$cache" 2>/dev/null; then
    say "$count files in $cache"
elif [ ! -d "$cache" ]; then
    say "error: $cache cannot be made"
    exit 1
fi
