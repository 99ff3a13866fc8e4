"""The stored fits: sensitivity curves that `cushion fit` has measured, one TOML file each."""

import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tomlkit

from audioflinger_hook.config.kinds import Curve, curve_text
from audioflinger_hook.service.install import state_folder
from device.address import parse_device
from device.atomic_file import remove_file, write_private
from device.errors import UsageError
from device.values import Described, Number, Text, no_such

MAKE = "make one with `cushion fit`"
T = TypeVar("T", bound=Described)


@dataclass(frozen=True)
class Fit(Described):
    """A person's sensitivity to the vibration of a device."""

    name: Annotated[str, Text("name of the file, without its end")]
    device: Annotated[str, Text("the device's address, or simulated")]
    made: Annotated[str, Text("date and time, as YYYY-MM-DDTHH:MM:SS")]
    trials: Annotated[int, Number("answers", 1, 1_000, whole=True)]
    jnd_db: Annotated[float, Number("standard deviation of the decision noise", 0.0, 99.0, "dB")]
    curve_db: Annotated[Mapping[str, float], Curve("sensitivity in dB relative to 70 Hz, by Hz")]
    uncertainty_db: Annotated[Mapping[str, float], Curve("standard deviation of the sensitivity")]

    @property
    def curve(self) -> str:
        """The curve as a value of `TransformParameters.fit`."""
        return curve_text(self.curve_db)


def checked(kind: type[T], values: Mapping[str, Any], what: str) -> T:
    """Return an instance with a file's values. UsageError: some are wrong; all are named."""
    known = kind.DESCRIPTIONS
    wrong = [no_such("key", name[:40], known, "") for name in values if name not in known]
    if wrong := wrong + [f"{name} {why}" for name, why in kind.refusals(values).items()]:
        raise UsageError(f"{what}: {'; '.join(wrong)}")
    return kind.from_values(values)


def path_of(name: str) -> Path:
    """Return the path of a fit. UsageError: this cannot be a name; see also `state_folder`."""
    if not re.fullmatch(r"\w[\w.+-]{0,99}", name):
        allowed = "up to 100 letters, digits and . _ + -"
        raise UsageError(f"a fit cannot be named {name[:80]!r}; allowed: {allowed}")
    return state_folder() / "fit" / f"{name}.toml"


def names() -> list[str]:
    """Return the names of all fits."""
    return sorted(path.stem for path in (state_folder() / "fit").glob("*.toml"))


def read(name: str) -> Fit:
    """Return a fit. UsageError: there is none of this name, or its file is damaged."""
    path = path_of(name)
    try:
        return checked(Fit, tomllib.loads(path.read_text("utf-8")), f"the fit {path}")
    except FileNotFoundError:
        raise UsageError(no_such("fit", name, names(), MAKE)) from None
    except (OSError, ValueError) as error:
        raise UsageError(f"the fit {path} cannot be read ({error}); make it again") from None


def chosen(name: str, device: str | None) -> Fit:
    """Return the fit of a name; without a name, the newest of a device, or of all for None.

    UsageError: there is no such fit, or one cannot be read.
    """
    if name:
        return read(name)
    address = device and str(parse_device(device))
    found = [fit for fit in map(read, names()) if address in (None, fit.device)]
    if not found:
        where = f" for the device {address}; there are {', '.join(names())}" if names() else ""
        raise UsageError(f"no fit is stored{where}; {MAKE}")
    return max(found, key=lambda fit: fit.made)


def store(fit: Fit) -> Path:
    """Write a fit atomically; return its path. An earlier fit of its name is kept for `undo`.

    UsageError, WriteError: the file cannot be written.
    """
    path = path_of(fit.name)
    if path.exists():
        write_private(path.parent / "before" / path.name, path.read_bytes())
    write_private(path, tomlkit.dumps(asdict(fit)).encode())
    return path


def undo(name: str) -> bool:
    """Restore the fit before the last one of a name, or remove the only one.

    Return whether an earlier fit was restored. UsageError: there is no fit of this name.
    """
    path = path_of(read(name).name)
    with suppress(FileNotFoundError):
        (path.parent / "before" / path.name).replace(path)
        return True
    remove_file(path)
    return False
