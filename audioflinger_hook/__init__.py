"""Compute vibration, by default with frequencies of 21.5 to 220 Hz, from a computer's sound.

    taps -> clients -> mixer -> effect (transform) -> device.drive -> device outputs

`render_file` renders a whole file. `HapticTransform` processes arrays block by block.
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = ["HapticTransform", "Settings", "TransformParameters", "__version__", "render_file"]

if TYPE_CHECKING:
    from audioflinger_hook.config.settings import Settings
    from audioflinger_hook.offline.render import render_file
    from audioflinger_hook.transform import HapticTransform, TransformParameters

_HOMES = {
    "HapticTransform": "audioflinger_hook.transform",
    "Settings": "audioflinger_hook.config.settings",
    "TransformParameters": "audioflinger_hook.transform",
    "render_file": "audioflinger_hook.offline.render",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `cushion --help` does not load NumPy."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
