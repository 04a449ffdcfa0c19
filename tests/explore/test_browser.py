"""The page in a browser without a window, driven by Playwright: `make test-browser`."""

import contextlib
import dataclasses
import json
import re
import shutil
import statistics
import sys
import threading

import numpy as np
import pytest

from bicycle_env import analysis, load_policy, vehicles
from bicycle_env.control.four_wheel_steer import yaw_rate_feedback_gain, yaw_rate_feedback_matrix
from bicycle_env.explore import Server
from bicycle_env.explore.content import data
from bicycle_env.export import export_policy
from bicycle_env.report.words import stability_in_words

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.exhaustive,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here"),
]
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update")
PAINTED = """async (values) => {
  const slider = document.getElementById("point"), found = [];
  for (const value of values) {
    const begun = performance.now();
    slider.value = value;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    await new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)));
    found.push(performance.now() - begun);
  }
  return found;
}"""
LATE = """addEventListener("hashchange", (event) => {
  event.stopImmediatePropagation();
  document.getElementById("point").dispatchEvent(new Event("input", { bubbles: true }));
  setTimeout(() => {
    dispatchEvent(new HashChangeEvent("hashchange"));
    document.documentElement.dataset.told = "yes";
  }, 300);
}, { capture: true, once: true })"""
SMALL = """() => [...document.querySelectorAll("button, select, input:not([type=checkbox])")]
  .filter((one) => one.offsetWidth && one.offsetHeight < 30).map(({ id }) => id)"""
DROP = """(files) => {
  const dataTransfer = new DataTransfer();
  for (const [name, bytes] of files) dataTransfer.items.add(new File([new Uint8Array(bytes)], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
}"""


@contextlib.contextmanager
def served(files):
    with Server(files, 0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture(scope="module")
def server(files):
    with served(files) as made:
        yield made


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=BROWSER, args=list(FLAGS))
        yield made
        made.close()


@pytest.fixture
def visit(server, browser):
    """``visit(hash, ...)``: a page that is ready; in the end none of them has said an error or asked another host."""
    contexts, said, asked, own = [], [], set(), {"data:"}

    def visit(hash="", width=1440, height=900, url=server.url, before="", **words):
        context = browser.new_context(viewport={"width": width, "height": height}, **words)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(60_000)
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.add(re.match(r"\w+:(//[^/]*/)?", request.url)[0]))
        page.add_init_script(before)
        page.goto(f"{url}#{hash}")
        page.wait_for_selector("html[data-ready]")
        own.add(url)
        return page

    yield visit
    for context in contexts:
        context.close()
    assert said == []
    assert asked <= own


def slide(page, name, value):
    page.locator(f"#{name}").evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input', { bubbles: true })); }",
        value,
    )


def settled_hash(page):
    """The address, which follows when nothing has changed for a moment; without "#"."""
    page.wait_for_selector("html[data-settled]")
    return page.evaluate("location.hash").removeprefix("#")


def ink(page, id):
    """A picture of a canvas once it is drawn; what is not on the screen is drawn later."""
    page.wait_for_selector("html[data-settled]")
    return page.evaluate("(id) => document.getElementById(id).toDataURL()", id)


def arrived(page):
    page.wait_for_selector("#spinner", state="hidden")


def test_the_sentence_is_analysis_and_follows_the_sliders(visit, capsys):
    page, car = visit("vehicle=oversteer"), vehicles["oversteer"]
    for k in (0, 14, 20, 30):
        slide(page, "point", k)
        ratio = round(0.05 * (k + 6), 2)
        assert page.inner_text("#sentence") == stability_in_words(car, ratio * car.critical_speed)
    slide(page, "rear_cornering_stiffness", 130)
    changed = dataclasses.replace(car, rear_cornering_stiffness=117000.0)
    assert page.inner_text("#sentence") == stability_in_words(changed, 60.0)
    assert "rear_cornering_stiffness=117000.0" in page.inner_text("#python")
    took = page.evaluate(PAINTED, [20, 40, 60, 80, 100, 30, 50, 70, 90, 110, 25, 45, 65, 85, 105])
    with capsys.disabled():
        sys.stdout.write(f" (slider to painted: {statistics.median(took):.0f} ms in the median) ")
    page.locator("#change summary").click()
    page.click("#as_preset")
    assert "rear_cornering" not in settled_hash(page)


