#!/bin/sh
# Builds core.wasm: the core of the live form as WebAssembly, for the page "Try it".
#
# usage: tools/wasm/build.sh [OUT]    the file in the repository where OUT is not given
#
# The compiler is the clang in the package ziglang of constraints.txt; PYTHON has that package (by default
# that of .venv). It gives the same bytes at each run and from every folder. The result imports
# nothing: the core takes no memory, and the C library that comes with clang compares strings for it.
set -eu

cd "$(dirname "$0")/../.."
out=${1:-audioflinger_hook/monitor/static/try/core.wasm}
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
${PYTHON:-.venv/bin/python} -m ziglang cc -target wasm32-wasi -mexec-model=reactor -fno-lto \
    -msimd128 -mbulk-memory -std=gnu11 -Os -g0 -s -ffp-contract=off -fno-math-errno \
    -fno-sanitize=undefined -fno-stack-protector -Wno-pass-failed -Wall -Wextra \
    -Wl,--no-entry -Wl,--gc-sections -Wl,-z,stack-size=65536 -Wl,--export=__heap_base \
    -Wl,--export=core_sizes -Wl,--export=core_check -Wl,--export=core_open -Wl,--export=core_process \
    -o "$made/core.wasm" \
    audioflinger_hook/core/*.c audioflinger_hook/core/drive/*.c audioflinger_hook/transform/native/*.c
chmod 644 "$made/core.wasm"
cp "$made/core.wasm" "$out"
