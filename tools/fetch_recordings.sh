#!/bin/sh
# Real recordings for the tests: speech of alsa-utils, sounds of sound-theme-freedesktop.
#
# Both Debian packages are downloaded and unpacked, not installed, into .cache/recordings (or the folder
# CUSHION_RECORDINGS, relative to the project): alsa/*.wav and freedesktop/*.oga. The folder appears whole
# or not at all. Where the packages cannot be had this says so and exits 0: the tests then skip.
set -eu

unset CDPATH
cd "$(dirname "$0")/.."
cache=${CUSHION_RECORDINGS:-.cache/recordings}
cache=${cache%/}

say() { printf 'recordings: %s\n' "$*" >&2; }

without() {
    say "none: $*; the tests that need them will skip"
    exit 0
}

if [ -d "$cache" ] && [ -n "$(ls -A "$cache")" ]; then
    exit 0
fi
for tool in apt-get dpkg-deb; do
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

download() {
    (cd "$partial" && apt-get -q -o APT::Sandbox::User=root download alsa-utils sound-theme-freedesktop) \
        >/dev/null 2>&1
}

update() {
    # shellcheck disable=SC2086
    $elevate apt-get -q -o DPkg::Lock::Timeout=120 update >/dev/null 2>&1 </dev/null
}

if ! download && ! { update && download; }; then
    if apt-cache show alsa-utils sound-theme-freedesktop >/dev/null 2>&1; then
        without "apt-get cannot download alsa-utils and sound-theme-freedesktop (no network?)"
    fi
    without "apt-get knows no alsa-utils and sound-theme-freedesktop (run: sudo apt-get update)"
fi

mkdir "$partial/unpacked" "$partial/ready" "$partial/ready/alsa" "$partial/ready/freedesktop"
for package in "$partial"/*.deb; do
    dpkg-deb -x "$package" "$partial/unpacked"
done
# links are other names of the same sounds: left out
find "$partial/unpacked/usr/share/sounds/alsa" -type f -name '*.wav' -exec cp {} "$partial/ready/alsa" \;
find "$partial/unpacked/usr/share/sounds/freedesktop" -type f -name '*.oga' -exec cp {} "$partial/ready/freedesktop" \;
count=$(find "$partial/ready" -type f | wc -l)
[ "$count" -gt 0 ] || without "alsa-utils and sound-theme-freedesktop no longer contain sounds"

# an empty folder gives way; a full one means that somebody else was quicker
if mv -T "$partial/ready" "$cache" 2>/dev/null; then
    say "$count files in $cache"
elif [ ! -d "$cache" ]; then
    say "error: $cache cannot be made"
    exit 1
fi
