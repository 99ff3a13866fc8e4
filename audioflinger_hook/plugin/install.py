"""Installation of the plugin, its designs, an LV2 bundle and a PipeWire configuration."""

import json
from collections.abc import Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from string import Template

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.core import FILE_NAME
from audioflinger_hook.core import library_path as plugin_path
from audioflinger_hook.core.design import core_design
from audioflinger_hook.plugin.variants import DESCRIPTION, description, manifest, public_variants
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.parameters import check_format
from device.atomic_file import write_bytes_atomically
from device.errors import NotFoundError, UsageError, WriteError

CHANNELS = 2  # channels of sound in the designs; the mono variant duplicates its input

RATES_HZ = (44_100, 48_000, 88_200, 96_000, 176_400, 192_000)
MARKER = "Written by `cushion plugin install`; `cushion plugin remove` removes it."
CHAIN = "haptic-cushion.conf"
HOST = "filter-chain.conf"
HOST_FOLDERS = (Path("/usr/share/pipewire"), Path("/etc/pipewire"))
LOADING_COMMANDS = (  # load the PipeWire configuration now, and at every login
    "pipewire -c filter-chain.conf",
    "systemctl --user enable --now filter-chain.service",
)


class Places:
    """Installation paths of a user. UsageError: HOME is not an absolute path.

    data: folder of the installed `plugin` and of the folder `designs`. bundle: for LV2. chain:
    PipeWire's filter chain. host: configuration of the PipeWire process that loads the chain.
    """

    def __init__(self, environ: Mapping[str, str]) -> None:
        home = environ.get("HOME", "")
        if not home.startswith("/"):
            raise UsageError(f"HOME is {home!r}; allowed: an absolute path; set it")
        data = Path(environ.get("XDG_DATA_HOME") or f"{home}/.local/share")
        config = Path(environ.get("XDG_CONFIG_HOME") or f"{home}/.config") / "pipewire"
        self.data, self.bundle = data / "haptic-cushion", Path(home) / ".lv2" / "haptic-cushion.lv2"
        self.plugin, self.designs = self.data / FILE_NAME, self.data / "designs"
        self.chain, self.host = config / "filter-chain.conf.d" / CHAIN, config / HOST


def built_plugin() -> Path:
    """Return the path of the compiled plugin. NotFoundError: the plugin is not built."""
    path = plugin_path()
    if path is None:
        raise NotFoundError(
            "the plugin is not built; install a C compiler, such as gcc, and run `make run` again"
        )
    return path


def install(places: Places, profile: str, device: str | None, rates_hz: tuple[int, ...]) -> None:
    """Install or update the plugin, its designs and the LV2 bundle.

    device: name of a sink, for which a PipeWire configuration with `profile` is written; None for
    no configuration. rates_hz: sample rates of the designs.
    NotFoundError: the plugin is not built or cannot be loaded. UsageError: a path belongs to
    another program, or a sample rate is not supported. WriteError: a file cannot be written.
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
            # A host may have mapped the old file, which an atomic replacement does not change.
            write_bytes_atomically(folder / FILE_NAME, content)
        for name, made in (("manifest.ttl", manifest), (DESCRIPTION, description)):
            write_bytes_atomically(places.bundle / name, made(variants, MARKER).encode())
        if device is not None:
            names = {"plugin": json.dumps(str(places.plugin)), "device": json.dumps(device)}
            write_bytes_atomically(places.chain, _filled("chain.conf", profile=profile, **names))
            if not any((folder / HOST).exists() for folder in (places.host.parent, *HOST_FOLDERS)):
                write_bytes_atomically(places.host, _filled("host.conf"))
    except OSError as error:
        raise WriteError(f"cannot write {error.filename}: {error.strerror}") from error


def remove(places: Places) -> list[Path]:
    """Remove what `install` wrote; return the paths. UsageError: one belongs to another program."""
    _refuse_foreign(places)
    found = [places.plugin, *sorted(places.designs.glob("*.design")), places.chain]
    if places.host.exists() and _is_ours(places.host):
        found.append(places.host)
    found += [places.bundle / name for name in (FILE_NAME, "manifest.ttl", DESCRIPTION)]
    removed = [path for path in found if path.exists()]
    for path in removed:
        path.unlink()
    for folder in (places.designs, places.data, places.bundle):
        with suppress(OSError):  # the folder contains other files, or does not exist
            folder.rmdir()
    return removed


def _filled(name: str, **values: str) -> bytes:
    """Return a template of the folder `pipewire` with values for its variables."""
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
