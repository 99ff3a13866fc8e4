#!/bin/sh
# The compiled parts, live form and blocks, under hostile input, with every read, write and operation watched.
#
# usage: tools/check_kernel.sh [ROUNDS]    after tools/setup.sh test; needs gcc with its sanitizers
#
# 1. In a copy, they are built with AddressSanitizer and UndefinedBehaviorSanitizer, and all tests that
#    reach it run ROUNDS times (3 where not given), each with other random examples.
# 2. It is built with the loops for registers of up to 16, 32 and 64 bytes: all must give the same bytes.
# Nothing of the project is changed.
set -eu

cd "$(dirname "$0")/.."
root=$(pwd -P)
rounds=${1-3}
python=$root/.venv/bin/python
compiler=${CC-gcc}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

say() { printf 'check_kernel: %s\n' "$*" >&2; }

# Makes a copy of the sources in the folder $1 and builds the kernel there with the further flags $2.
build() {
    mkdir -p "$1"
    cp -R audioflinger_hook device tests tools pyproject.toml setup.py README.md LICENSE "$1"
    find "$1" -name '*.so' -exec rm {} +
    (
        cd "$1"
        CC=$compiler CFLAGS=$2 LDFLAGS=$2 "$python" setup.py -q build_ext --inplace >"$scratch/log" 2>&1
        CC=$compiler CFLAGS=$2 "$python" -m tests.support.kernel_probes >>"$scratch/log" 2>&1
        ls audioflinger_hook/core/haptic_cushion.so device/blocks_library.so >/dev/null
    ) || {
        cat "$scratch/log" >&2
        exit 1
    }
}

say "building with sanitizers"
build "$scratch/watched" '-g -fno-omit-frame-pointer -fsanitize=address,undefined -fsanitize=float-cast-overflow
-fno-sanitize-recover=all -DONE_MACHINE'
watch=$("$compiler" -print-file-name=libasan.so):$("$compiler" -print-file-name=libubsan.so)
round=0
while [ "$round" -lt "$rounds" ]; do
    round=$((round + 1))
    say "round $round of $rounds"
    (
        cd "$scratch/watched"
        # Python does not give back at its end all that it took: leaks are looked for in other tests.
        LD_PRELOAD=$watch CUSHION_RECORDINGS=$root/.cache/recordings \
            ASAN_OPTIONS=detect_leaks=0:log_path=$scratch/report \
            UBSAN_OPTIONS=print_stacktrace=1:log_path=$scratch/report \
            "$python" -m pytest -q -p no:cacheprovider --hypothesis-seed="$round" \
            -k 'not no_more_memory and not memory_back' \
            tests/transform/test_exact.py tests/transform/test_kernel.py tests/transform/test_analysis.py \
            tests/transform/test_parameters.py tests/transform/test_downmix.py tests/core tests/device/drive \
            tests/device/test_blocks.py tests/device/clock/test_delay_line.py
    ) || {
        cat "$scratch"/report* >&2 || true # a process that ends in the middle of a test says why in there
        exit 1
    }
done

say "comparing processors with wide registers and without"
build "$scratch/narrow" -DONE_MACHINE
build "$scratch/wide" -DTWO_MACHINES
build "$scratch/widest" ''
for way in narrow wide widest; do
    (
        cd "$scratch/$way"
        "$python" -c '
import hashlib
from tests.support.signals import made
from tests.transform.test_kernel import SOUNDS
digest = hashlib.sha256()
for samplerate in (1_000, 8_000, 44_100, 48_000, 96_000):
    for name, sound in SOUNDS.items():
        if samplerate > 1_000 or name not in {"low noise", "tones"}:
            digest.update(made(sound(samplerate), samplerate).process(sound(samplerate)).tobytes())
print(digest.hexdigest())' >"$scratch/$way.digest"
    )
done
cmp "$scratch/narrow.digest" "$scratch/wide.digest"
cmp "$scratch/narrow.digest" "$scratch/widest.digest"
say "all well"
