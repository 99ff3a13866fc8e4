"""Write the vibration of a sound file in four formats: export_formats.py SOUND FOLDER."""

import sys
from pathlib import Path

from audioflinger_hook import Settings
from audioflinger_hook.exports.export import ExportOptions, export
from audioflinger_hook.sources import FileTap, TapClient

source, folder = map(Path, sys.argv[1:])
folder.mkdir(exist_ok=True)
for name in ("flac", "ahap", "haptic", "hjif"):
    target = folder / f"{source.stem}.{name}"
    export(TapClient(FileTap(source)), target, Settings(profile="cinema"), ExportOptions(name))
    print(f"{target.name}: {target.stat().st_size} bytes")
