"""The stored fits: sensitivity curves that `cushion fit` has measured, one TOML file each."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tomlkit

from audioflinger_hook.service.install import state_folder
from audioflinger_hook.transform.parameters import FIT_NAME
from device.address import parse_device
from device.atomic_file import remove_file, write_private
from device.errors import CushionError, UsageError
from device.values import no_such

SUFFIX, BEFORE = ".toml", "before"  # the folder BEFORE has the earlier fits, for `undo`
MAKE = "make one with `cushion fit`"


@dataclass(frozen=True)
class Fit:
    """A person's sensitivity, on one device.

    curve_db, uncertainty_db: sensitivity relative to 70 Hz, and its standard deviation, in dB; keys
    are frequencies in Hz. jnd_db: standard deviation of the decision noise in dB. device: the
    device's address, "" for a simulation. made: local date and time. trials: all answers.
    """

    name: str
    device: str
    made: str
    curve_db: Mapping[str, float]
    uncertainty_db: Mapping[str, float]
    jnd_db: float
    trials: tuple[Mapping[str, Any], ...] = ()

    @property
    def curve(self) -> str:
        """The curve as a value of `TransformParameters.fit`."""
        return ",".join(f"{hz}:{db:.2f}" for hz, db in self.curve_db.items())


def folder() -> Path:
    """Return the folder of the fits. UsageError: see `state_folder`."""
    return state_folder() / "fit"


def name_for(device: str) -> str:
    """Return the usual name of a device's fit. device: its address, "" for a simulation."""
    return re.sub(r"[^\w.+-]", "-", device) or "simulated"


def path_of(name: str) -> Path:
    """Return the path of a fit. UsageError: this cannot be a name."""
    if not re.fullmatch(FIT_NAME, name) or len(name) > 200:
        allowed = "letters, digits and . _ + -"
        raise UsageError(f"a fit cannot be named {name[:80]!r}; allowed: {allowed}")
    return folder() / f"{name}{SUFFIX}"


def read(name: str) -> Fit:
    """Return a fit. UsageError: there is none of this name, or its file is damaged."""
    path = path_of(name)
    try:
        known = tomllib.loads(path.read_text("utf-8"))
        curves = [
            {f"{float(hz):g}": float(db) for hz, db in known[key].items()}
            for key in ("curve_db", "uncertainty_db")
        ]
        ascending = [*curves[0]] == sorted(curves[0], key=float) and len(curves[0]) > 1
        if not ascending or not all(abs(level_db) < 1e3 for level_db in curves[0].values()):
            raise ValueError("no curve")
        return Fit(
            name=name,
            device=str(known["device"]),
            made=str(known["made"]),
            curve_db=curves[0],
            uncertainty_db=curves[1],
            jnd_db=float(known["jnd_db"]),
            trials=tuple(known["trials"]),
        )
    except FileNotFoundError:
        raise UsageError(no_such("fit", name, names(), MAKE)) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = error.strerror if isinstance(error, OSError) else "damaged"
        raise UsageError(f"the fit {path} cannot be read ({why}); make it again") from None


def names() -> list[str]:
    """Return the names of all fits."""
    with suppress(OSError):
        return sorted(path.stem for path in folder().glob(f"*{SUFFIX}"))
    return []


def chosen(name: str = "", device: str | None = None) -> Fit:
    """Return the fit of a name, else the newest of a device, else the newest of all.

    device: an address as users write it; None or "" stands for any device. UsageError: there is no
    such fit.
    """
    if name:
        return read(name)
    fits = sorted(_readable(), key=lambda one: one.made)
    address = str(parse_device(device)) if device else ""
    of_device = [one for one in fits if one.device == address or not device]
    if of_device:
        return of_device[-1]
    others = f'; or choose another with fit = "NAME": {", ".join(names())}' if fits else ""
    raise UsageError(
        f"no fit is stored{f' for the device {address}' if device else ''}; {MAKE}{others}"
    )


def _readable() -> Iterator[Fit]:
    for name in names():
        with suppress(CushionError):
            yield read(name)


def store(fit: Fit) -> Path:
    """Write a fit atomically, and return its path. An earlier fit of its name is kept for `undo`.

    UsageError, WriteError: the file cannot be written.
    """
    path = path_of(fit.name)
    document = tomlkit.document()
    document.add(tomlkit.comment("Written by `cushion fit`. Sensitivity in dB relative to 70 Hz."))
    for key, value in asdict(fit).items():
        if key not in ("name", "trials"):
            document.add(key, dict(value) if isinstance(value, Mapping) else value)
    rows = tomlkit.array()
    for trial in fit.trials:
        rows.add_line(dict(trial))
    rows.add_line()
    document.add("trials", rows)
    if path.exists():
        write_private(folder() / BEFORE / path.name, path.read_bytes())
    write_private(path, tomlkit.dumps(document).encode())
    return path


def undo(name: str) -> bool:
    """Restore the fit before the last one of a name, or remove the only one.

    Return whether an earlier fit was restored. UsageError: there is no fit of this name.
    """
    path = path_of(name)
    if not path.exists():
        raise UsageError(no_such("fit", name, names(), MAKE))
    try:
        (folder() / BEFORE / path.name).replace(path)
    except FileNotFoundError:
        remove_file(path)
        return False
    return True
