"""The page in a browser without a window: loads, is steered by hand, plays, says no error, asks no other host."""

import json
import re
import shutil
import subprocess
import threading

import pytest

from bicycle_env import analysis
from bicycle_env.explore import Server

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.exhaustive,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here"),
]

DRIVE = """
const at = (id) => document.getElementById(id), said = {}, errors = [];
addEventListener("error", (event) => errors.push(event.message));
addEventListener("unhandledrejection", (event) => errors.push(String(event.reason)));
const wait = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));
const change = (id, value, kind) => {
  at(id).value = value;
  at(id).dispatchEvent(new Event(kind, { bubbles: true }));
};
const ink = (id) => {
  const { width, height } = at(id);
  return at(id).getContext("2d").getImageData(0, 0, width, height).data.reduce((sum, value) => sum + value, 0);
};
const drive = async () => {
  while (document.documentElement.dataset.ready !== "yes") await wait(20);
  said.first = at("sentence").textContent;
  change("point", 24, "input");
  said.fast = at("sentence").textContent;
  change("left", "policy", "change");
  const { x, y, width, height } = at("phase").getBoundingClientRect(), before = ink("phase");
  at("phase").dispatchEvent(new MouseEvent("click", { clientX: x + 0.7 * width, clientY: y + 0.3 * height }));
  said.clicked = [at("sideslip").value, at("yaw_rate").value].map(Number);
  said.moved = ink("phase") !== before;
  at("phase").dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
  said.keyed = Number(at("sideslip").value);
  change("sideslip", "99", "input");
  said.complaint = at("complaint").hidden ? "" : at("complaint").textContent;
  at("sideslip").dispatchEvent(new Event("blur"));
  const road = ink("road");
  at("play").click();
  await wait(1500);
  said.played = [Number(at("time").value), ink("road") !== road, at("play").textContent];
  at("play").click();
  said.hash = location.hash;
  location.hash = "#vehicle=civic&speed=40&left=nobody&right=nobody&sideslip=2";
  await wait(300);
  said.other = [at("sentence").textContent, at("vehicle").value, at("here").textContent];
  said.endings = [at("ending_left").textContent, at("ending_right").textContent];
  said.wide = document.documentElement.scrollWidth;
  said.hosts = [...new Set(performance.getEntriesByType("resource").map(({ name }) => new URL(name).origin))];
};
drive().catch((error) => errors.push(String(error))).finally(() => {
  document.body.dataset.said = JSON.stringify({ ...said, errors });
});
"""


@pytest.fixture(scope="module")
def found(files, tmp_path_factory):
    page = files["index.html"].replace(b"</head>", b'<script type="module" src="drive.mjs"></script></head>')
    with Server({**files, "driven.html": page, "drive.mjs": DRIVE.encode()}, 0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        folder = tmp_path_factory.mktemp("browser")
        flags = ("--headless", "--no-sandbox", "--disable-gpu", "--window-size=500,900", "--enable-logging=stderr")
        flags = (*flags, "--virtual-time-budget=20000")
        done = subprocess.run(
            [BROWSER, *flags, f"--user-data-dir={folder}", "--dump-dom", f"{server.url}driven.html#sideslip=3"],
            capture_output=True,
            text=True,
            check=False,
        )
        server.shutdown()
        thread.join()
    said = re.search(r'data-said="([^"]*)"', done.stdout)
    assert said, done.stderr[-2000:]
    consoled = [line for line in done.stderr.splitlines() if "CONSOLE" in line and "/drive.mjs" not in line]
    return {**json.loads(said[1].replace("&quot;", '"')), "console": consoled, "origin": server.url.rstrip("/")}


def test_no_error_and_no_other_host(found):
    assert (found["errors"], found["console"]) == ([], [])
    assert found["hosts"] == [found["origin"]]


def test_the_sentence_is_analysis_and_follows_the_slider(found):
    for words, ratio in (("first", 1.2), ("fast", 1.5)):
        doubling = analysis.modes("oversteer", ratio * analysis.critical_speed("oversteer")).time_to_double
        assert f"doubles in {doubling:.2f} s" in found[words]


def test_a_click_or_a_key_is_a_start_and_a_bad_number_a_sentence(found):
    sideslip, yaw_rate = found["clicked"]
    assert 8.0 < sideslip < 20.0
    assert 15.0 < yaw_rate < 40.0
    assert found["moved"]
    assert found["keyed"] == pytest.approx(sideslip - 1.0)
    assert found["complaint"] == "The start's sideslip [deg] must be a number in -25 to 25."


def test_it_plays(found):
    time, moved, word = found["played"]
    assert 0.1 < time <= 8.0  # the browser's time is not the clock's
    assert moved
    assert word == ("Pause" if time < 8.0 else "Play")


def test_the_address_bar_holds_what_is_chosen(found):
    assert "left=policy" in found["hash"]
    assert "speed_ratio=1.5" in found["hash"]
    sentence, vehicle, here = found["other"]
    assert (vehicle, here) == ("civic", "144 km/h.")
    assert "stable at every speed" in sentence
    assert all("nobody" in ending for ending in found["endings"])


def test_nothing_is_wider_than_the_window(found):
    assert found["wide"] <= 500
