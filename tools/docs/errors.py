"""Generates the list of messages in docs/errors.md from the code that raises or prints them."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import device.errors
from device.errors import CushionError

ROOT = Path(__file__).resolve().parents[2]
VALUE = "…"  # placeholder of a value in a message
CODES = {
    name: kind.exit_code
    for name, kind in vars(device.errors).items()
    if isinstance(kind, type) and issubclass(kind, CushionError)
}
AREAS = {
    "Command line": ("audioflinger_hook/cli",),
    "Config file": ("audioflinger_hook/config", "device/values.py", "device/drive"),
    "Sound files and captures": (
        *("audioflinger_hook/offline", "audioflinger_hook/capture", "audioflinger_hook/sources"),
        *("audioflinger_hook/pipeline", "audioflinger_hook/exports"),
        *("device/wav_output.py", "device/atomic_file.py"),
    ),
    "Catalogues": ("audioflinger_hook/catalogue",),
    "Live sound": ("audioflinger_hook/daemon", "device/stream", "device/server", "device/clock"),
    "Service, status and page": ("audioflinger_hook/service", "audioflinger_hook/monitor"),
    "USB devices and sound cards": ("device/usb", "device/alsa", "device/address.py"),
    "Rigs and calibration": ("device/rig", "device/identification", "device/volume_limit.py"),
    "Plugin": ("audioflinger_hook/plugin",),
    "Mixer, effects and library": ("audioflinger_hook", "device"),
}


def errors_list() -> str:
    """Return all messages by area, without repetition, each with its anchor and exit code."""
    areas: dict[str, dict[str, str]] = {area: {} for area in AREAS}
    for path in sorted([*ROOT.glob("audioflinger_hook/**/*.py"), *ROOT.glob("device/**/*.py")]):
        name = path.relative_to(ROOT).as_posix()
        area = next(area for area, homes in AREAS.items() if name.startswith(homes))
        for text, code in messages(ast.parse(path.read_text())):
            areas[area].setdefault(text, code)
    parts, anchors = [], set[str]()
    for area, found in areas.items():
        if not found:
            continue
        lines = [f"## {area}", "", "| message | exit code |", "| --- | --- |"]
        for text, code in sorted(found.items(), key=lambda entry: entry[0].lstrip(f"{VALUE}' ")):
            anchor = unused(slug(text), anchors)
            shown = text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")
            lines.append(f'| <a id="{anchor}"></a>{shown.replace("_", chr(92) + "_")} | {code} |')
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def messages(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield the text of each message in a module, and its exit code or "warning"."""
    constants = {
        target.id: statement.value
        for statement in tree.body
        if isinstance(statement, ast.Assign)
        for target in statement.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or not node.args:
            continue
        called = node.func
        name = called.id if isinstance(called, ast.Name) else getattr(called, "attr", "")
        said = node.args[0]
        text = template(constants.get(said.id, said) if isinstance(said, ast.Name) else said)
        if len(re.sub(rf"[{VALUE}\W]+", "", text)) < 6:
            continue  # the message of another error is passed on
        if name in CODES:
            yield text, str(CODES[name])
        elif name == "Refusal":  # a message about a setting: key, value and allowed values
            yield f"{VALUE}={VALUE} {text}; allowed: {VALUE}", "2"
        elif name == "warn":
            yield text, "warning"


def template(node: ast.expr) -> str:
    """Return the text of a string or f-string, with placeholders for values; "" for other nodes."""
    if isinstance(node, ast.Constant):
        return " ".join(node.value.split()) if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        pieces = (getattr(piece, "value", "") for piece in node.values)
        return " ".join("".join(p if isinstance(p, str) else VALUE for p in pieces).split())
    return ""


def slug(text: str) -> str:
    """Return an anchor made of the first eight words of a message."""
    words = re.findall(r"[a-z0-9]+", text.lower().replace(VALUE, " "))
    return "e-" + "-".join(words[:8])


def unused(anchor: str, anchors: set[str]) -> str:
    """Return a unique anchor, with a number appended if necessary, and add it to `anchors`."""
    wanted, count = anchor, 2
    while wanted in anchors:
        wanted, count = f"{anchor}-{count}", count + 1
    anchors.add(wanted)
    return wanted
