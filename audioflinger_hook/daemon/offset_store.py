"""Stores the delays that users have measured, one for each pair of sinks, for later runs."""

import json
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from device.atomic_file import write_private
from device.errors import UsageError

VERSION = 1
FILE = "offsets.json"
DAMAGED = "offsets.damaged.json"  # a file that cannot be read gets this name
LONGEST_S = 10.0  # longest delay that a valid file may have
PAIRS_MAX = 1_000  # the oldest pairs beyond this number are dropped


class SinkPair(NamedTuple):
    """Names of the sink that plays the sound, and of the device that plays the vibration."""

    heard: str
    felt: str


class OffsetStore:
    """The stored delays of pairs of sinks. Only one thread may use it.

    A delay is the time that the sound takes behind its sink, less the time that the vibration takes
    behind its device, in seconds. Names of sinks that no longer exist have no effect.

    folder: of the file; None stores nothing. warning: why stored delays are lost, or "".
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._delays_s: dict[SinkPair, float] = {}
        self.warning = ""
        if folder is None:
            return
        path, delays_s = folder / FILE, {}
        try:
            known = json.loads(path.read_text("utf-8"))
            if known["version"] != VERSION:
                raise ValueError(known["version"])
            for one in known["offsets"]:
                pair, delay_s = SinkPair(one["heard"], one["felt"]), one["delay_s"]
                is_number = type(delay_s) in (int, float) and abs(delay_s) <= LONGEST_S
                if not all(isinstance(name, str) for name in pair) or not is_number:
                    raise ValueError(one)
                delays_s[pair] = float(delay_s)
            self._delays_s = delays_s
        except FileNotFoundError:
            pass
        except OSError as error:
            self.warning = f"{path} cannot be read ({error.strerror}); run `cushion sync` again"
        except (ValueError, TypeError, KeyError, RecursionError):
            self.warning = (
                f"{path} is damaged, or of another version; it is now {DAMAGED}; run "
                "`cushion sync` again"
            )
            with suppress(OSError):
                path.replace(path.with_name(DAMAGED))

    def delay_s(self, pair: SinkPair) -> float | None:
        """Return the stored delay of exactly this pair in seconds, None if there is none."""
        return self._delays_s.get(pair)

    def store(self, pair: SinkPair, delay_s: float) -> None:
        """Store the delay of a pair in place of its earlier delay.

        UsageError, WriteError: the file cannot be written; the delay is then used until the end.
        """
        self._delays_s.pop(pair, None)
        self._delays_s[pair] = delay_s
        self._delays_s = dict([*self._delays_s.items()][-PAIRS_MAX:])
        if self._folder is None:
            raise UsageError("there is no state folder for the delay; set XDG_STATE_HOME or HOME")
        kept = [{**one._asdict(), "delay_s": known_s} for one, known_s in self._delays_s.items()]
        text = json.dumps({"version": VERSION, "offsets": kept}, indent=1)
        write_private(self._folder / FILE, f"{text}\n".encode())
        self.warning = ""
