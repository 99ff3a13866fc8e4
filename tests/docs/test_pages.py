import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook import __version__
from audioflinger_hook.cli.parser import COMMANDS, build_parser
from audioflinger_hook.config import file as config
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.schema import ACTUATOR, APPLICATION, KEYS
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.drive.settings import DELAY_MAX_MS, GAIN_MIN_DB
from device.errors import UsageError
from tests.support.commands import RATE, call, cushion, noise, sound, vibration
from tests.support.data import table
from tests.support.parameters import CHOICES, LIMITS
from tests.support.signals import tone
from tools.docs.__main__ import ROOT, outdated
from tools.docs.commands import parser_of
from tools.docs.errors import AREAS, VALUE
from tools.docs.figures import SENTENCES, Benchmarks, corrected, figures

README = "README.md"
PAGES = (README, *sorted(path.relative_to(ROOT).as_posix() for path in ROOT.glob("docs/**/*.md")))
CONFIG, EFFECTS, ACTUATORS = "docs/config.md", "docs/effects.md", "docs/actuators.md"
ACTUATOR_KEYS = tuple(ActuatorSettings.DESCRIPTIONS)
USAGE = re.compile(r"\[options\]|^cushion (COMMAND|NAME)")  # a line that shows a form, not a call


def text_of(page: str) -> str:
    return (ROOT / page).read_text()


