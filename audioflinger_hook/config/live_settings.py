"""What a user may choose of live sound: where it comes from, where the vibration goes, and how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from audioflinger_hook.sources import parse_tap
from audioflinger_hook.sources.address import GRAMMAR as TAPS
from audioflinger_hook.transform.parameters import Problem
from device.address import GRAMMAR as DEVICES
from device.address import parse_device
from device.errors import UsageError

OFFSET_MAX_MS = 1_000.0
DEVICE_VOLUME_LEAST_DB = -96.0
"""Of any volume control of 16 bits; what a device cannot do becomes its lowest."""

BLOCK_FRAMES = (128, 256, 512, 1024)
"""Frames a callback, of the streams on both sides; fewer are less delay and more work."""

SWITCHES = ("drop_in", "realtime")
LISTS = ("include", "exclude")


@dataclass(frozen=True)
class LiveSettings:
    """One complete set of choices.

    tap: where the sound comes from, one address or several of applications; device: where the
    vibration goes, None for not said. offset_ms: delay on top of what is needed; a negative one
    takes drop_in. drop_in: whether to stand between applications and their sink; block_frames:
    one of `BLOCK_FRAMES`; realtime: whether the audio threads ask for real-time priority;
    device_volume_db: what the device's own volume is set to, None to leave it as it is. include,
    exclude: which applications are felt; their grammar is not checked here.

    Raises
    ------
    UsageError
        Names every choice that cannot be, all at once.
    """

    tap: tuple[str, ...] = ("default",)
    device: str | None = None
    offset_ms: float = 0.0
    drop_in: bool = False
    block_frames: int = 512
    realtime: bool = True
    device_volume_db: float | None = None
    include: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        chosen = {field.name: getattr(self, field.name) for field in fields(self)}
        # None is no text but says that nothing was said.
        found = problems({name: value for name, value in chosen.items() if value is not None})
        if found:
            raise UsageError(
                "; ".join(
                    f"{name}={_text(chosen[name])} {problem.wrong}; allowed: {problem.allowed}"
                    for name, problem in found.items()
                )
            )

    @property
    def offset_s(self) -> float:
        """The offset in seconds."""
        return 1e-3 * self.offset_ms


def problems(values: Mapping[str, Any]) -> dict[str, Problem]:
    """Return what is wrong with a set of choices, by name; absent ones are the defaults.

    Values may be of any type, as a config file has them: `tap` may be one text, every tuple a
    list. Unknown names are the caller's to report. An empty dict means that the set is usable.
    """
    found = {
        name: Problem("is not true or false", "true, false")
        for name in SWITCHES
        if not isinstance(values.get(name, False), bool)
    }
    wrong = {
        "tap": _wrong_tap(values.get("tap", "default")),
        "device": _wrong_device(values.get("device", "twin")),
        "offset_ms": _wrong_offset(values.get("offset_ms", 0.0), values.get("drop_in", False)),
        "device_volume_db": _wrong_volume(values.get("device_volume_db", 0.0)),
        "block_frames": _wrong_block(values.get("block_frames", LiveSettings.block_frames)),
        **{name: _wrong_list(values.get(name, ())) for name in LISTS},
    }
    return found | {name: problem for name, problem in wrong.items() if problem is not None}


def from_document(values: Mapping[str, Any]) -> LiveSettings:
    """Return the settings that a config file's values mean; `problems` has found nothing wrong."""
    chosen = dict(values)
    if isinstance(chosen.get("tap"), str):
        chosen["tap"] = [chosen["tap"]]
    for name in ("tap", *LISTS):
        if name in chosen:
            chosen[name] = tuple(chosen[name])
    for name in ("offset_ms", "device_volume_db"):
        if name in chosen:
            chosen[name] = float(chosen[name])
    return LiveSettings(**chosen)


def _wrong_tap(value: Any) -> Problem | None:
    taps = [value] if isinstance(value, str) else value
    if not isinstance(taps, (list, tuple)) or not all(isinstance(tap, str) for tap in taps):
        return Problem("is no tap and no list of taps", TAPS)
    if not taps:
        return Problem("is a list of no taps", TAPS)
    kinds = []
    for tap in taps:
        try:
            kinds.append(parse_tap(tap).kind)
        except UsageError as error:
            return _refused(error, f"tap {tap!r}: ", TAPS)
    if len(taps) > 1 and set(kinds) != {"app"}:
        return Problem(
            "are several taps that are not all applications", "one tap, or app:NAME each"
        )
    return None


def _wrong_device(value: Any) -> Problem | None:
    if not isinstance(value, str):
        return Problem("is no device", DEVICES)
    try:
        parse_device(value)
    except UsageError as error:
        return _refused(error, f"device {value!r}: ", DEVICES)
    return None


def _refused(error: UsageError, prefix: str, allowed: str) -> Problem:
    """Return the problem that a parser found, without the value, which stands there already."""
    wrong = str(error.args[0]).removeprefix(prefix).partition("; allowed: ")[0]
    return Problem(f"is none: {wrong}", allowed)


def _wrong_offset(value: Any, drop_in: Any) -> Problem | None:
    allowed = f"{-OFFSET_MAX_MS:g} to {OFFSET_MAX_MS:g} ms, below 0 with drop_in = true only"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return Problem("is not a number", allowed)
    if not -OFFSET_MAX_MS <= value <= OFFSET_MAX_MS:
        return Problem("is out of range", allowed)
    if value < 0.0 and drop_in is False:
        return Problem(
            "is below 0 without drop_in", f"0 to {OFFSET_MAX_MS:g} ms, or drop_in = true"
        )
    return None


def _wrong_volume(value: Any) -> Problem | None:
    allowed = f"{DEVICE_VOLUME_LEAST_DB:g} to 0 dB"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return Problem("is not a number", allowed)
    if not DEVICE_VOLUME_LEAST_DB <= value <= 0.0:
        return Problem("is out of range", allowed)
    return None


def _wrong_block(value: Any) -> Problem | None:
    if type(value) is int and value in BLOCK_FRAMES:
        return None
    return Problem("is no length of a block", ", ".join(map(str, BLOCK_FRAMES)) + " frames")


def _wrong_list(value: Any) -> Problem | None:
    texts = value if isinstance(value, (list, tuple)) else [None]
    if all(isinstance(text, str) and text.strip() for text in texts):
        return None
    return Problem("is no list of texts that are not empty", '["NAME", ...]')


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return str(value).lower() if isinstance(value, bool) else f"{value}"
