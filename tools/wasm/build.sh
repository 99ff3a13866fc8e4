#!/bin/sh
# Builds core.wasm: the core of the live form as WebAssembly, for the page "Try it".
#
# usage: tools/wasm/build.sh [OUT]    the file in the repository where OUT is not given
#
# The compiler is the clang in the package ziglang of constraints.txt; PYTHON has that package (by default
# that of .venv). It gives the same bytes on every machine and from every folder. The result imports
# nothing: the core takes no memory, and strings.c has what it calls of the C library.
set -eu

cd "$(dirname "$0")/../.."
out=${1:-audioflinger_hook/monitor/static/try/core.wasm}
zig="${PYTHON:-.venv/bin/python} -m ziglang"
objects=$(mktemp -d)
trap 'rm -rf "$objects"' EXIT
for source in audioflinger_hook/core/*.c audioflinger_hook/core/drive/*.c audioflinger_hook/transform/native/*.c \
    tools/wasm/strings.c; do
    $zig cc -target wasm32-wasi -msimd128 -mbulk-memory -std=gnu11 -Os -g0 -ffp-contract=off -fno-math-errno \
        -fno-sanitize=undefined -fno-stack-protector -Wno-pass-failed -Wall -Wextra \
        -c -o "$objects/$(basename "$source" .c).o" "$source"
done
$zig wasm-ld --no-entry --gc-sections --strip-all -z stack-size=65536 --export=__heap_base --export=core_sizes \
    --export=core_check --export=core_open --export=core_process -o "$objects/core.wasm" "$objects"/*.o
chmod 644 "$objects/core.wasm"
cp "$objects/core.wasm" "$out"
