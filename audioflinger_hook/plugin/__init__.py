"""The core as a plugin of other audio software: LADSPA and LV2."""

from __future__ import annotations

from audioflinger_hook.core import FILE_NAME
from audioflinger_hook.core import library_path as plugin_path

__all__ = ["FILE_NAME", "plugin_path"]
