from typing import Any

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.sources import parse_tap
from device.address import parse_device


def config(device: str = "sink:dac", settings: Settings | None = None, **live: Any) -> RunConfig:
    chosen = LiveSettings(device=device, **live)
    return RunConfig(parse_tap(chosen.tap[0]), parse_device(device), settings or Settings(), chosen)
