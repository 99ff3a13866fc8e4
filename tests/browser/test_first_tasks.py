"""What a person who watches a film does with the live page first."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.browser.conftest import CONFIG, says, state
from tests.servers.daemons import tone
from tests.servers.listening import playing, wait_for
from tests.support.data import text
from tools.live_page import open_page

pytestmark = pytest.mark.browser

SIZES = [(1366, 768), (390, 844)]
FIRST = [
    *("#state-word", "#power", "#control-gain_db", "#control-profile", "#control-offset_ms"),
    *("#sync", "#applications button", "#undo", "#save"),
]
STEPS_MAX = 2  # clicks and drags of one task


def opened(room, size, theme="dark"):
    page = open_page(room.chromium, room.monitor.new_address(), size[0], theme)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.on("pageerror", lambda error: room.errors.append(str(error)))
    state(page, "Running", "Idle")
    page.locator("#control-gain_db").wait_for()
    return page


def drag(page, selector, share):
    """Drag a slider's thumb to a share of its length."""
    page.locator(selector).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    now = page.evaluate(
        """(selector) => {
          const { value, min, max } = document.querySelector(selector);
          return (value - min) / (max - min);
        }""",
        selector,
    )
    thumb = min(30.0, box["height"])
    x = [box["x"] + 0.5 * thumb + one * (box["width"] - thumb) for one in (now, share)]
    x[1] += 5.0 * (share == 1.0)  # a finger goes a little past the end
    y = box["y"] + 0.5 * box["height"]
    page.mouse.move(x[0], y)
    page.mouse.down()
    page.mouse.move(x[1], y, steps=8)
    page.mouse.up()


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_the_first_screen_has_all_that_is_used_first(room, film, size):
    page = opened(room, size)
    says(page, "#applications", "Film")
    bar_top = page.locator("#bar").bounding_box()["y"]
    below = []
    for selector in FIRST:
        box = page.locator(selector).first.bounding_box()
        limit = size[1] if selector in ("#undo", "#save") else bar_top
        if box is None or box["y"] < 0 or box["y"] + box["height"] > limit:
            below.append((selector, box))
    scrolled = page.evaluate("scrollY")
    page.context.close()
    assert (below, scrolled) == ([], 0)


@pytest.mark.parametrize("width", [320, 390, 768, 1024, 1280, 1366])
def test_names_of_applications_stay_whole_and_parts_stay_inside_their_panels(room, width):
    with playing(room.server, "desktop", tone(440.0, 30.0), name="Film player"):
        page = opened(room, (width, 768))
        says(page, "#applications", "Film player")
        name_lines, outside = page.evaluate(text("parts-outside.js"))
        page.context.close()
    assert (name_lines, outside) == (1, [])


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_five_first_tasks_take_at_most_two_steps_each(room, film, size):
    page = opened(room, size)
    page.evaluate("window.steps = 0; addEventListener('pointerdown', () => window.steps++, true)")
    values = page.locator("[data-control='gain_db'] input[type=number]")
    wait_for(lambda: values.input_value() == "-3", "the file's strength")
    taken = {}

    def task(name, does, done):
        before = page.evaluate("window.steps")
        does()
        wait_for(done, name, 20.0)
        taken[name] = page.evaluate("window.steps") - before

    task(
        "louder",
        lambda: drag(page, "#control-gain_db", 1.0),
        lambda: values.input_value() == "0" and page.is_enabled("#save"),
    )
    music = page.get_by_role("radio", name="Music")
    profile = page.locator(".control:has(#control-profile)")
    task("profile", music.check, lambda: profile.get_attribute("data-unsaved") == "true")
    task(
        "leave out",
        page.get_by_role("button", name="Leave out Film").click,
        lambda: page.get_by_role("button", name="Include Film").count() == 1,
    )
    delay = page.locator(".control:has(#control-offset_ms)")
    task(
        "delay",
        lambda: drag(page, "#control-offset_ms", 0.2),
        lambda: delay.get_attribute("data-unsaved") == "true",
    )
    task("save", lambda: page.click("#save"), lambda: page.inner_text("#unsaved") == "All is saved")
    saved = room.config.read_text()
    for _ in range(200):
        if page.is_disabled("#undo"):
            break
        page.evaluate("document.getElementById('undo').click()")  # nothing once it is disabled
        page.wait_for_timeout(100)
    page.click("#save")
    wait_for(lambda: page.is_disabled("#save"), "the file as before")
    room.config.write_text(CONFIG)
    page.context.close()
    print(size, taken)
    assert all(1 <= steps <= STEPS_MAX for steps in taken.values()), taken
    assert 'profile = "music"' in saved
    assert "gain_db = 0.0 # the neighbours" in saved
    assert "offset_ms = " in saved
    assert "Film" in saved


