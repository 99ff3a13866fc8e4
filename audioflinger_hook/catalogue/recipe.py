"""Options of a run, and the key that shows whether an existing result is still valid."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from audioflinger_hook.catalogue.item import Item
from audioflinger_hook.catalogue.storage import sha256_of
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.options import FORMATS, ExportOptions
from audioflinger_hook.transform import TRANSFORM_VERSION
from device.rig.rig import SHIPPED

VERSION = f"{TRANSFORM_VERSION}.2"  # increase it if results of equal input change


@dataclass(frozen=True)
class Recipe:
    """Options that apply to all results of a run.

    out: path or URL of the folder of the results. track, language: sound track of films, for items
    without a value of their own. verify: whether sounds are identified by SHA-256, not by path,
    size and time. retry_died: whether to try again items that have ended their workers. version:
    `VERSION` of the program that started the run.
    """

    out: str
    settings: Settings
    options: ExportOptions
    track: int | None = None
    language: str | None = None
    verify: bool = False
    retry_died: bool = False
    version: str = VERSION
    _digests: dict[tuple[Any, Any], str] = field(default_factory=dict, init=False, compare=False)

    def name(self, item: Item) -> str:
        """Return the name of an item's result within the output folder."""
        return item.id + FORMATS[self.options.format].suffixes[0]

    def settings_of(self, item: Item) -> Settings:
        """Return the settings for one item, which may have its own profile and channels."""
        channels = item.channels if isinstance(item.channels, str) else None
        named = {"profile": item.profile, "channels": channels}
        given = {name: value for name, value in named.items() if value is not None}
        return self.settings.choosing(**given) if given else self.settings

    def key(self, item: Item, identity: Mapping[str, Any]) -> str:
        """Return a hash, 32 hexadecimal digits, of everything that determines a result's bytes."""
        film = [item.track or self.track, item.language or self.language]
        part = [item.start_s, item.duration_s, item.picked, *film]
        known, chosen = self._digests, (item.profile, item.channels)
        if chosen not in known:
            settings = self.settings_of(item)
            named = [settings.rig, *(actuator.rig for actuator in settings.actuators)]
            paths = [name for name in named if name is not None and name not in SHIPPED]
            paths += [str(settings.effects_file)] if settings.effects_file else []
            files = [sha256_of(Path(path)) for path in paths]
            document = [self.version, asdict(self.options), asdict(settings), files]
            text = json.dumps(document, sort_keys=True, default=str)
            known[chosen] = hashlib.sha256(text.encode()).hexdigest()
        return hashlib.sha256(_to_json([known[chosen], part, identity]).encode()).hexdigest()[:32]

    def described(self) -> dict[str, Any]:
        """Return version, export options and settings, ready for JSON."""
        return {
            "version": self.version,
            **asdict(self.options),
            "settings": json.loads(json.dumps(asdict(self.settings), default=str)),
        }


_to_json = json.JSONEncoder(sort_keys=True).encode  # `json.dumps` would make an encoder each time