def test_a_click_or_a_key_is_a_start_and_a_bad_number_a_sentence(visit):
    page = visit("sideslip=3")
    below = ink(page, "step_yaw_rate")  # not on the screen: drawn later, but drawn
    slide(page, "point", 5)
    assert ink(page, "step_yaw_rate") != below
    canvas = page.locator("#phase")
    size, before = canvas.bounding_box(), ink(page, "phase")
    canvas.click(position={"x": 0.7 * size["width"], "y": 0.3 * size["height"]})
    sideslip, yaw_rate = (float(page.input_value(f"#{name}")) for name in ("sideslip", "yaw_rate"))
    assert 8.0 < sideslip < 20.0
    assert 15.0 < yaw_rate < 40.0
    assert ink(page, "phase") != before
    canvas.press("ArrowLeft")
    canvas.press("ArrowUp")
    assert float(page.input_value("#sideslip")) == pytest.approx(sideslip - 1.0)
    assert float(page.input_value("#yaw_rate")) == pytest.approx(yaw_rate + 2.0)
    page.fill("#sideslip", "99")
    assert page.inner_text("#complaint") == "The start's sideslip [deg] must be a number in -25 to 25."


def test_steady_turns_the_set_and_gains_come_from_the_server(visit):
    page = visit("vehicle=oversteer&recoverable=off&left=nobody&right=lqr&speed_ratio=0.8")
    arrived(page)
    alone = ink(page, "phase")
    page.check("#recoverable")
    arrived(page)
    assert page.inner_text("#asked") == ""
    assert ink(page, "phase") != alone
    slide(page, "mass", 120)
    page.locator("#ending_right", has_text="LQR, a classical law: runs straight").wait_for()
    arrived(page)
    page.select_option("#steer", "front")
    page.locator("#ending_right", has_text=re.compile("after|from")).wait_for()
    arrived(page)
    slide(page, "friction", 0.4)
    slide(page, "friction", 0.6)  # before the answer to the former is there
    arrived(page)
    assert page.inner_text("#asked") == ""


def test_rear_wheels_that_steer_save_what_a_driver_has_spun(visit):
    """All by keyboard; for a changed car the server designs the law."""
    page = visit("vehicle=oversteer&left=nobody&right=nobody&sideslip=4&recoverable=off")
    for name, word, value in (
        ("left", "a driver who turns", "step"),
        ("right", "a driver who turns", "step"),
        ("right_rear", "yaw", "yaw-rate"),
    ):
        page.focus(f"#{name}")
        page.keyboard.type(word)
        assert page.input_value(f"#{name}") == value
    page.focus("#straight")
    page.keyboard.press("Enter")
    page.locator("#ending_left", has_text="spun after").wait_for()
    page.locator("#ending_right", has_text="has not spun in 8.00 s").wait_for()
    gain = yaw_rate_feedback_gain(vehicles["oversteer"], 1.2 * vehicles["oversteer"].critical_speed)
    matrix = yaw_rate_feedback_matrix(vehicles["oversteer"], 1.2 * vehicles["oversteer"].critical_speed, gain)
    values = ", ".join(f"\N{MINUS SIGN}{-value:.2f}" for value in sorted(np.linalg.eigvals(matrix)))
    page.locator("#fed_back", has_text=f"Circles: car B with rear wheels after the yaw rate ({values} per").wait_for()
    slide(page, "mass", 120)
    page.locator("#ending_right", has_text="has not spun in 8.00 s").wait_for()
    slide(page, "rear_angle_limit", 0.5)
    page.locator("#ending_right", has_text="spun after").wait_for()
    page.select_option("#left", "preview")
    page.locator("#ending_left", has_text="looks ahead; rear wheels straight").wait_for()
    slide(page, "relaxation_length", 0.4)
    page.locator("#at_once").wait_for()
    assert "relaxation_length=0.4" in page.inner_text("#python")
    page.select_option("#steer", "rear")
    assert "a driver has the front axle" in page.inner_text("#ending_left")
    assert page.locator("#left_rear").is_hidden()


