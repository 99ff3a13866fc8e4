"""Checks that a test fails if a safety guard is removed.

Usage: tools/guards.py [PART OF A GUARD'S NAME ...]; without names, all guards are tried.

A guard is a line of code on which safety depends. The tool removes each guard in turn from a copy
of the project, and runs its test, which must fail. It prints the result for each guard. Exit code
1: a test passes without its guard or cannot run, or a guard is not found.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 300.0

SET = "not soak and not servers and not usbvm and not browser and not s3"
"""Selects the tests of a file, including exhaustive tests."""


@dataclass(frozen=True)
class Mutation:
    """A guard, and the edit that removes it.

    guard: what the guard ensures. file, old, new: the edit replaces `old`, which occurs once in
        `file`, with `new`. test: the test that must fail.
    """

    guard: str
    file: str
    old: str
    new: str
    test: str


PROTECTION = "tests/device/drive/test_protection.py"
PROTECTOR = "audioflinger_hook/core/drive/protection.c"
RANDOM = "tests/device/drive/test_random_drives.py"
RANDOM_DRIVES = "test_no_drive_of_a_generator_takes_a_rig_that_is_a_tenth_off_beyond_a_limit"
GOVERNOR = "audioflinger_hook/core/drive/governor.c"
ACTUATOR = "audioflinger_hook/core/drive/actuator.c"
EXPOSED = "tests/device/drive/test_exposure.py"
GUARD = "device/server/guard.py"
PLACED = "tests/device/server/test_placement.py"
DELAY_LINE = "device/clock/delay_line.py"
STALLS = "tests/device/clock/test_faults.py"
NATIVE = "audioflinger_hook/daemon/native/run.py"
SWITCHED = "tests/daemon/test_failing_engine.py"
CHAINS = "audioflinger_hook/daemon/native/chains.py"
TAPS = "audioflinger_hook/daemon/native/taps.py"
TAPPED = "tests/daemon/test_native_taps.py"
KEPT = "tests/daemon/test_safety_keeper.py"
USB = "tests/device/usb/test_control.py"
GIVEN_BACK = "tests/device/usb/test_mock.py"

MUTATIONS = (
    Mutation(
        "the predicted current assumes a blocked coil with resistance only",
        "device/drive/protection/prediction.py",
        "volts / unmoved_ohm * np.eye(states)[LAST]",
        "drives[0].i_row",
        f"{RANDOM}::{RANDOM_DRIVES}",
    ),
    Mutation(
        "the exposure cap lowers what the other limits allow",
        PROTECTOR,
        "const double capped = ceiling / larger(1.0, p->demand)",
        "const double capped = 1.0 / larger(1.0, p->demand)",
        f"{RANDOM}::{RANDOM_DRIVES}",
    ),
    Mutation(
        "no block heats a coil beyond its limit",
        PROTECTOR,
        "limits_heat(p->design) && ohm * square > power_to_limit_w(p);",
        "0;",
        f"{PROTECTION}::test_a_burst_after_a_long_pause_heats_a_hot_coil_no_further",
    ),
    Mutation(
        "the requested power is lowered as the coil nears its temperature limit",
        PROTECTOR,
        "p->wanted_w > allowed_w ? sqrt(allowed_w / p->wanted_w) : 1.0;",
        "1.0;",
        f"{PROTECTION}::test_the_coil_comes_up_to_its_limit_and_stays_there",
    ),
    Mutation(
        "the shortcut without gain ends when a coil nears its temperature limit",
        PROTECTOR,
        "    warm(p, power_w, power_w);\n    p->at_ease = heat_is_far(p);",
        "    warm(p, power_w, power_w);\n    p->at_ease = 1;",
        f"{PROTECTION}::test_more_power_than_a_cool_coil_may_take_is_lowered_before_it_is_warm",
    ),
    Mutation(
        "samples that are not finite, or far beyond full scale, count as 0",
        ACTUATOR,
        "if (!(fabs(sample) <= DAMAGED)) {",
        "if (0) {",
        f"{PROTECTION}::test_what_leaves_is_finite_and_within_full_scale_whatever_comes",
    ),
    Mutation(
        "the level of both blocks is limited",
        GOVERNOR,
        "if (larger(known_block(g)->loudest, coming_block(g)->loudest) > d->level)",
        "if (0)",
        f"{PROTECTION}::test_what_is_over_full_scale_is_turned_down_without_a_corner",
    ),
    Mutation(
        "the current is limited",
        GOVERNOR,
        "d->current_a > 0.0 ? 1.0 / d->current_a : 0.0",
        "0.0",
        f"{PROTECTION}::test_the_current_stays_under_its_limit",
    ),
    Mutation(
        "the oscillation after the end of the drive is limited",
        GOVERNOR,
        "apply_to(PARTS, tail, points, states, last, out);",
        "memset(out[FIXED], 0, points * 8), memset(out[PER_GAIN], 0, points * 8),"
        " memset(out[UNGOVERNED], 0, points * 8), (void)tail, (void)last;",
        PROTECTION,
    ),
    Mutation(
        "an exhausted daily dose lowers the gain",
        ACTUATOR,
        "if (!(d->cap_a8_m_s2 > 0.0))",
        "if (1)",
        EXPOSED,
    ),
    Mutation(
        "the gain of the exposure cap limits the drive",
        ACTUATOR,
        "protection_step(a->protection, sample, a->exposure.gain)",
        "protection_step(a->protection, sample, 1.0)",
        EXPOSED,
    ),
    Mutation(
        "after a crash, the largest heat and dose that protection allows are assumed",
        "audioflinger_hook/daemon/safety_keeper.py",
        "state = bounds.after_unrecorded(state, unrecorded_s)",
        "pass",
        KEPT,
    ),
    Mutation(
        "without a valid record, the warmest coil is assumed",
        "audioflinger_hook/daemon/safety_keeper.py",
        "                if trouble and not known:\n                    state = bounds.warmest",
        "                if False:\n                    state = bounds.warmest",
        KEPT,
    ),
    Mutation(
        "no volume is set above 0 dB",
        "device/volume_limit.py",
        "return min(wanted_db, most_db)",
        "return wanted_db",
        "tests/device/test_volume.py",
    ),
    Mutation(
        "a stream on another device is silent",
        GUARD,
        "if self.on != self.device:",
        "if False:",
        PLACED,
    ),
    Mutation(
        "after an event about a stream, the stream is silent until it is checked",
        GUARD,
        "return Hold.UNSETTLED if self.unsettled else Hold.FREE",
        "return Hold.FREE",
        PLACED,
    ),
    Mutation(
        "a stream is silent without a connection to the server",
        GUARD,
        "        if not self.connected:\n            return Hold.LOST\n",
        "",
        PLACED,
    ),
    Mutation(
        "a check from before an event does not release a stream",
        GUARD,
        "if snapshot.events < self.unsettled:",
        "if False:",
        PLACED,
    ),
    Mutation(
        "no microphone is tapped", GUARD, "if one.monitor_of or self.any_source]", "]", PLACED
    ),
    Mutation(
        "an ended guard leaves its stream silent",
        GUARD,
        "self.hold.audible and not self._released",
        "self.hold.audible",
        PLACED,
    ),
    Mutation(
        "the device's own sound is not tapped",
        TAPS,
        "if sink.id == avoided or not sink.is_sink:",
        "if not sink.is_sink:",
        TAPPED,
    ),
    Mutation(
        "the device's monitor is not tapped through any application",
        TAPS,
        "if output.is_monitor and node.id == avoided:  # the monitor would cause feedback",
        "if False:",
        TAPPED,
    ),
    Mutation(
        "unwanted links are removed",
        "device/server/link_keeper.py",
        "if link.pair not in wanted:",
        "if False:",
        "tests/device/server/test_graph.py",
    ),
    Mutation(
        "two underruns within a second are followed by silence",
        DELAY_LINE,
        "self._not_before_s = now_s + HOLD_OFF_S",
        "pass",
        f"{STALLS}::test_a_tap_that_runs_dry_twice_in_a_second_is_silent_for_a_while",
    ),
    Mutation(
        "frames that were overwritten while they were read are not played",
        DELAY_LINE,
        "if self._reader.position - 1 < self._ring.oldest:",
        "if False:",
        STALLS,
    ),
    Mutation(
        "a native engine that fails repeatedly is replaced by the Python engine",
        NATIVE,
        "if not lost or self._failures >= FAILURES_MAX:",
        "if not lost:",
        SWITCHED,
    ),
    Mutation(
        "a native engine that starts too slowly is replaced by the Python engine",
        NATIVE,
        "elif now_s - self._began_s > START_S:",
        "elif False:",
        SWITCHED,
    ),
    Mutation(
        "a native engine that was stopped is replaced",
        CHAINS,
        "if running.chain.is_stopped:",
        "if False:",
        SWITCHED,
    ),
    Mutation(
        "a native engine that processes nothing is replaced",
        CHAINS,
        "or current.stands_s(now_s) > STUCK_S:",
        "or False:",
        SWITCHED,
    ),
    Mutation(
        "a USB device is returned to its driver",
        "device/usb/guardian.py",
        "handle.attach_kernel_driver(number)",
        "pass",
        GIVEN_BACK,
    ),
    Mutation(
        "settings of a USB device are restored",
        "device/usb/guardian.py",
        'control.restore(ControlState(volumes, mutes, state["samplerate"]))',
        "pass",
        GIVEN_BACK,
    ),
    Mutation(
        "a level that is too loud is not restored",
        "device/usb/control.py",
        "self._set_units(channel, min(units, loudest))",
        "self._set_units(channel, units)",
        f"{USB}::test_what_was_set_is_set_back_but_never_too_loud_again",
    ),
    Mutation(
        "a confidence interval includes the correlation of neighbouring bins",
        "device/identification/output_error.py",
        "variance = 0.5 * float(np.mean(np.abs(e) ** 2)) * (1.0 + held) / (1.0 - held)",
        "variance = 0.5 * float(np.mean(np.abs(e) ** 2))",
        "tests/device/identification/test_eddy_coils.py::"
        "test_what_a_model_cannot_follow_widens_the_interval_more_than_noise_of_its_power",
    ),
)


def guards_table() -> str:
    """Return all guards as a Markdown table: purpose, file and test."""
    rows = (
        f"| {one.guard} | `{one.file}` | `{one.test.replace('::', '` `')}` |" for one in MUTATIONS
    )
    return "\n".join(("| guard | where | test |", "| --- | --- | --- |", *rows))


def main(words: list[str]) -> int:
    """Try all guards, or those whose names contain one of the words; return the exit code."""
    chosen = [one for one in MUTATIONS if not words or any(word in one.guard for word in words)]
    unnoticed = 0
    with tempfile.TemporaryDirectory(prefix="guards-") as folder:
        copy = Path(folder) / "project"
        _copy(copy)
        for mutation in chosen:
            noticed = _is_noticed(mutation, copy)
            unnoticed += not noticed
            print(f"{'noticed' if noticed else 'UNNOTICED':9}  {mutation.guard}", flush=True)
    print(f"{len(chosen) - unnoticed} of {len(chosen)} are noticed")
    return 1 if unnoticed else 0


def _copy(copy: Path) -> None:
    skipped = shutil.ignore_patterns(".git", ".venv", "out", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, copy, ignore=skipped, symlinks=True)


def _build(copy: Path) -> None:
    command = [sys.executable, "setup.py", "-q", "build_ext", "--inplace"]
    subprocess.run(command, cwd=copy, check=True, capture_output=True)


def _is_noticed(mutation: Mutation, copy: Path) -> bool:
    path = copy / mutation.file
    text = path.read_text("utf-8")
    if text.count(mutation.old) != 1:
        raise SystemExit(f"{mutation.file}: {mutation.old!r} does not occur once")
    path.write_text(text.replace(mutation.old, mutation.new), "utf-8")
    if path.suffix == ".c":
        _build(copy)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-x", "-q", "-m", SET, mutation.test],
            cwd=copy,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        )
    except subprocess.TimeoutExpired:
        return True
    finally:
        path.write_text(text, "utf-8")
        if path.suffix == ".c":
            _build(copy)
    if done.returncode not in (0, 1):
        raise SystemExit(f"{mutation.test}: {done.stdout[-2_000:]}{done.stderr[-2_000:]}")
    return done.returncode == 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
