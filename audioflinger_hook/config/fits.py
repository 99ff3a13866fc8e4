"""The stored fits: sensitivity curves that `cushion fit` has measured, one TOML file each."""

import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tomlkit

from audioflinger_hook.service.install import state_folder
from audioflinger_hook.transform.parameters import FIT_NAME, FitText
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


def path_of(name: str) -> Path:
    """Return the path of a fit. UsageError: this cannot be a name; see also `state_folder`."""
    if not re.fullmatch(FIT_NAME, name) or len(name) > 200:
        allowed = "letters, digits and . _ + -"
        raise UsageError(f"a fit cannot be named {name[:80]!r}; allowed: {allowed}")
    return state_folder() / "fit" / f"{name}{SUFFIX}"


def read(name: str) -> Fit:
    """Return a fit. UsageError: there is none of this name, or its file is damaged."""
    path = path_of(name)
    try:
        fit = Fit(name, **tomllib.loads(path.read_text("utf-8")))
        is_whole = fit.curve_db.keys() == fit.uncertainty_db.keys() and fit.jnd_db >= 0.0
        if not is_whole or ":" not in fit.curve or FitText("").refuse(fit.curve):
            raise ValueError("no curve")
    except FileNotFoundError:
        raise UsageError(no_such("fit", name, names(), MAKE)) from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        why = error.strerror if isinstance(error, OSError) else "damaged"
        raise UsageError(f"the fit {path} cannot be read ({why}); make it again") from None
    return fit


def names() -> list[str]:
    """Return the names of all fits."""
    return sorted(path.stem for path in (state_folder() / "fit").glob(f"*{SUFFIX}"))


def chosen(name: str = "", device: str | None = None) -> Fit:
    """Return the fit of a name, else the newest of a device, else the newest of all.

    device: an address as users write it; None or "" stands for any device. UsageError: there is no
    such fit.
    """
    if name:
        return read(name)
    address, found = str(parse_device(device)) if device else "", []
    for one in names():
        with suppress(CushionError):
            found.append(read(one))
    if own := [fit for fit in found if fit.device == address or not device]:
        return max(own, key=lambda fit: fit.made)
    others = f'; or choose another with fit = "NAME": {", ".join(names())}' if found else ""
    where = f" for the device {address}" if device else ""
    raise UsageError(f"no fit is stored{where}; {MAKE}{others}")


def store(fit: Fit) -> Path:
    """Write a fit atomically, and return its path. An earlier fit of its name is kept for `undo`.

    UsageError, WriteError: the file cannot be written.
    """
    path, values = path_of(fit.name), asdict(fit)
    document = tomlkit.document()
    document.add(tomlkit.comment("Written by `cushion fit`. Sensitivity in dB relative to 70 Hz."))
    rows = tomlkit.array()
    for trial in values.pop("trials"):
        rows.add_line(trial)
    rows.add_line()
    del values["name"]
    tables = {key: values.pop(key) for key in ("curve_db", "uncertainty_db")}
    for key, value in {**values, "trials": rows, **tables}.items():
        document.add(key, value)
    if path.exists():
        write_private(path.parent / BEFORE / path.name, path.read_bytes())
    write_private(path, tomlkit.dumps(document).encode())
    return path


def undo(name: str) -> bool:
    """Restore the fit before the last one of a name, or remove the only one.

    Return whether an earlier fit was restored. UsageError: there is no fit of this name.
    """
    path = path_of(name)
    if not path.exists():
        raise UsageError(no_such("fit", name, names(), MAKE))
    with suppress(FileNotFoundError):
        (path.parent / BEFORE / path.name).replace(path)
        return True
    remove_file(path)
    return False