def test_each_example_is_understood_and_shows_what_it_says(visit):
    page = visit("vehicle=civic&speed=20&tire=linear")
    endings = [
        ("spun", "runs straight"),
        ("spun", "has not spun"),
        ("left its lane", "runs straight"),
        ("press Play", "runs straight"),
    ]
    links = page.locator("nav a")
    assert links.count() == len(endings)
    for k, words in enumerate(endings):
        links.nth(k).click()
        for side, word in zip(("left", "right"), words, strict=True):
            page.locator(f"#ending_{side}", has_text=word).wait_for()
        assert page.locator("#complaint").is_hidden()


def test_it_plays_by_keyboard_alone_and_is_steered_by_hand(visit):
    page = visit("vehicle=oversteer&left=nobody&right=lqr&sideslip=1&speed_ratio=0.5")
    page.focus("#left")
    page.keyboard.type("you")
    assert page.input_value("#left") == "you"
    road = ink(page, "road")
    page.focus("#play")
    page.keyboard.press("Enter")
    page.keyboard.down("ArrowLeft")
    page.locator("#time_words", has_text=re.compile(r"^(0\.[5-9]|[1-9])")).wait_for()
    assert page.inner_text("#play") == "Pause"
    page.keyboard.up("ArrowLeft")
    page.locator("#ending_left", has_text=re.compile("left its lane after|spun after")).wait_for()
    assert ink(page, "road") != road
    python = page.inner_text("#python")
    wheel = [float(text) for text in re.search(r"Steered\(\[(.*?)\]", python)[1].split(",")]
    assert len(wheel) > 10
    assert max(wheel) > 0.3
    assert min(wheel) >= 0.0
    if page.inner_text("#play") == "Pause":
        page.click("#play")
    time = float(page.input_value("#time"))
    page.focus("#time")
    page.keyboard.press("ArrowLeft")
    assert float(page.input_value("#time")) < time


def of(folder, *names):
    return [[name, list((folder / name).read_bytes())] for name in names]


def test_policies_that_are_dragged_in(visit, tmp_path):
    network = load_policy("BicycleStab-v0")
    network.save(tmp_path)
    export_policy(network, "js", tmp_path)
    page = visit("vehicle=oversteer&left=policy&right=nobody")
    page.evaluate(DROP, of(tmp_path, "policy.json", "policy.safetensors"))
    page.locator("#ending_right", has_text="your policy (policy.json)").wait_for()
    ending = [page.inner_text(f"#ending_{side}").partition(": ")[2] for side in ("left", "right")]
    assert ending[0] == ending[1]
    assert 'control.load("policy")' in page.inner_text("#python")
    page.evaluate(DROP, of(tmp_path, "policy.json"))
    page.locator("#complaint", has_text="policy.json is half of a policy").wait_for()
    (tmp_path / "policy.safetensors").write_bytes(b"<b>broken</b>")
    page.set_input_files("#files", [tmp_path / "policy.json", tmp_path / "policy.safetensors"])
    page.locator("#complaint", has_text="policy.safetensors does not belong to this policy.json").wait_for()
    assert page.inner_text("#ending_right").endswith(ending[0])  # what was good still drives
    page.set_input_files("#files", [tmp_path / "bicycle_policy.mjs"])
    page.locator("#ending_right", has_text="your policy (bicycle_policy.mjs)").wait_for()
    assert page.inner_text("#ending_right").endswith(ending[0])
    assert page.locator("#complaint").is_hidden()
    load_policy("BicycleEvade-v0").save(tmp_path)
    page.set_input_files("#files", [tmp_path / "policy.json", tmp_path / "policy.safetensors"])
    page.locator("#ending_right", has_text="(policy.json): this policy was trained for BicycleEvade-v0").wait_for()
    export_policy(load_policy("BicycleEvade-v0"), "js", tmp_path / "evade")
    page.set_input_files("#files", [tmp_path / "evade" / "bicycle_policy.mjs"])
    page.locator(
        "#ending_right", has_text="(bicycle_policy.mjs): this policy was trained for BicycleEvade-v0"
    ).wait_for()
    export_policy(network, "js", tmp_path / "evade")
    with page.expect_file_chooser() as chooser:
        page.click("#files")
    chooser.value.set_files([tmp_path / "evade" / "bicycle_policy.mjs"])  # the same place, another content
    page.locator("#ending_right", has_text="runs straight").wait_for()
    page.select_option("#steer", "front")
    assert "steers both axles" in page.inner_text("#ending_right")


