"""The stored fits: sensitivity curves that `cushion fit` has measured, one TOML file each."""

import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tomlkit

from audioflinger_hook.config.kinds import Curve
from audioflinger_hook.service.install import state_folder
from device.address import parse_device
from device.atomic_file import remove_file, write_private
from device.errors import UsageError
from device.values import Described, Number, Text, no_such

T = TypeVar("T", bound=Described)


@dataclass(frozen=True)
class Fit(Described):
    """A person's sensitivity to the vibration of a device, relative to 70 Hz."""

    name: Annotated[str, Text("name of the file, without its end")]
    device: Annotated[str, Text("the device's address, or simulated")]
    made: Annotated[str, Text("date and time")]
    trials: Annotated[int, Number("answers", 1, 1_000, whole=True)]
    jnd_db: Annotated[float, Number("standard deviation of the decision noise", 0.0, 99.0, "dB")]
    curve_db: Annotated[Mapping[str, float], Curve("sensitivity in dB, by Hz")]
    uncertainty_db: Annotated[Mapping[str, float], Curve("its standard deviation in dB, by Hz")]


def checked(kind: type[T], values: Mapping[str, Any], what: str) -> T:
    """Return an instance with a file's values. UsageError: some are wrong; all are named."""
    known = kind.DESCRIPTIONS
    wrong = [no_such("key", name[:40], known, "") for name in values if name not in known]
    if wrong := wrong + [f"{name} {why}" for name, why in kind.refusals(values).items()]:
        raise UsageError(f"{what}: {'; '.join(wrong)}")
    return kind.from_values(values)


def default_name(device: str | None) -> str:
    """Return the name of a device's fit. device: None stands for a simulated one."""
    return re.sub(r"[^\w.+-]", "-", str(parse_device(device)) if device else "simulated")[:100]


def names() -> list[str]:
    """Return the names of all fits."""
    return sorted(path.stem for path in (state_folder() / "fit").glob("*.toml"))


def path_of(name: str) -> Path:
    """Return the path of a fit. UsageError: this cannot be a name; see also `state_folder`."""
    if re.fullmatch(r"\w[\w.+-]{0,99}", name):
        return state_folder() / "fit" / f"{name}.toml"
    allowed = "up to 100 letters, digits and . _ + -"
    raise UsageError(f"a fit cannot be named {name[:80]!r}; allowed: {allowed}")


def read(name: str) -> Fit:
    """Return a fit. UsageError: there is none of this name, or its file is damaged."""
    path = path_of(name)
    try:
        return checked(Fit, tomllib.loads(path.read_text("utf-8")), f"the fit {path}")
    except FileNotFoundError:
        raise UsageError(no_such("fit", name, names(), "make one with `cushion fit`")) from None
    except (OSError, ValueError) as error:
        raise UsageError(f"the fit {path} cannot be read ({error}); make it again") from None


def store(fit: Fit) -> None:
    """Write a fit. An earlier one of its name is kept for `undo`. Errors: see `write_private`."""
    path = path_of(fit.name)
    if path.exists():
        write_private(path.with_suffix(".before"), path.read_bytes())
    write_private(path, tomlkit.dumps(asdict(fit)).encode())


def undo(name: str) -> str:
    """Restore the fit before the last one of a name, or remove the only one; return what was done.

    UsageError: there is no fit of this name.
    """
    path = path_of(read(name).name)
    with suppress(FileNotFoundError):
        path.with_suffix(".before").replace(path)
        return "the fit before is back"
    remove_file(path)
    return "removed"