def block(language: str, page: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", text_of(page), re.DOTALL)
    assert found, f"{page} has no {language} block"
    return found[1]


def test_the_config_example_is_valid_complete_and_the_default(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text(block("toml", CONFIG))
    found, problems = config.check(path)
    assert problems == []
    assert found == config.Config(Settings(profile=LIVE_DEFAULT), LiveSettings(device="sink:NAME"))
    for key in KEYS:
        if key.section in (ACTUATOR, APPLICATION):  # tables of a list, which is empty
            continue
        # A key without a default stands there as a comment, and so may a profile's.
        comment = "(# )?" if key.owner is TransformParameters or key.default is None else ""
        shown = rf"^{comment}{key.name} = "
        assert re.search(shown, block("toml", CONFIG), re.MULTILINE), f"{key.name} is missing"


def test_the_generated_parts_are_those_of_the_code_and_the_table_names_all_commands() -> None:
    assert not outdated(), "run `python -m tools.docs --write`"
    for key in KEYS:
        assert f"\n| `{key.name}` |" in text_of(CONFIG)
    named = re.findall(r"^\| \[`cushion ([\w-]+)`\]", text_of("docs/commands.md"), re.MULTILINE)
    found = re.findall(r"^    ([\w-]+)(?: |$)", build_parser().format_help(), re.MULTILINE)
    assert set(named) == set(found)


def test_the_example_of_several_actuators_is_valid_and_names_every_key(tmp_path: Path) -> None:
    example, path = block("toml", ACTUATORS), tmp_path / "config.toml"
    path.write_text(example)
    done, problems = config.check(path)
    assert problems == []
    assert done is not None
    assert [actuator.source for actuator in done.settings.actuators] == ["left", "right"]
    told = {key for key in ACTUATOR_KEYS if re.search(rf"^{key} = ", example, re.MULTILINE)}
    assert told == {*ACTUATOR_KEYS} - {"damping"}  # named beside rig and protection
    for limit in (GAIN_MIN_DB, DELAY_MAX_MS):
        assert f"{limit:g}" in example


def test_every_parameter_stands_in_the_config_example_with_default_limits_and_choices() -> None:
    for key in TransformParameters.DESCRIPTIONS:
        found = re.search(rf"^(# )?({key} = .*)", block("toml", CONFIG), re.MULTILINE)
        assert found, key
        assert tomllib.loads(found[2])[key] == getattr(TransformParameters(), key)
        if key in LIMITS:
            assert f"{LIMITS[key].low:g} to {LIMITS[key].high:g}" in found[2]
        if key in CHOICES:
            assert all(f'"{word}"' in found[2] for word in CHOICES[key].words)


@pytest.mark.exhaustive
def test_the_effect_of_one_s_own_runs_before_the_haptic_effect_and_halves_it(tmp_path, site):
    lines = []
    for group, entries in tomllib.loads(block("toml", EFFECTS))["project"]["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    site("gentle", block("python", EFFECTS), "\n".join(lines))
    env = {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}
    (tmp_path / "audio_effects.xml").write_text(block("xml", EFFECTS))
    chosen = re.findall(r"```toml\n(effects_file.*?)```", text_of(EFFECTS), re.DOTALL)
    (tmp_path / "config.toml").write_text("".join(chosen))
    sound(tmp_path / "sound.wav", tone(440.0, 1.0, RATE, 0.4))

    def ran(*arguments: str) -> str:
        done = cushion(*arguments, env=env, cwd=tmp_path)
        assert (done.code, done.stderr) == (0, "")
        return done.stdout

    dump = ran("dump", "--tap", "scene:demo", "--config", "config.toml")
    assert re.findall(r"Effect \d: (.*)", dump) == ["Gentle", "Haptic Cushion"]
    ran("render", "sound.wav", "plain.wav")
    ran("render", "sound.wav", "halved.wav", "--config", "config.toml")
    both = (vibration(tmp_path / f"{name}.wav") for name in ("plain", "halved"))
    plain, halved = (np.abs(one).max() for one in both)
    assert halved == pytest.approx(plain / 2, rel=0.02)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_command_reference_names_every_option_of_the_help(command: str) -> None:
    page = text_of("docs/commands.md")
    section = page.partition(f"\n## cushion {command}\n")[2].partition("\n## ")[0]
    said = parser_of(command).format_help()
    options = set(re.findall(r"(?<![\w-])--[a-z][\w-]*", said.partition("example:")[0]))
    shown = set(re.findall(r"^\| (?:`|<code>)(--[a-z][\w-]*)", section, re.MULTILINE))
    assert shown == options - {"--help", "--debug"}


def links_of(page: str) -> list[str]:
    """Return the targets of a page's links, without those to other sites and those in code."""
    text = re.sub(r"^```.*?^```", "", text_of(page), flags=re.DOTALL | re.MULTILINE)
    targets = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", text))
    return [target for target in targets if "://" not in target]


def anchors_of(page: str) -> set[str]:
    """Return the anchors that a page offers: those of its headings, as a forge makes them."""
    text = re.sub(r"^```.*?^```", "", text_of(page), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r'<a id="([^"]+)">', text))


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_to_a_file_and_a_heading_that_exist(page: str) -> None:
    for link in links_of(page):
        name, _, anchor = link.partition("#")
        target = ((ROOT / page).parent / name).resolve() if name else ROOT / page
        assert target.exists(), link
        if anchor:
            assert anchor in anchors_of(target.relative_to(ROOT).as_posix()), link


@pytest.mark.parametrize("page", PAGES)
def test_every_command_line_is_one_that_the_parser_accepts(page: str) -> None:
    for line in commands_in(text_of(page)):
        filled = re.sub(r"\$\w+", "1", line)  # what the shell fills in
        _, *words = shlex.split(filled, comments=True)
        if len(words) == 1 and words[0] in COMMANDS:
            continue  # a command's name alone, in a sentence
        try:
            build_parser().parse_args(words)
        except UsageError as error:
            pytest.fail(f"{page}: {line}: {error}")


def commands_in(text: str) -> list[str]:
    """Return the lines of a page's code, in blocks, that call cushion."""
    joined = text.replace("\\\n", " ")
    found = re.findall(r"^(?: {4}|\$ )?((?:\.venv/bin/)?cushion .*)$", joined, re.MULTILINE)
    spans = re.findall(r"(?<!\[)`((?:\.venv/bin/)?cushion [a-z][^`\n]*)`", text)
    lines = [line for line in (*found, *spans) if not USAGE.search(line)]
    return [line for line in lines if len(line.split()) > 1]


def test_the_readme_is_short_and_names_the_commands_that_do_the_set_up() -> None:
    assert len(text_of(README).split()) <= 1_000  # read in four minutes
    assert all(f"`make {goal}`" in text_of(README) for goal in ("run", "test"))
    assert f"\nversion: {__version__}\n" in text_of("CITATION.cff")


@pytest.mark.parametrize("page", ["architecture", "decisions", "transform", "benchmarks"])
def test_every_file_that_a_page_names_exists(page: str) -> None:
    files = [f"/{path.relative_to(ROOT).as_posix()}" for path in ROOT.glob("*/**/*.py")]
    named = re.findall(r"`([\w/]+/\w+\.py)`", text_of(f"docs/{page}.md"))
    assert [name for name in named if not any(file.endswith(f"/{name}") for file in files)] == []


def test_every_figure_is_said_somewhere_and_corrected_wherever_its_line_breaks() -> None:
    said = " ".join(sentence for sentences in SENTENCES.values() for sentence in sentences)
    assert [name for name in figures(Benchmarks()) if f"{{{name}}}" not in said] == []
    text = "It is quick: 7 ms\nlate, 1.5 % of\na core. It is 7 ms late elsewhere, too.\n"
    found = corrected("page", text, ("quick: {a} ms late, {b} % of a",), {"a": "12", "b": "-0.2"})
    assert found == text.replace("quick: 7", "quick: 12").replace("1.5", "-0.2")


@pytest.mark.parametrize("text", ["It is fast.", "It is 7 ms late. It is 8 ms late."])
def test_a_sentence_that_a_page_says_never_or_twice_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"page says 'is \{a\} ms late'"):
        corrected("page", text, ("is {a} ms late",), {"a": "9"})


def test_another_measurement_changes_the_figure(tmp_path: Path) -> None:
    document = json.loads((ROOT / "docs/benchmarks.json").read_text())
    [row] = [
        row
        for section in document["sections"]
        for row in section["rows"]
        if (section["title"], row["name"], row["column"])
        == ("Steady tones", "worst THD+N, 150 to 11000 Hz", "live")
    ]
    row["value"] = -71.9
    path = tmp_path / "benchmarks.json"
    path.write_text(json.dumps(document))
    assert figures(Benchmarks(path)) == {**figures(Benchmarks()), "thdn_db": "-71"}


class Fetched(HTMLParser):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        if tag == "link" and found.get("rel") not in ("canonical", "prev", "next"):
            self.sources.append(found["href"])
        elif "src" in found:
            self.sources.append(found["src"])


@pytest.mark.exhaustive
def test_the_site_builds_without_warnings_and_fetches_nothing(tmp_path: Path) -> None:
    if find_spec("material") is None:
        pytest.skip("mkdocs-material is not installed: run `make docs` once")
    # Without --quiet, which would count no warnings, as of broken links.
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    pages = [path for path in tmp_path.rglob("*.html") if path.name != "404.html"]
    assert len(pages) == len(list(ROOT.glob("docs/**/*.md")))
    fetched = {source for path in pages for source in Fetched(path).sources}
    assert fetched
    assert [source for source in fetched if "//" in source] == []
    styles = "".join(path.read_text() for path in tmp_path.rglob("*.css"))
    assert "url(http" not in styles
    assert "@import" not in styles


PAGE = (ROOT / "docs/errors.md").read_text()
LINES = dict(re.findall(r'^\| <a id="([\w-]+)"></a>(.*) \| (?:\d|warning) \|$', PAGE, re.MULTILINE))

CALLS = table("wrong-calls.toml")

TEXTS = [re.sub(r"\\([|*_])", r"\1", shown).replace("&lt;", "<") for shown in LINES.values()]
PATTERNS = [
    ".*".join(map(re.escape, text.split(VALUE)))
    for text in TEXTS
    if len(text.replace(VALUE, "").strip()) >= 12
]
"""Messages with any values; those of a few words alone, such as "… is …", fit too much."""


def test_anchors_are_unique_and_every_area_has_messages() -> None:
    assert len(re.findall(r'<a id="', PAGE)) == len(LINES) > 300
    assert re.findall(r"^## (.+)$", PAGE, re.MULTILINE) == list(AREAS)


@pytest.mark.parametrize("what", CALLS)
def test_what_a_wrong_command_says_is_on_the_page(what, tmp_path, monkeypatch):
    sound(tmp_path / "sound.wav", noise(RATE))
    (tmp_path / "text.txt").write_text("no sound")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    done = call(*CALLS[what])
    assert done.code in (2, 3, 4, 5)
    said = done.stderr.strip().splitlines()[-1].removeprefix("cushion: ").removeprefix("error: ")
    assert any(re.fullmatch(pattern, said, re.DOTALL) for pattern in PATTERNS), said