def test_nothing_is_settled_while_laws_are_on_their_way(visit):
    page, held = visit("vehicle=civic&speed=40&left=nobody&right=nobody"), []
    before = settled_hash(page)
    page.route("**/*.mjs", lambda route: held.append(route))
    with page.expect_request("**/*.mjs"):
        slide(page, "relaxation_length", 0.6)
    assert page.locator("html[data-settled]").count() == 0
    assert page.evaluate("location.hash").removeprefix("#") == before
    page.unroute("**/*.mjs")  # lets go what is held
    assert held
    assert "relaxation_length=0.6" in settled_hash(page)


def test_the_address_bar_holds_what_is_chosen(visit):
    page = visit("vehicle=civic&speed=40&left=nobody&right=nobody&sideslip=2")
    assert page.inner_text("#here") == "40.0 m/s = 144 km/h."
    assert page.inner_text("#sentence") == stability_in_words(vehicles["civic"], 40.0)
    page.select_option("#left", "policy")
    slide(page, "gust", -1500)
    slide(page, "mass", 110)
    page.select_option("#steer", "both")
    page.select_option("#right", "step")
    page.select_option("#right_rear", "yaw-rate")
    page.select_option("#area", "field")
    slide(page, "angle", -1.5)
    slide(page, "rear_rate_limit", 30)
    slide(page, "relaxation_length", 0.6)
    hash = settled_hash(page)
    again = visit(hash)
    assert settled_hash(again) == hash
    assert again.inner_text("#python") == page.inner_text("#python")
    assert again.locator("#complaint").is_hidden()
    again.evaluate("() => { location.hash = '#vehicle=oversteer&left=lqr&speed_ratio=1.5&right=nobody'; }")
    again.locator("#here", has_text="1.5 x").wait_for()
    doubling = analysis.modes("oversteer", 1.5 * analysis.critical_speed("oversteer")).time_to_double
    assert f"doubles every {doubling:.2f} s" in again.inner_text("#sentence")


def test_without_an_address_the_first_example_is_shown(visit):
    first, link = visit(), visit("vehicle=civic&speed=20")
    link.locator("nav a").first.click()
    link.locator("#ending_left", has_text="spun").wait_for()
    assert settled_hash(first) == settled_hash(link)
    assert "area=field" in settled_hash(first)


def test_a_link_followed_while_the_address_is_being_written_is_followed(visit):
    """A browser tells of the new address some time after it: here once the page has settled in between."""
    page = visit("vehicle=civic&speed=20", before=LATE)
    page.locator("nav a").nth(2).click()
    page.wait_for_selector("html[data-told]")
    assert page.input_value("#sideslip") == "16"


def test_what_is_said_of_the_phase_and_the_eigenvalues_follows_the_speed(visit):
    page, car = visit("vehicle=oversteer&speed_ratio=1.2"), vehicles["oversteer"]
    assert "to hold a left turn it needs its front wheels to the right" in page.inner_text("#phase_words")
    values = ", ".join(f"{value.real:.2f}" for value in np.sort(analysis.eigenvalues(car, 1.2 * car.critical_speed)))
    assert f"At this speed: {values} per second." in page.inner_text("#fed_back").replace("\N{MINUS SIGN}", "-")
    slide(page, "point", 10)
    page.locator("#phase_words", has_text="to the other side than the wheels point").wait_for()
    assert "turns the nose to the right" in page.inner_text("#wrong_why")


