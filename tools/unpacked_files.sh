#!/bin/sh
# Sourced by the scripts that unpack files of Debian's packages, which are not installed, into a folder. The folder
# appears whole or not at all. Where it cannot be had the script says so and ends with 0.
#
#   begin_folder FOLDER PROGRAM...    ends the script where the folder has files; makes the scratch folder $partial
#   download_packages PACKAGE...      into $partial
#   finish_folder LEAST               makes $partial/ready the folder, if it has so many files
#
# Set `who` and `consequence` before: whose lines they are, and what happens without the files.

. tools/system_packages.sh

begin_folder() {
    folder=${1%/}
    shift
    if [ -d "$folder" ] && [ -n "$(ls -A "$folder")" ]; then
        exit 0
    fi
    for program in apt-get dpkg-deb "$@"; do
        command -v "$program" >/dev/null 2>&1 || without "they come from Debian's packages and $program is not here"
    done
    parent=$(dirname "$folder")
    mkdir -p "$parent"
    find "$parent" -maxdepth 1 -name "$(basename "$folder").part.*" -mmin +60 -exec rm -rf {} +
    partial=$(mktemp -d "$folder.part.XXXXXX")
    partial=$(cd "$partial" && pwd)
    trap 'rm -rf "$partial"' EXIT
    trap 'exit 130' INT
    trap 'exit 143' TERM
    chmod 755 "$partial"
    mkdir "$partial/ready"
}

download() {
    (cd "$partial" && apt-get -q -o APT::Sandbox::User=root download "$@") >/dev/null 2>&1
}

download_packages() {
    download "$@" || { apt_get update && download "$@"; } ||
        without "apt-get cannot download $* (no network, or run: sudo apt-get update)"
}

finish_folder() {
    count=$(find "$partial/ready" -type f | wc -l)
    [ "$count" -ge "$1" ] || without "the packages no longer contain them ($count files)"
    # an empty folder gives way; a full one means that somebody else was quicker
    if mv -T "$partial/ready" "$folder" 2>/dev/null; then
        say "$count files in $folder"
    elif [ ! -d "$folder" ]; then
        say "error: $folder cannot be made"
        exit 1
    fi
}
