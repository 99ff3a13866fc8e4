#!/bin/sh
# Builds the wheels for x86-64 and ARM64 Linux into dist/, on either: one wheel serves every Python.
#
# usage: tools/wheels.sh [ARCHITECTURE...]    x86_64 and aarch64 where not given; after tools/setup.sh test
#
# The compiler is the clang in the package ziglang of constraints.txt. It brings the symbols of every
# glibc, so that the libraries need no newer one than named here.
set -eu

cd "$(dirname "$0")/.."
python=$(pwd -P)/.venv/bin/python
glibc=2.28
[ $# -gt 0 ] || set -- x86_64 aarch64
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

"$python" -m pip install --quiet --constraint constraints.txt ziglang setuptools
mkdir -p dist
for machine; do
    # a folder of its own each: a library of the other would count as built
    source=$scratch/$machine
    mkdir "$source"
    cp -R audioflinger_hook device share pyproject.toml setup.py README.md LICENSE "$source"
    find "$source" -name '*.so' -exec rm {} +
    # a sanitizer that zig turns on itself would need its library at run time
    (
        cd "$source"
        CC="$python -m ziglang cc -target $machine-linux-gnu.$glibc -fno-sanitize=undefined" \
            CFLAGS= LDFLAGS=-s "$python" setup.py -q bdist_wheel \
            --plat-name "manylinux_$(echo $glibc | tr . _)_$machine" --dist-dir "$scratch/dist"
    ) >"$scratch/log" 2>&1 || {
        cat "$scratch/log" >&2
        exit 1
    }
    for library in audioflinger_hook/core/haptic_cushion.so device/blocks_library.so; do
        find "$source/build" -path "*/$library" | grep -q . || {
            cat "$scratch/log" >&2
            echo "wheels: error: $library was not built for $machine" >&2
            exit 1
        }
    done
done
rm -f dist/haptic_cushion-*.whl
mv "$scratch"/dist/*.whl dist/
ls dist/*.whl