def test_the_wheels_limit_is_drawn_where_it_is_within_the_chart(visit):
    """Nobody steers: the charts differ in this line alone."""
    words = "left=nobody&right=nobody&front_angle_limit="
    within, beyond, far = (ink(visit(f"{words}{limit}"), "history_front_steer") for limit in (0.5, 5, 7))
    assert within != beyond == far


def test_nothing_jumps_while_the_server_is_asked(visit):
    page, places = visit("recoverable=on"), set()
    for width in (1440, 390):
        page.set_viewport_size({"width": width, "height": 900})
        slide(page, "friction", 0.4 + width / 5000)
        places.clear()
        for words in ("", "looking for steady turns", "computing from where some steering saves the car"):
            page.locator("#asked", has_text=re.compile(f"^{words}")).wait_for(state="attached")
            places.add(page.evaluate("document.getElementById('phase').offsetTop"))
        arrived(page)
        places.add(page.evaluate("document.getElementById('phase').offsetTop"))
        assert len(places) == 1


def test_on_a_telephone_nothing_of_use_is_hidden_by_the_summary(visit):
    page = visit("vehicle=oversteer&left=nobody", width=390, height=844)
    assert page.locator("#meaning").is_visible()
    below = """() => document.activeElement.getBoundingClientRect().top
        - document.getElementById("summary").getBoundingClientRect().bottom"""
    page.focus("#copy")
    seen = []
    while "vehicle" not in seen:
        page.keyboard.press("Shift+Tab")
        assert page.evaluate(below) >= 0.0
        seen.append(page.evaluate("document.activeElement.id"))
    assert len(seen) > 15
    page.locator("nav a").last.click()
    page.locator("#ending_left", has_text="press Play").wait_for()
    page.wait_for_function("document.getElementById('play').getBoundingClientRect().bottom <= innerHeight")
    assert page.evaluate("document.getElementById('time').offsetWidth") > 150


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_a_telephone(visit, scheme):
    hash = (
        "left=you&mass=110&right=step&right_rear=zero-sideslip&rear_angle_limit=4"
        if scheme == "light"
        else "right=file"
    )
    page = visit(hash, width=390, height=844, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate(SMALL) == []


def test_without_a_server_what_it_would_say_is_a_sentence(files, visit):
    content = f"export const data = {json.dumps(data(('oversteer',), served=False))};\n"
    with served({**files, "data.mjs": content.encode()}) as static:
        page = visit("vehicle=oversteer&steer=both", url=static.url)
        assert page.inner_text("#asked") == ""
        with_set = ink(page, "phase")
        page.uncheck("#recoverable")
        assert ink(page, "phase") != with_set
        page.check("#recoverable")
        slide(page, "friction", 0.5)
        assert "start “bicycle-env explore” on your machine" in page.inner_text("#asked")
        assert page.is_disabled("#recoverable")
        slide(page, "rear_rate_limit", 40)
        assert "LQR, a classical law: runs straight" in page.inner_text("#ending_right")
        slide(page, "rear_angle_limit", 4)
        assert "LQR for a changed car or steering is designed by Python" in page.inner_text("#ending_right")
        page.evaluate("document.getElementById('usual_actuators').click()")
        assert "designed by Python" not in page.inner_text("#ending_right")
        slide(page, "mass", 110)
        assert "LQR for a changed car or steering is designed by Python" in page.inner_text("#ending_right")
        page.select_option("#right", "step")
        page.select_option("#right_rear", "yaw-rate")
        assert "the law “yaw-rate” for a changed car or steering is designed by Python" in page.inner_text(
            "#ending_right"
        )
        page.select_option("#right_rear", "sano")
        assert "after" in page.inner_text("#ending_right")
