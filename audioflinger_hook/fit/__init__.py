"""Fits the strength of the vibration to one person and device, by comparing vibrations."""

import tomllib
from importlib.resources import files
from types import SimpleNamespace

PROTOCOL_TEXT = files(__name__).joinpath("protocol.toml").read_text("utf-8")
PROTOCOL = SimpleNamespace(**tomllib.loads(PROTOCOL_TEXT))
