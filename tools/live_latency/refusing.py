"""A substitute for `pw-cli` that does not create links from the ports of players.

The daemon then has to record the monitor of the sink.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from device.errors import NotFoundError

SCRIPT = """\
#!/bin/sh
while read -r line; do
    set -- $line
    if [ "$1" = create-link ]; then
        case $(pw-dump "$3") in *'"output_F'* | *'"output_MONO'*) continue ;; esac
    fi
    printf "%s\\n" "$line"
done | exec {pw_cli} "$@"
"""


def refusing_pw_cli(folder: Path, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Write the substitute to a new folder, and return a variable PATH that begins with the folder.

    NotFoundError: pw-cli is not installed.
    """
    pw_cli = shutil.which("pw-cli")
    if pw_cli is None:
        raise NotFoundError("pw-cli is not installed; run tools/fetch_servers.sh")
    bin_folder = folder / "refusing"
    bin_folder.mkdir()
    program = bin_folder / "pw-cli"
    program.write_text(SCRIPT.format(pw_cli=pw_cli))
    program.chmod(0o755)
    return {"PATH": f"{bin_folder}{os.pathsep}{environment['PATH']}"}