def test_a_change_is_shown_as_not_saved_after_a_reload_beside_what_the_file_says(room, page):
    page.locator("#control-gain_db").fill("-9")
    wait_for(lambda: page.is_enabled("#save"), "the change")
    page.reload()
    state(page, "Running", "Idle")
    box = ".control:has(#control-gain_db)"
    says(page, box, "Not saved. In the file: -3 dB")
    assert page.locator(box).locator("input[type=number]").input_value() == "-9"
    says(page, "#unsaved", "Not saved: Strength")
    page.get_by_role("button", name="Strength: as in the file").click()
    says(page, "#unsaved", "All is saved")
    assert page.locator(box).locator("input[type=number]").input_value() == "-3"
    assert room.config.read_text() == CONFIG


def test_sliders_offer_only_what_the_other_settings_allow(page):
    def ends(key):
        slider = page.locator(f"#control-{key}")
        return float(slider.get_attribute("min")), float(slider.get_attribute("max"))

    assert ends("offset_ms") == (0.0, 1000.0)  # below 0, only drop-in mode
    assert ends("transform-band_low_hz")[1] == 1000.0
    high = page.locator(".control:has(#control-transform-band_high_hz) input[type=number]")
    high.fill("600")
    high.press("Enter")
    wait_for(lambda: ends("transform-band_low_hz")[1] <= 300.0, "half of the highest frequency")
    page.locator("#control-transform-band_low_hz").fill("300")
    wait_for(lambda: ends("transform-band_high_hz")[0] >= 590.0, "twice the lowest frequency")
    assert page.locator(".control[data-bad=true]").count() == 0
    for _ in range(2):
        page.click("#undo")
    wait_for(lambda: ends("transform-band_low_hz")[1] == 1000.0, "the ends as before")


def test_the_sync_test_plays_trials_and_stores_what_agrees(page):
    page.click("#sync")
    page.get_by_role("button", name="The tap").click()
    page.get_by_role("button", name="The click").click()
    says(page, "#sync-value", "40 ms")
    page.locator("#sync-ms").fill("63")
    page.get_by_role("button", name="Together").click()
    wait_for(lambda: not page.is_visible("#sync-dialog"), "the end of the test")
    says(page, "[data-control='offset_ms']", "63 ms as you found it")


def test_the_sync_test_can_be_cancelled_to_no_effect_and_needs_a_vibration_that_is_on(page):
    before = page.inner_text("[data-control='offset_ms']")
    page.click("#sync")
    page.get_by_role("button", name="The tap").click()
    page.keyboard.press("Escape")
    wait_for(lambda: not page.is_visible("#sync-dialog"), "the end of the test")
    page.wait_for_timeout(2_500)  # a status comes every 2 s
    assert page.inner_text("[data-control='offset_ms']") == before
    page.click("#power")
    wait_for(lambda: page.is_disabled("#sync"), "no test while it is switched off")
    page.click("#power")
    wait_for(lambda: page.is_enabled("#sync"), "the test again")


def test_answers_of_a_person_lead_to_the_delay(page):
    found = page.evaluate(text("stepped-answers.js"))
    print(found)
    assert all(abs(delay - offset) <= 4 and answers <= 20 for delay, offset, answers in found)


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_axe_finds_no_violation(room, film, size, theme):
    spec = find_spec("axe_playwright_python")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("axe-playwright-python is not installed")
    axe = Path(spec.submodule_search_locations[0], "axe.min.js").read_text()
    page = opened(room, size, theme)
    says(page, "#applications", "Film")
    found = {}
    for what, does in {
        "first": lambda: None,
        "details": lambda: page.click("summary"),
        "dialog": lambda: page.click("#sync"),
    }.items():
        does()
        page.evaluate(axe)
        violations = page.evaluate("axe.run()")["violations"]
        found[what] = [(one["id"], [node["target"] for node in one["nodes"]]) for one in violations]
    page.click("#sync-cancel")
    page.context.close()
    assert found == {"first": [], "details": [], "dialog": []}
