"""report.html in Chromium, from disk and without a network: it draws, moves, and reacts to mouse and keyboard."""

import io
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

from pipeline.case import load_case
from pipeline.results.case_run import run_case
from pipeline.results.report import write_report
from pipeline.views.movie.encoder import Encoder
from tests.bodies import skip_figures, write_case

pytestmark = [pytest.mark.browser, pytest.mark.slow]
FOCUSED = "document.activeElement.id || document.activeElement.getAttribute('class') || document.activeElement.tagName"
DESKTOP, PHONE = (1280, 900), (390, 844)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The page of two variants of a small beam, with a film."""
    place = tmp_path_factory.mktemp("browser")
    variants = {"linear": {"method.law": "linear"}, "polar": {}}
    case = load_case(write_case(place, variants=variants, schedule={"dt": 0.02, "frames": 8}))
    with pytest.MonkeyPatch.context() as patch:
        skip_figures(patch)
        folder = run_case(case, place / "outputs", movie=False).folder
    with Encoder(folder / "comparison.mp4", (320, 180), 30) as film:
        for level in range(30):
            film.write(np.full((180, 320, 3), 8 * level, dtype=np.uint8).tobytes())
    Image.new("RGB", (320, 180), "red").save(folder / "comparison.png")
    return write_report(folder)


@pytest.fixture(scope="module")
def browser(chromium) -> Iterator:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=chromium)
        yield started
        started.close()


@pytest.fixture(scope="module")
def open_page(browser, report):
    """A function that opens the page and waits for the bodies; errors and requests are in `page.heard`."""
    contexts = []

    def open_one(size=DESKTOP, scheme="light"):
        viewport = {"width": size[0], "height": size[1]}
        contexts.append(browser.new_context(viewport=viewport, color_scheme=scheme, offline=True))
        page = contexts[-1].new_page()
        page.heard = []
        page.on("console", lambda message: message.type == "error" and page.heard.append(message.text))
        page.on("pageerror", lambda error: page.heard.append(str(error)))
        page.on("request", lambda request: is_own(request.url, report) or page.heard.append(request.url))
        page.goto(report.as_uri())
        page.wait_for_selector("#bodies[data-ready]", state="attached")
        return page

    yield open_one
    for context in contexts:
        context.close()


@pytest.fixture(scope="module")
def shared(open_page):
    return open_page()


@pytest.fixture
def page(shared):
    """The page on a desktop, reset to its first time and view; no test may cause an error."""
    shared.emulate_media(media="screen")
    shared.evaluate("report.setTime(report.first); window.scrollTo(0, 0)")
    shared.click("#whole")
    shared.click("#reset")
    yield shared
    assert shared.heard == []


def is_own(address, report) -> bool:
    return address == report.as_uri() or address.startswith(("data:", "blob:"))


def take_pixels(page, selector, index=0) -> np.ndarray:
    """The pixels of an element scrolled to the middle of the window, two frames later."""
    page.locator(selector).nth(index).evaluate("e => e.scrollIntoView({block: 'center', behavior: 'instant'})")
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    picture = Image.open(io.BytesIO(page.locator(selector).nth(index).screenshot()))
    return np.asarray(picture.convert("RGB")).astype(int)


def measure_change(before, after) -> float:
    """The share of pixels that are distinctly different."""
    return float((np.abs(after - before).max(axis=-1) > 30).mean())


def wait_for_change(page, selector, index, before) -> float:
    """The share of pixels of an element that change; waits, as the viewer draws with a delay."""
    for _ in range(40):
        change = measure_change(before, take_pixels(page, selector, index))
        if change > 0.01:
            return change
        page.wait_for_timeout(100)
    return 0.0


def wait_until(page, condition: str) -> None:
    """Wait for a condition; Playwright's own waiting needs eval, which the page forbids."""
    for _ in range(600):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(100)
    pytest.fail(f"never: {condition}")


def test_it_opens_without_errors_and_shows_bodies_and_curves(page):
    assert page.locator("#bodies canvas").count() >= 2
    for index in range(2):
        body = take_pixels(page, ".view", index)
        assert measure_change(np.broadcast_to(body[2, 2], body.shape), body) > 0.02  # not only background
    assert page.locator("#curves svg").count() == 5  # total volume; volume ratios and energies of two variants
    assert page.locator("#curves path.line").count() == 2 + 2 * 1 + 2 * 4


def test_the_slider_moves_the_bodies(page):
    before = [take_pixels(page, ".view", index) for index in range(2)]
    page.locator("#time").fill("8")
    assert page.locator("#now").inner_text() == "t = 0.160 s"
    assert all(wait_for_change(page, ".view", index, before[index]) > 0.01 for index in range(2))


def test_keys_move_the_slider(page):
    before = take_pixels(page, ".view")
    page.locator("#time").focus()
    for _ in range(7):
        page.keyboard.press("ArrowRight")
    assert page.locator("#time").input_value() == "7"
    assert page.locator("#time").get_attribute("aria-valuetext") == "t = 0.140 s"
    assert wait_for_change(page, ".view", 0, before) > 0.01


