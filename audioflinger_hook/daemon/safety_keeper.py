"""Stores coil temperatures and the daily vibration dose in a file for the next process.

A coil cools with a time constant of about half a minute, and a dose counts for a day. A new process
needs the temperatures and the dose. A killed process does not record the time after its last write.
For this time, the next process assumes the worst case that protection allows.
"""

import json
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

from audioflinger_hook.drive.drive import DrivenRig
from device.atomic_file import AtomicFile, make_private_folder
from device.drive.exposure import DoseSums
from device.drive.safety import LONGEST_REST_S, SafetyState
from device.errors import CushionError

VERSION = 1
FILE = "actuators.json"
MARK = "has-run"  # empty file, which shows that a record must exist
SAVE_S = 0.5  # shortest time between two writes

# Assumed longest time that a killed process has played after its last write.
UNRECORDED_S = 1.5
BEGIN_S = 0.3  # assumed time from reading a playing rig's state to the first block of a new rig
UNSYNCED_S = 60.0  # like UNRECORDED_S, after a machine crash, because files reach the disk late

Rigs = Sequence[DrivenRig | None]


@dataclass(frozen=True)
class Moment:
    """One moment on several clocks. boot: identifies the boot of the machine, "" if unknown.

    boot_s: seconds since boot. wall_s: system clock in s. local: such as "2026-05-01T09:30+02:00".
    """

    boot: str = ""
    boot_s: float = 0.0
    wall_s: float = 0.0
    local: str = ""

    @property
    def day(self) -> str:
        """The local calendar day, such as "2026-05-01"."""
        return self.local[:10]


class SafetyKeeper:
    """Records and restores coil temperatures and vibration doses of a device's rigs.

    folder: the file's folder, created if missing; None: no file. moment: returns the current time.
    warning: message for the user, or "". since: local time when today's dose began, "" if unknown.
    """

    def __init__(self, folder: Path | None = None, moment: Callable[[], Moment] = Moment) -> None:
        self._folder, self._moment = folder, moment
        self._saved_s = -math.inf
        self._saved: list[DoseSums] = []
        self._ended: dict[tuple[int, int], SafetyState] = {}
        self._day = self._device = self.since = self.warning = ""

    def restore(self, rigs: Rigs) -> None:
        """Set new rigs to the device's recorded state. Call it before their first block."""
        if self._folder is None or not any(rigs):
            return
        now, device = self._moment(), self._device
        known, trouble = self._read(now)
        records = known.get("actuators", {})
        self._day = now.day
        self.since = known["since"] if known.get("day") == now.day else now.local
        today = [DoseSums(**one["dose"]) for one in records.values() if one["day"] == now.day]
        dose = reduce(DoseSums.at_least, today, DoseSums())
        for index, processor in enumerate(rigs):
            if processor is None:
                continue
            bounds, states = processor.design.bounds(), []
            for channel in range(processor.channels):
                record = records.get(_key(device, index, channel))
                if trouble and not known:
                    state = bounds.warmest
                elif record is None:
                    state = SafetyState(dose=dose)
                else:
                    state, problem = _resumed(record, now, processor)
                    trouble = trouble or problem
                states.append(state)
            processor.restore(states)
        if trouble:
            self.warning = (
                f"{trouble}; coils count as hot as their limit allows until they have cooled down, "
                "and a dose that was there is unknown"
            )
        self._saved_s = -math.inf
        self._write(rigs, now, sync=False)  # the process may be killed soon

    def note_device(self, device: str) -> None:
        """Use this device's name for later records."""
        if device != self._device:
            self._device, self._saved_s = device, -math.inf

    def carry_over(self, playing: Rigs, rigs: Rigs) -> None:
        """Copy the state of playing rigs to new rigs. Call it before the new rigs' first block."""
        known = _states_of(playing)
        if not known and (self._folder is None or self.warning):
            known = self._ended  # without a record, assume that coils have not cooled
        for index, rig in enumerate(rigs):
            if rig is not None and known and rig not in playing:
                bounds, states = rig.design.bounds(), list(rig.safety_states())
                for channel in range(rig.channels):
                    if (state := known.get((index, channel))) is not None:
                        states[channel] = bounds.after_unrecorded(state, BEGIN_S)
                rig.restore(states)

    def update(self, rigs: Rigs, now_s: float) -> None:
        """Record changes, at most once per SAVE_S; reset the dose on a new day. Raises nothing."""
        if self._folder is None or self.warning:  # no record will tell it to later rigs
            self._ended = _states_of(rigs) or self._ended
        if self._folder is None or not self._day or not any(rigs) or now_s - self._saved_s < SAVE_S:
            return
        now = self._moment()
        if now.day != self._day:
            self._day, self.since = now.day, now.local
            for processor in filter(None, rigs):
                processor.begin_day()
            return
        # A coil that only cools needs no new record: `_resumed` computes how it has cooled.
        doses = [one.dose for each in filter(None, rigs) for one in each.safety_states()]
        if doses != self._saved:
            self._saved = doses
            self._write(rigs, now, sync=False)
        self._saved_s = now_s

    def close(self, rigs: Rigs) -> None:
        """Record the rigs' final state. Raises nothing."""
        self._ended = _states_of(rigs)
        if self._day and any(rigs):
            self._write(rigs, self._moment(), sync=True)

    def _read(self, now: Moment) -> tuple[dict[str, Any], str]:
        """Return the content of the file, and why the file cannot be used, or "" if it can."""
        assert self._folder is not None
        path = self._folder / FILE
        has_run = False
        try:
            make_private_folder(self._folder)
            has_run = (self._folder / MARK).exists()
            (self._folder / MARK).touch()
            known = _checked(json.loads(path.read_text("utf-8")))
        except FileNotFoundError:
            return {}, f"{path} is missing although the cushion has run before" if has_run else ""
        except (OSError, CushionError) as error:
            return {}, f"{path} cannot be read ({error})"
        except (ValueError, TypeError, KeyError, AttributeError):
            return {}, f"{path} is damaged, or of another version"
        others = [one for one in known["actuators"].values() if one["boot"] != now.boot]
        if any(one["wall_s"] > now.wall_s for one in others):
            return {}, f"{path} is from the future: the clock was set back"
        return known, ""

    def _write(self, rigs: Rigs, now: Moment, *, sync: bool) -> None:
        assert self._folder is not None
        path, kept = self._folder / FILE, {}
        with suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
            kept = _checked(json.loads(path.read_text("utf-8")))["actuators"]
        times = {"boot": now.boot, "boot_s": now.boot_s, "wall_s": now.wall_s, "day": now.day}
        for index, processor in enumerate(rigs):
            for channel, state in enumerate(processor.safety_states() if processor else ()):
                kept[_key(self._device, index, channel)] = {**asdict(state), **times, "ended": sync}
        record = {"version": VERSION, "day": self._day, "since": self.since, "actuators": kept}
        try:
            file = AtomicFile(path)
            file.write(json.dumps(record, indent=1).encode())
            file.commit(sync=sync)
        except CushionError as error:
            self.warning = f"temperatures and dose are not kept: {error}"


