"""Installs the plugin for hosts other than the daemon: the file, its designs, LV2, and PipeWire."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.core.design import core_design
from audioflinger_hook.plugin import FILE_NAME, plugin_path
from audioflinger_hook.plugin.variants import DESCRIPTION, description, manifest, public_variants
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.parameters import check_format
from device.atomic_file import write_bytes_atomically
from device.errors import NotFoundError, UsageError, WriteError

CHANNELS = 2  # of the plugins' sound; the plugin for one channel doubles it

RATES_HZ = (44_100, 48_000, 88_200, 96_000, 176_400, 192_000)
MARKER = "Written by `cushion plugin install`; `cushion plugin remove` removes it."
BUNDLE = "haptic-cushion.lv2"
CHAIN = "haptic-cushion.conf"
HOST = "filter-chain.conf"
HOST_FOLDERS = (Path("/usr/share/pipewire"), Path("/etc/pipewire"))


@dataclass(frozen=True)
class Places:
    """Where everything is installed. data: plugin and designs; bundle: LV2; chain: PipeWire."""

    data: Path
    bundle: Path
    chain: Path

    @classmethod
    def of(cls, environ: Mapping[str, str]) -> Places:
        """Return the user's places. UsageError: there is no home folder."""
        home = environ.get("HOME", "")
        if not home.startswith("/"):
            raise UsageError(f"HOME is {home!r}; allowed: an absolute path; set it")
        data = Path(environ.get("XDG_DATA_HOME") or f"{home}/.local/share")
        config = Path(environ.get("XDG_CONFIG_HOME") or f"{home}/.config")
        chain = config / "pipewire" / "filter-chain.conf.d" / CHAIN
        return cls(data / "haptic-cushion", Path(home) / ".lv2" / BUNDLE, chain)

    @property
    def plugin(self) -> Path:
        """The installed plugin."""
        return self.data / FILE_NAME

    @property
    def host(self) -> Path:
        """The configuration of the program that loads the chain."""
        return self.chain.parent.parent / HOST

    @property
    def designs(self) -> Path:
        """The folder of designs."""
        return self.data / "designs"


def built_plugin() -> Path:
    """Return the compiled plugin of this installation. NotFoundError: it is not built."""
    path = plugin_path()
    if path is None:
        raise NotFoundError(
            "the plugin is not built; install a C compiler, such as gcc, and run `make run` again"
        )
    return path


def install(places: Places, profile: str, device: str | None, rates_hz: tuple[int, ...]) -> None:
    """Write plugin, designs and LV2 bundle, and with a device PipeWire's drop-in. May be repeated.

    profile: of the drop-in. device: name of its sink. rates_hz: samplerates of the designs.
    NotFoundError: the plugin is not built. UsageError: a foreign file is in the way, or a
    samplerate is impossible. WriteError: a file cannot be written.
    """
    built = built_plugin()
    for rate_hz in rates_hz:
        check_format(rate_hz, 1)
    _refuse_foreign(places)
    variants = public_variants(built)
    designs = {
        f"{name}-{rate_hz}.design": core_design(
            rate_hz, CHANNELS, transform=LiveDesign.of(parameters_of(name), rate_hz).records()
        )
        for name in PROFILES
        for rate_hz in rates_hz
    }
    try:
        for folder in (places.designs, places.bundle, *([places.chain.parent] if device else [])):
            folder.mkdir(parents=True, exist_ok=True)
        for name, content in designs.items():
            write_bytes_atomically(places.designs / name, content)
        content = built.read_bytes()
        for folder in (places.data, places.bundle):
            # A host may have the old file mapped: it keeps it, since the new one takes its name.
            write_bytes_atomically(folder / FILE_NAME, content)
        texts = {"manifest.ttl": manifest, DESCRIPTION: description}
        for name, made in texts.items():
            write_bytes_atomically(places.bundle / name, made(variants, MARKER).encode())
        if device is not None:
            names = {"plugin": json.dumps(str(places.plugin)), "device": json.dumps(device)}
            write_bytes_atomically(places.chain, _filled("chain.conf", profile=profile, **names))
            if not any((folder / HOST).exists() for folder in (places.host.parent, *HOST_FOLDERS)):
                write_bytes_atomically(places.host, _filled("host.conf"))
    except OSError as error:
        raise WriteError(f"cannot write {error.filename}: {error.strerror}") from error


def remove(places: Places) -> list[Path]:
    """Remove what `install` wrote, and return it. UsageError: a foreign file is in its place."""
    _refuse_foreign(places)
    found = [places.plugin, *sorted(places.designs.glob("*.design")), places.chain]
    if places.host.exists() and _is_ours(places.host):
        found.append(places.host)
    found += [places.bundle / name for name in (FILE_NAME, "manifest.ttl", DESCRIPTION)]
    removed = [path for path in found if path.exists()]
    for path in removed:
        path.unlink()
    for folder in (places.designs, places.data, places.bundle):
        with suppress(OSError):  # somebody's own file is in it, or it is gone
            folder.rmdir()
    return removed


def loading_commands() -> tuple[str, str]:
    """Return the commands that load PipeWire's drop-in: now, and at every login."""
    now = "pipewire -c filter-chain.conf"
    return now, "systemctl --user enable --now filter-chain.service"


def _filled(name: str, **values: str) -> bytes:
    """Return a file of this package's folder `pipewire` with its variables filled in."""
    template = files("audioflinger_hook.plugin").joinpath("pipewire", name).read_text()
    return Template(template).substitute(values, marker=MARKER).encode()


def _refuse_foreign(places: Places) -> None:
    for path in (places.chain, places.bundle / "manifest.ttl"):
        if path.exists() and not _is_ours(path):
            raise UsageError(f"{path} is not of `cushion plugin install`; rename or remove it")


def _is_ours(path: Path) -> bool:
    try:
        return MARKER in path.read_text("utf-8", "replace").partition("\n")[0]
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}; move it away") from error