def test_keys_and_mouse_rotate_all_bodies_alike(page):
    before = [take_pixels(page, ".view", index) for index in range(2)]
    page.locator(".view").first.focus()
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    assert all(wait_for_change(page, ".view", index, before[index]) > 0.01 for index in range(2))
    page.keyboard.press("0")
    for _ in range(40):
        if (left := measure_change(before[1], take_pixels(page, ".view", 1))) < 0.001:
            break
        page.wait_for_timeout(100)
    assert left < 0.001
    box = page.locator(".view").first.bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 220, box["y"] + 130, steps=4)
    page.mouse.up()
    assert all(wait_for_change(page, ".view", index, before[index]) > 0.01 for index in range(2))


def test_bodies_can_be_hidden(page):
    before = take_pixels(page, ".view", 1)
    page.get_by_label("linear", exact=True).uncheck()
    assert page.locator(".body:visible").count() == 1
    assert take_pixels(page, ".view", 1).shape[1] > before.shape[1], "the remaining body takes the room"
    page.get_by_label("linear", exact=True).check()
    assert page.locator(".body:visible").count() == 2


def test_play_runs_to_the_end(page):
    page.click("#play")
    assert page.locator("#play").get_attribute("aria-pressed") == "true"
    wait_until(page, "report.time === report.last")
    page.wait_for_selector("#play[aria-pressed=false]")


def test_curves_are_read_by_mouse_and_keys(page):
    chart = page.locator("#curves svg").first
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    chart.hover(position={"x": box["width"] - 30, "y": 100})
    assert page.locator(".read").first.inner_text().startswith("t = 0.160 s: linear ")
    assert page.locator("#now").inner_text() == "t = 0.000 s"
    chart.click(position={"x": box["width"] - 30, "y": 100})
    assert page.locator("#now").inner_text() == "t = 0.160 s"
    chart.focus()
    page.keyboard.press("ArrowLeft")
    assert page.locator("#now").inner_text() == "t = 0.140 s"
    assert chart.get_attribute("aria-valuetext").startswith("t = 0.140 s: linear ")
    whole = chart.locator("path.line").first.get_attribute("d")
    page.keyboard.press("+")
    assert chart.locator("path.line").first.get_attribute("d") != whole
    page.click("#whole")
    assert chart.locator("path.line").first.get_attribute("d") == whole


def test_lines_are_toggled(page):
    keys = page.locator(".keys").first
    keys.get_by_role("button", name="polar").click()
    assert page.locator("#curves svg").first.locator("path.line").count() == 1
    assert "polar" not in page.locator(".read").first.inner_text()
    keys.get_by_role("button", name="polar").click()
    assert page.locator("#curves svg").first.locator("path.line").count() == 2


def test_the_button_of_a_worst_cell_goes_to_its_time(page):
    row = page.locator("#worst tbody tr").last
    time = float(row.locator("td").nth(2).inner_text())
    row.get_by_role("button").press("Enter")
    assert page.locator("#now").inner_text() == f"t = {time:.3f} s"
    assert page.evaluate("document.activeElement.id") == "time"


def test_the_movie_plays(page):
    movie = page.locator("#movie")
    assert movie.evaluate("movie => movie.poster").startswith("data:image/png")
    movie.evaluate("movie => { movie.muted = true; return movie.play(); }")
    wait_until(page, "document.getElementById('movie').currentTime > 0.2")
    assert movie.evaluate("movie => [movie.videoWidth, movie.videoHeight]") == [320, 180]


def test_every_control_has_a_name_and_takes_the_focus(page):
    names = page.evaluate("""() => [...document.querySelectorAll("button, input, [tabindex]")].map(e => [
        e.getAttribute("aria-label") || e.innerText || (e.labels && e.labels[0] && e.labels[0].innerText) || "",
        e.tabIndex, e.id || e.outerHTML.slice(0, 60)])""")
    assert [place for name, _, place in names if not name.strip()] == []
    page.locator("#play").focus()
    seen = set()
    for _ in range(30):
        page.keyboard.press("Tab")
        seen.add(page.evaluate(FOCUSED))
    assert {"time", "reset", "closer", "wider", "whole"} <= seen and any("view" in name.split() for name in seen)


def test_dark_and_light(page, open_page):
    dark = open_page(scheme="dark")
    grounds = []
    for tab in (page, dark):
        picture, body = take_pixels(tab, "h1"), take_pixels(tab, ".view")
        grounds.append(picture[0, 0].mean())
        ink = np.abs(picture - picture[0, 0]).max()
        assert ink > 180, "texts are readable"
        assert abs(body[2, 2].mean() - grounds[-1]) < 40
        assert measure_change(np.broadcast_to(body[2, 2], body.shape), body) > 0.02
    assert grounds[0] > 240 and grounds[1] < 40
    assert dark.heard == []


def test_on_a_phone_nothing_is_cut_off(open_page):
    page = open_page(PHONE)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
    assert page.locator(".view").first.bounding_box()["width"] > 150
    assert page.locator("#time").bounding_box()["width"] > 100
    assert page.heard == []


def test_printed_pages_have_no_controls(page):
    page.emulate_media(media="print")
    assert page.locator("#clock").is_hidden() and page.locator("#bodies").is_hidden()
    assert page.locator("#poster").is_visible() and page.locator("#curves svg").first.is_visible()
    assert page.locator("#worst").is_visible() and page.locator("#movie").is_hidden()