def _key(device: str, index: int, channel: int) -> str:
    return f"{device} {index}.{channel}"


def _states_of(rigs: Rigs) -> dict[tuple[int, int], SafetyState]:
    return {
        (index, channel): state
        for index, rig in enumerate(rigs)
        if rig is not None
        for channel, state in enumerate(rig.safety_states())
    }


def _checked(known: dict[str, Any]) -> dict[str, Any]:
    """Return `known`. ValueError, TypeError, KeyError, AttributeError: `known` is invalid."""
    if known["version"] != VERSION:
        raise ValueError(known["version"])
    str(known["since"])
    for one in known["actuators"].values():
        numbers = [one["boot_s"], one["wall_s"], *DoseSums(**one["dose"]).__dict__.values()]
        numbers += [one[name] for name in ("coil_c", "magnet_c") if one[name] is not None]
        if not all(math.isfinite(number) and number >= 0.0 for number in numbers):
            raise ValueError(numbers)
        if not (isinstance(one["boot"], str) and isinstance(one["day"], str)):
            raise TypeError(one)
    return known


def _resumed(record: dict[str, Any], now: Moment, processor: DrivenRig) -> tuple[SafetyState, str]:
    """Return the present state of a recorded actuator, and why it is unknown, or "" if known."""
    bounds = processor.design.bounds()
    same_boot = bool(now.boot) and record["boot"] == now.boot
    passed_s = now.boot_s - record["boot_s"] if same_boot else now.wall_s - record["wall_s"]
    dose = DoseSums(**record["dose"]) if record["day"] == now.day else DoseSums()
    if not 0.0 <= passed_s <= LONGEST_REST_S:
        warm = bounds.warmest
        return SafetyState(warm.coil_c, warm.magnet_c, dose), "the time that has passed is unknown"
    state = SafetyState(record["coil_c"], record["magnet_c"], dose)
    if not record["ended"]:
        unrecorded_s = min(passed_s, UNRECORDED_S if same_boot else UNSYNCED_S)
        state = bounds.after_unrecorded(state, unrecorded_s)
        passed_s -= unrecorded_s
        if record["day"] != now.day and passed_s > 0.0:  # that dose counts for the record's day
            state = replace(state, dose=dose)
    return bounds.after_rest(state, passed_s), ""
