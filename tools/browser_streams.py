"""Records a browser's streams of films and calls: tools/browser_streams.py BROWSER [...].

BROWSER: path or name of Chromium's or Firefox's program. For each scene, the program starts a
private sound server with a microphone, and the browser with a small page that plays a film or
holds a call with itself. The properties of the streams are written as JSON to --output, or to
standard output. The file tests/device/server/browser_streams.json was recorded in this way.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tools.sound_server import PROGRAMS, SoundServer

# By scene: queries of the tabs, opened one after the other.
SCENES = {
    "film": ("film=element",),
    "web audio": ("film=web-audio",),
    "microphone": ("call=microphone",),
    "call": ("call=webrtc",),
    "web audio call": ("call=web-audio",),
    "film and call in one tab": ("film=element&call=webrtc",),
    "film, then call": ("film=element", "call=webrtc"),
    "call, then film": ("call=webrtc", "film=element"),
    "web audio, then call": ("film=web-audio", "call=webrtc"),
    "film, then call without echo cancellation": ("film=element", "call=webrtc&raw=1"),
}
PREFERENCES = {
    "media.autoplay.default": 0,
    "media.navigator.permission.disabled": True,
    "media.devices.unfocused.enabled": True,
    "dom.disable_open_during_load": False,
    "browser.aboutwelcome.enabled": False,
    "datareporting.policy.dataSubmissionEnabled": False,
}
KEPT = {
    *("application.name", "application.process.binary", "application.process.id"),
    *("client.id", "media.name", "media.role", "node.latency"),
}
START_S, SETTLES_S = 60.0, 7.0  # Chromium mixes its streams some seconds after a call begins

PAGE = """<!doctype html><script>
const asked = new URLSearchParams(location.search), says = (text) => fetch("/said?" + text);
document.title = location.search;
function film() {  // 60 s of a stereo tone
  const bytes = new Int16Array(22 + 2 * 48000 * 60), view = new DataView(bytes.buffer);
  const fields = [0x52494646, -bytes.byteLength + 8, 0x57415645, 0x666d7420, -16];
  fields.forEach((value, at) => view.setInt32(4 * at, Math.abs(value), value < 0));
  view.setInt32(20, 0x20001, true); view.setInt32(24, 48000, true); view.setInt32(28, 192000, true);
  view.setInt32(32, 0x100004, true); view.setInt32(36, 0x64617461);
  view.setInt32(40, bytes.byteLength - 44, true);
  for (let at = 22; at < bytes.length; at++) bytes[at] = 8000 * Math.sin((at >> 1) * 0.0144);
  return new Audio(URL.createObjectURL(new Blob([bytes], { type: "audio/wav" }))).play();
}
function webAudio() {
  const context = new AudioContext(), tone = new OscillatorNode(context, { frequency: 110 });
  tone.connect(context.destination);
  tone.start();
  return context.resume();
}
async function call(kind) {
  const processing = !asked.has("raw");
  const audio = { echoCancellation: processing, noiseSuppression: processing };
  window.microphone = await navigator.mediaDevices.getUserMedia({ audio });
  if (kind === "web-audio") await webAudio();
  if (kind !== "webrtc") return;
  const near = new RTCPeerConnection(), far = new RTCPeerConnection();
  near.onicecandidate = (event) => event.candidate && far.addIceCandidate(event.candidate);
  far.onicecandidate = (event) => event.candidate && near.addIceCandidate(event.candidate);
  const heard = new Promise((resolve) => (far.ontrack = (event) => resolve(event.streams[0])));
  near.addTrack(window.microphone.getTracks()[0], window.microphone);
  await near.setLocalDescription();
  await far.setRemoteDescription(near.localDescription);
  await far.setLocalDescription();
  await near.setRemoteDescription(far.localDescription);
  const voice = document.body.appendChild(document.createElement("audio"));
  voice.srcObject = await heard;
  await voice.play();
}
onload = async () => {
  if (asked.has("film")) await (asked.get("film") === "element" ? film() : webAudio());
  if (asked.has("call")) await call(asked.get("call"));
  await says("ready");
  if (asked.has("then")) setTimeout(() => open("/?" + asked.get("then")), 1000);
};
</script><body>"""


def record(browser: str, kind: str, tabs: tuple[str, ...]) -> dict[str, list[dict[str, str]]]:
    """Return the properties of the playing and recording streams. kind: see `SoundServer`."""
    with (
        tempfile.TemporaryDirectory(prefix="cushion-") as folder,
        tempfile.TemporaryDirectory(prefix="profile-") as profile,
        SoundServer(kind, Path(folder)) as server,
        _served() as (address, said),
    ):
        server.add_microphone("microphone")
        first = address + "?" + "&then=".join((tabs[0], *map(quote, tabs[1:])))
        command = _command(browser, Path(profile), first)
        with _started(command, server.environment):
            deadline_s = time.monotonic() + START_S
            while len(said) < len(tabs):
                if time.monotonic() > deadline_s:
                    raise SystemExit(f"browser_streams: error: {browser} does not play {tabs}")
                time.sleep(0.1)
            time.sleep(SETTLES_S)
            return {what: _streams(server, what) for what in ("sink-inputs", "source-outputs")}


def _streams(server: SoundServer, what: str) -> list[dict[str, str]]:
    found: list[Any] = json.loads(server.pactl("--format=json", "list", what))
    known = [one["properties"] for one in found]
    ours = [one for one in known if "application.process.binary" in one]
    return [{key: one[key] for key in sorted(KEPT & one.keys())} for one in ours]


def _command(browser: str, profile: Path, address: str) -> list[str]:
    if "firefox" in Path(browser).name:
        lines = (
            f"user_pref({json.dumps(key)}, {json.dumps(PREFERENCES[key])});\n"
            for key in PREFERENCES
        )
        (profile / "user.js").write_text("".join(lines))
        return [browser, "--headless", "--no-remote", "--profile", str(profile), address]
    options = [
        *("headless=new", "no-sandbox", "no-first-run", "use-fake-ui-for-media-stream"),
        *("autoplay-policy=no-user-gesture-required", "disable-popup-blocking"),
    ]
    return [browser, *(f"--{one}" for one in options), f"--user-data-dir={profile}", address]


@contextmanager
def _started(command: list[str], environment: dict[str, str]) -> Iterator[None]:
    quiet: Any = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    process = subprocess.Popen(command, env=environment, start_new_session=True, **quiet)
    try:
        yield
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextmanager
def _served() -> Iterator[tuple[str, list[str]]]:
    said: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if self.path.startswith("/said"):
                said.append(self.path)
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(PAGE.encode())

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/", said
        server.shutdown()


def main() -> int:
    """Record all scenes of the given browsers on both sound servers."""
    parser = argparse.ArgumentParser(description="Record which streams browsers make.")
    parser.add_argument("browser", nargs="+", help="program, such as chromium or firefox-esr")
    parser.add_argument("--output", type=Path, metavar="FILE", help="default: standard output")
    options = parser.parse_args()
    found = {
        Path(browser).name: {
            kind: {scene: record(browser, kind, tabs) for scene, tabs in SCENES.items()}
            for kind in sorted(PROGRAMS)
        }
        for browser in options.browser
    }
    text = json.dumps(found, indent=1) + "\n"
    if options.output:
        options.output.write_text(text)
    else:
        sys.stdout.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
