from pathlib import Path

import pytest

from audioflinger_hook.config.profiles import LIVE_DEFAULT, PROFILES
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.plugin import install as installing
from audioflinger_hook.plugin.install import RATES_HZ
from tests.support.commands import call, refused

CHAIN = ".config/pipewire/filter-chain.conf.d/haptic-cushion.conf"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def files(folder: Path) -> list[Path]:
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


def test_install_writes_everything_twice_the_same_and_remove_takes_it_back(home: Path) -> None:
    own = home / ".config/pipewire/filter-chain.conf.d/own.conf"
    own.parent.mkdir(parents=True)
    own.write_text("# mine\n")
    written = []
    for _ in range(2):
        options = ("--device", "dac", "--profile", "game", "--rate", "22050")
        done = call("plugin", "install", *options)
        assert done.code == 0, done.stderr
        written.append({path: (home / path).read_bytes() for path in files(home)})
    first, second = written
    assert first == second
    designs = [path for path in first if path.suffix == ".design"]
    assert len(designs) == len(PROFILES) * (len(RATES_HZ) + 1)
    for path in designs:
        rate_hz = int(path.stem.rpartition("-")[2])
        assert Core(first[path]).info.samplerate == rate_hz
    chain = (home / CHAIN).read_text()
    assert "haptic_cushion_game" in chain
    assert 'target.object = "dac"' in chain
    library = home / ".local/share/haptic-cushion/haptic_cushion.so"
    assert call("plugin", "path").stdout.strip() == str(library)
    assert (call("plugin", "remove").code, files(home)) == (0, [own.relative_to(home)])
    assert call("plugin", "remove").stdout == ""


@pytest.mark.parametrize("path", [CHAIN, ".lv2/haptic-cushion.lv2/manifest.ttl"])
def test_a_foreign_file_is_neither_overwritten_nor_removed(home: Path, path: str) -> None:
    foreign = home / path
    foreign.parent.mkdir(parents=True)
    foreign.write_text("somebody's own\n")
    for command in (("install", "--device", "dac"), ("remove",)):
        assert f"{foreign} is not of `cushion plugin install`" in refused(call("plugin", *command))
    assert (files(home), foreign.read_text()) == ([Path(path)], "somebody's own\n")


def test_the_chain_has_the_default_of_what_is_played_unless_a_profile_is_named(home: Path) -> None:
    assert call("plugin", "install", "--rate", "10").code == 2
    assert call("plugin", "install", "--profile", "loud").code == 2
    assert files(home) == []
    for named, profile in ((), LIVE_DEFAULT), (("--profile", "paper"), "paper"):
        assert call("plugin", "install", "--device", 'a"b\\ } {', *named).code == 0
        assert f"label = haptic_cushion_{profile} " in (home / CHAIN).read_text()
        # Names of devices cannot break the chain.
        assert 'target.object = "a\\"b\\\\ } {"' in (home / CHAIN).read_text()


def test_without_a_plugin_it_says_what_to_do(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installing, "plugin_path", lambda: None)
    for what in ("install", "path"):
        assert "install a C compiler" in refused(call("plugin", what), 3)
    assert files(home) == []
