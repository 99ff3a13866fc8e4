"""The page "Try it" as a folder, which any web server can serve."""

import re
import threading
from urllib.request import urlopen

from audioflinger_hook.monitor import try_page as page
from audioflinger_hook.monitor.try_page import PROFILES, RATES, content_type, page_files
from tools import try_page

POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; connect-src 'self'; "
    "style-src 'self'; worker-src 'self'; manifest-src 'self'; media-src blob:; "
    "img-src 'self' data:"
)


def test_the_folder_holds_the_whole_page_with_its_policy(tmp_path, capsys):
    assert try_page.main(["--out", str(tmp_path)]) == 0
    assert "any web server can serve this folder" in capsys.readouterr().out
    found = {path.name for path in tmp_path.iterdir()}
    assert found == page_files().keys()
    assert {f"{profile}-{rate}.design" for profile in PROFILES for rate in RATES} < found
    index = (tmp_path / "index.html").read_text()
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', index)
    assert policy.startswith(f"{POLICY}; ")
    texts = [path.read_text() for path in tmp_path.iterdir() if path.suffix in {".js", ".css"}]
    addresses = re.findall(r"https?://[^\"'\s]+|[\"'(]//\w[^\"'\s]*", "".join([index, *texts]))
    assert set(addresses) <= {"http://www.w3.org/2000/svg"}
    named = set(re.findall(r'(?:src|href)="([\w.]+)"', index))
    named |= {
        name for text in texts for name in re.findall(r'(?:from |URL\()"(?:\./)?([^"]+)"', text)
    }
    assert named <= found


def test_a_browser_keeps_no_file_of_another_version(monkeypatch):
    made, versions = page._design, {page._offline.__wrapped__()}
    for name, value in (
        ("SCENE_CODE", ("demo.py",)),
        ("__version__", "another"),
        ("_design", lambda profile, rate: made(profile, rate) + b"." * (profile == "speech")),
    ):
        monkeypatch.setattr(page, name, value)
        versions.add(page._offline.__wrapped__())
    assert len(versions) == 4


def test_the_folder_is_served_with_media_types_and_a_taken_port_is_reported(tmp_path, capsys):
    try_page.write(tmp_path)
    with try_page.server(tmp_path, 0) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        for name in ("", "core.wasm", "try.webmanifest"):
            with urlopen(f"http://127.0.0.1:{serving.server_port}/{name}") as answer:
                kind = content_type(name or "index.html")
                assert answer.headers["Content-Type"] == kind
        options = ["--out", str(tmp_path), "--serve", "--port", str(serving.server_port)]
        assert try_page.main(options) == 1
        assert "give another --port" in capsys.readouterr().err
        try:
            raise BrokenPipeError
        except BrokenPipeError:
            serving.handle_error(None, None)  # a browser that ends a download
        serving.shutdown()
    assert capsys.readouterr().err == ""
