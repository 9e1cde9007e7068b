"""The workbench from end to end, in a headless Chromium. `make test-app` runs it; `make test` does not, by its name."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pandas as pd
import pytest
import tifffile
from processes import until
from tracker_film import CAMERA, collision, film

from synthcam import Scene
from tracker.app.server import write_opening_page
from tracker.pipeline import measure_tables

api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make test-app installs it")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt-get install chromium")

PAGE_GRACE_S = 5.0  # after which the command ends if no page is open
PATHS = collision(60)  # equal balls; 0.8 and 0.2 of the speed along the line of centres after the hit: r is 0.6


@pytest.fixture(scope="session")
def films(tmp_path_factory):
    folder = tmp_path_factory.mktemp("films")
    tifffile.imwrite(folder / "<i>hit & run.tif", film(np.random.default_rng(0), PATHS), imagej=True)
    tifffile.imwrite(folder / "long.tif", np.tile(film(np.random.default_rng(1), PATHS[:8]), (600, 1, 1)), imagej=True)
    return folder


@pytest.fixture(scope="session")
def browser():
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def workbench(film, output):
    """The command, and the address that it prints; it has to end by itself."""
    words = [sys.executable, "-m", "tracker", "open", str(film), "--no-browser", "-o", str(output)]
    command = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield command, command.stdout.readline().strip()
    finally:
        if command.poll() is None:
            command.send_signal(signal.SIGINT)
        command.communicate(timeout=20)


@pytest.fixture(scope="module")
def kept(films, browser, tmp_path_factory):
    """The address of one workbench for several tests, and a page that keeps it going."""
    with workbench(films / "<i>hit & run.tif", tmp_path_factory.mktemp("bench")) as (_, address):
        page = browser.new_page()
        page.goto(address)
        yield address, page
        page.close()


@pytest.fixture
def address(kept):
    """The same, without settings afterwards."""
    address, page = kept
    yield address
    page.evaluate("import('/static/api.js').then((api) => api.post('/api/settings', {}))")


@contextmanager
def opened(browser, address, **kwargs):
    """A page whose scripts raise no error."""
    context, errors = browser.new_context(viewport={"width": 1280, "height": 900}, **kwargs), []
    page = context.new_page()
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.wait_for_selector("#stage[data-frame='0'][data-balls]")
    yield page
    context.close()
    assert errors == []


def at(page, x, y):
    """Where a position of the film is on the screen while the whole film is shown."""
    box = page.locator("#stage").bounding_box()
    zoom = min(box["width"] / 200, box["height"] / 160)
    return box["x"] + box["width"] / 2 + (x - 99.5) * zoom, box["y"] + box["height"] / 2 + (y - 79.5) * zoom


def shown(page, frame):
    page.wait_for_selector(f"#stage[data-frame='{frame}'][data-balls]")
    return int(page.get_attribute("#stage", "data-balls"))


def keep_picture(page, name, full_page=True):
    """A picture of the page in the folder SCREENSHOTS, if there is one."""
    if folder := os.environ.get("SCREENSHOTS"):
        page.screenshot(path=f"{folder}/workbench_{name}.png", full_page=full_page)


def says(page, selector, text):
    page.locator(selector, has_text=re.compile(text)).wait_for(state="attached", timeout=60_000)


def test_from_a_film_to_a_number(films, browser, tmp_path):
    with workbench(films / "<i>hit & run.tif", tmp_path / "bench") as (command, address):
        with opened(browser, address) as page:
            # look
            assert page.text_content("#film-name").startswith(str(films / "<i>hit & run.tif"))
            page.keyboard.press("ArrowRight")
            page.keyboard.press("Shift+ArrowRight")
            assert shown(page, 11) == 1
            page.keyboard.press("End")
            shown(page, 59)
            page.keyboard.press("Home")
            assert shown(page, 0) == 1
            page.mouse.move(*at(page, *PATHS[0, 0]))
            page.click("#auto")
            assert until(lambda: int(page.input_value("#high")) < 90)
            says(page, "#ball", "Glint at")
            x, y = re.search(r"([\d.]+), ([\d.]+) px", page.text_content("#ball")).groups()
            assert np.hypot(float(x) - PATHS[0, 0, 0], float(y) - PATHS[0, 0, 1]) < 0.1
            # point
            page.keyboard.press("2")
            page.mouse.click(*at(page, 20, 30))
            page.mouse.click(*at(page, 120, 30))
            page.keyboard.type("16")
            says(page, "#scale", r"0\.16(0\d*)? ± 0\.0023 mm/px")
            says(page, "#settings-error", "set the frames a second, too")
            page.fill("#fps", "250")
            page.fill("#diameter", "2.38")
            says(page, "#camera", '"ball_diameter": 0.00238')
            page.check("input[value=region]")
            page.mouse.move(*at(page, 2, 3))
            page.mouse.down()
            page.mouse.move(*at(page, 90, 90))
            page.mouse.move(*at(page, 197, 156))
            page.mouse.up()
            says(page, "#command", "--region 2,3,197,156")
            # run
            page.click("#run")
            page.wait_for_selector("#results table", timeout=60_000)
            value, error = re.search(r"r(0\.\d+)\((\d+)\)", page.text_content("#results table")).groups()
            assert abs(float(value) - 0.6) < 4 * int(error) * 10.0 ** -len(value.partition(".")[2])
            says(page.frame_locator("#report"), "h1", "hit & run")
            says(page, "#command", "results_2")
            # mend
            page.wait_for_selector("#mend-box")
            page.keyboard.press("Home")
            page.check("input[value=mend]")
            x, y = PATHS[0, 1]
            page.mouse.click(*at(page, x, y))
            says(page, "#mend-point", "frame 0: ")
            page.click("#remove-point")
            says(page, "#mend-state", "1 correction since the run")
            says(page, "#edits li", r"point of ball \d in frame 0 removed")
            says(page, "#command", r"--edits \S+edits_2.yaml")
            page.click("#run")
            says(page, "#results", "results_2")
            says(page, "#log", "edited by hand: 1 position removed")
            page.wait_for_selector("#mend-state:empty", state="attached")
            # load again
            page.reload()
            page.wait_for_selector("#results table")
            assert page.input_value("#region") == "2,3,197,156"
            says(page, "#scale", r"0\.16")
            says(page, "#mend-point", "not in this frame|frame 0")
            page.click("#undo")
            page.wait_for_selector("#edits:empty", state="attached")
            page.wait_for_selector("#redo:enabled")
            assert "--edits" not in page.text_content("#command")
        assert command.wait(20) == 0  # the page is closed
    assert (tmp_path / "bench/camera_1.json").is_file()
    assert (tmp_path / "bench/results_1/estimates.parquet").is_file()
    assert (tmp_path / "bench/edits.yaml").read_text() == "edits: []\n"
    assert "remove_point" in (tmp_path / "bench/edits_2.yaml").read_text()

    with workbench(tmp_path / "bench/results_2", tmp_path / "again") as (_, address), opened(browser, address) as page:
        says(page, "#film-name", "hit & run")  # found by the command beside the results
        page.wait_for_selector("#results table")
        says(page, "#edits", "point of ball")


def test_results_without_their_film_are_mended_and_measured_again(browser, tmp_path):
    clip = Scene.read("painter_behringer").draw(seed=1)
    noise = np.random.default_rng(0).normal(0, 0.05, (2, len(clip.tracks)))
    table = clip.tracks[["frame", "particle"]].assign(x_std=0.05, y_std=0.05)
    table = table.assign(x=clip.tracks.x_mean_px + noise[0], y=clip.tracks.y_mean_px + noise[1])
    table.to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(clip.camera_json))
    measure_tables(tmp_path / "tracks.csv", tmp_path / "out", tmp_path / "camera.json")
    with workbench(tmp_path / "out", tmp_path / "bench") as (_, address), browser.new_page() as page:
        page.goto(address)
        says(page, "#detector", "The film of these results is not here")
        page.wait_for_selector("#residuals[data-points]")
        assert int(page.get_attribute("#residuals", "data-points")) > len(table)  # two for each position
        box = page.locator("#residuals").bounding_box()
        page.locator("#residuals").click(position={"x": box["width"] / 2, "y": box["height"] / 2})
        page.wait_for_selector(f"#stage[data-frame='{clip.frames // 2}']")
        page.check("input[value=mend]")
        page.keyboard.press("ArrowRight")  # goes through the film, not through the tools
        page.wait_for_selector(f"#stage[data-frame='{clip.frames // 2 + 1}']")
        page.keyboard.press("Delete")
        says(page, "#edits li", f"in frame {clip.frames // 2 + 1} removed")
        says(page, "#command", "tracker measure")
        page.click("#run")
        says(page, "#results", "results_1")
        page.wait_for_selector("#mend-state:empty", state="attached")
        page.keyboard.press("u")
        page.wait_for_selector("#edits:empty", state="attached")
        # a new ball, by one click a frame
        page.select_option("#mend-ball", label="2 (new)")
        page.keyboard.press("Home")
        for frame in range(3):
            page.wait_for_selector(f"#stage[data-frame='{frame}']")
            page.locator("#stage").click(position={"x": 40 + 5 * frame, "y": 30}, modifiers=["Shift"])
            says(page, "#edits li", rf"point of ball 2 in frame {frame} added at")
        page.wait_for_selector("#stage[data-frame='3']")
        page.keyboard.press("Home")
        page.wait_for_selector("#stage[data-frame='0']")
        page.locator("#stage").click(position={"x": 60, "y": 30}, modifiers=["Shift"])
        says(page, "#mend-message", "ball 2 has a position in frame 0")
        assert page.input_value("#frame") == "0"  # a refused point is no reason to go on


def measured(folder, clips=6):
    """Results of collisions on a plate that is tilted by 1 mrad: as many as a search needs."""
    scene, noise, tables = (
        Scene.read("painter_behringer", effects={"plate_tilt": {"x": 1e-3}}),
        np.random.default_rng(0),
        [],
    )
    for number in range(clips):
        clip = scene.draw(number, seed=1)
        off = noise.normal(0, 0.05, (2, len(clip.tracks)))
        table = clip.tracks[["frame", "particle"]].assign(clip=number, x_std=0.05, y_std=0.05)
        tables.append(table.assign(x=clip.tracks.x_mean_px + off[0], y=clip.tracks.y_mean_px + off[1]))
    pd.concat(tables).to_csv(folder / "tracks.csv", index=False)
    (folder / "camera.json").write_text(json.dumps(clip.camera_json))
    measure_tables(folder / "tracks.csv", folder / "out", folder / "camera.json")
    return folder / "out"


def test_a_search_is_drawn_over_the_film(browser, tmp_path):
    with workbench(measured(tmp_path), tmp_path / "bench") as (_, address), browser.new_page() as page:
        page.goto(address)
        says(page, "#arrows-legend", "No fit|tied fit")
        assert page.is_hidden("#residuals-of")
        page.click("#search")
        says(page, "#compare-state", "Search")
        assert page.text_content("#run-state") == ""
        page.wait_for_selector("#residuals-of:not([hidden])", timeout=180_000)
        page.wait_for_function("document.getElementById('report-box').getBoundingClientRect().top < innerHeight / 2")
        assert page.input_value("#residuals-of") == "both models"
        says(page, "#arrows-legend", r"base model: rms \d.*with plate_tilt: rms \d.*The longest arrow is \d+ µm")
        sizes = [float(text) for text in re.findall(r"rms ([\d.]+)", page.text_content("#arrows-legend"))]
        pixel_um = json.loads((tmp_path / "camera.json").read_text())["scale"] * 1e6
        assert sizes[0] > 2 * sizes[1]
        assert abs(sizes[1] / (0.05 * pixel_um) - 1) < 0.25  # the noise that was put in
        keep_picture(page, "search", full_page=False)
        page.select_option("#residuals-of", "with plate_tilt")
        says(page, "#residuals-note", r"Residuals \(with plate_tilt\) up to")
        page.focus("#show-arrows")
        page.keyboard.press("Space")  # a click just after scrolling may reach the report, which was there before
        page.wait_for_selector("#arrows-legend[hidden]", state="attached")
        page.reload()
        page.wait_for_selector("#residuals-of:not([hidden])")
        page.select_option("#clip", index=3)
        says(page, "#arrows-legend", "base model: rms")
        assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]


def test_everything_by_keyboard(address, browser):
    with opened(browser, address) as page:
        page.focus("#stage")
        page.keyboard.press("n")
        says(page, "#ball", "Glint at")
        page.keyboard.press("4")
        page.keyboard.press("Enter")
        says(page, "#command", r"--ball (99|100|101)\.\d,(79|80|81)\.\d@0")
        page.click("#balls button")
        page.keyboard.press("5")
        page.focus("#stage")
        for _ in range(2):
            page.keyboard.press("Enter")
            page.keyboard.press("Alt+Shift+ArrowRight")
            page.keyboard.press("Alt+Shift+ArrowDown")
        says(page, "#command", r"--region 100,80,110,90")
        assert "--ball" not in page.text_content("#command")
        page.check("#region-out")
        page.keyboard.press("6")
        page.focus("#stage")
        for move in ("ArrowRight", "ArrowDown", "ArrowLeft"):
            page.keyboard.press("Enter")
            page.keyboard.press(f"Alt+Shift+{move}")
        page.keyboard.press("c")
        says(page, "#command", r"--region '100,80,110,90; not 120,100 130,100 130,110'")
        says(page, "#settings-error", "^$")
        page.click("#no-region")
        page.uncheck("#region-out")
        page.keyboard.press("8")
        page.focus("#stage")
        page.keyboard.press("Enter")
        for move in ("ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp", "ArrowUp", "ArrowUp", "ArrowUp"):
            page.keyboard.press(f"Alt+Shift+{move}")
        page.keyboard.press("Enter")
        says(page, "#hint", r"^50\.0 px, 53\.1° from the right")  # 30 px to the right, 40 px up
        says(page, "#settings-error", "^$")
        page.focus("#stage")
        before = page.evaluate("document.activeElement.id")
        page.keyboard.press("+")
        assert before == "stage"
        page.focus("#fps")
        page.keyboard.type("25 0")  # keys in a field are text
        assert page.get_attribute("#stage", "data-frame") == "0"


@pytest.mark.parametrize(
    ("name", "size", "said"),
    [
        ("notes.txt", 100, "expected a TIFF stack"),
        ("cut.tif", 3000, "truncated or damaged"),
        ("gone.tif", 0, "no such"),
    ],
)
def test_a_wrong_film_ends_in_one_line_before_a_page_opens(films, tmp_path, name, size, said):
    if size:
        with (films / "long.tif").open("rb") as film_file:
            (tmp_path / name).write_bytes(film_file.read(size))
    words = [sys.executable, "-m", "tracker", "open", name, "--no-browser", "-o", "bench"]
    found = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert (found.returncode, found.stdout) == (2, "")
    assert re.fullmatch(rf"tracker: {name}: .*{said}.*\n", found.stderr)
    assert not (tmp_path / "bench").exists()


def test_hints_that_are_wrong_are_said(address, browser):
    with opened(browser, address) as page:
        page.fill("#new-ball", "<b>here</b>")
        page.click("#add-ball")
        says(page, "#settings-error", "expected X,Y@FRAME")
        assert page.locator("#balls b").count() == 0
        page.click("#run")
        says(page, "#run-state", "Not started: see the message below the settings")
        assert page.locator("text=expected X,Y@FRAME").count() == 1


def list_runs(command):
    """List the process numbers of the runs of a workbench."""
    children = subprocess.run(["pgrep", "-P", str(command.pid)], capture_output=True, text=True).stdout.split()
    assert children
    return [int(child) for child in children]


def signal_runs(command, number):
    """Send a signal to the runs of a workbench. SIGSTOP halts them, so that none ends too soon on a quick machine."""
    for child in list_runs(command):
        os.kill(child, number)


def continue_interrupted_runs(command):
    """Let halted runs go on once the workbench has interrupted them; before that, a quick machine would end them."""
    runs = list_runs(command)
    assert until(lambda: all(map(is_interrupt_pending, runs)), 20.0)
    signal_runs(command, signal.SIGCONT)


def is_interrupt_pending(process):
    status = Path(f"/proc/{process}/status").read_text()
    return any(
        int(line.split()[1], 16) >> (signal.SIGINT - 1) & 1
        for line in status.splitlines()
        if line.startswith(("SigPnd", "ShdPnd"))
    )


def test_a_run_is_cancelled_and_one_that_is_killed_is_reported(films, browser, tmp_path):
    with workbench(films / "long.tif", tmp_path / "bench") as (command, address), opened(browser, address) as page:
        page.click("#run")
        says(page, "#run-state", r"Tracking \d+ of 4800 frames")
        says(page, "#run-time", r"^\d+ s, about \d+ s left$")
        signal_runs(command, signal.SIGSTOP)
        says(page, "#run-time", r"^[4-9] s")  # the clock of the page goes on while nothing is heard of the run
        page.click("#cancel")
        continue_interrupted_runs(command)
        says(page, "#run-state", "Cancelled")
        page.click("#run")
        says(page, "#run-state", r"Tracking \d+ of 4800 frames")
        signal_runs(command, signal.SIGKILL)
        says(page, "#run-state", "ended by signal 9")
        page.click("#run")
        says(page, "#run-state", r"Tracking \d+ of 4800 frames")
        signal_runs(command, signal.SIGSTOP)
        command.send_signal(signal.SIGINT)  # Ctrl-C ends the child, too
        continue_interrupted_runs(command)
        assert command.wait(20) == 130
        assert "interrupted; finished runs stay" in command.stderr.read()
        says(page, "#message", "does not answer")
    assert subprocess.run(["pgrep", "-f", f"{tmp_path}/bench"], capture_output=True).stdout == b""


@contextmanager
def left_during_a_run(films, browser, folder):
    """A workbench whose only page has been closed while a run is under way, which stands still."""
    with workbench(films / "long.tif", folder) as (command, address):
        with opened(browser, address) as page:
            page.click("#run")
            says(page, "#run-state", r"Tracking \d+ of 4800 frames")
            signal_runs(command, signal.SIGSTOP)
        yield command, address


def is_left_over(folder):
    return subprocess.run(["pgrep", "-f", str(folder)], capture_output=True).returncode == 0


def test_a_run_goes_on_when_its_page_is_closed_and_is_there_again(films, browser, tmp_path):
    with left_during_a_run(films, browser, tmp_path / "bench") as (command, address):
        time.sleep(PAGE_GRACE_S + 1.0)
        assert command.poll() is None  # the command waits for its run
        with opened(browser, address) as page:  # the same address, by a browser that has no cookie
            says(page, "#run-state", r"Tracking \d+ of 4800 frames")
            with workbench(films / "long.tif", tmp_path / "bench") as (_, other), opened(browser, other) as second:
                says(second, "#command", "results_2")  # the number of the run under way is taken
            signal_runs(command, signal.SIGCONT)
            page.wait_for_selector("#run-state:text('Done.')", timeout=60_000)
            says(page, "#results", "results_1")
        assert command.wait(20) == 0
    assert sorted(path.name for path in (tmp_path / "bench").iterdir()) == ["command_1.txt", "results_1"]
    assert not is_left_over(tmp_path)


def test_ctrl_c_ends_a_run_whose_page_is_closed(films, browser, tmp_path):
    with left_during_a_run(films, browser, tmp_path / "bench") as (command, _):
        command.send_signal(signal.SIGINT)
        continue_interrupted_runs(command)
        assert command.wait(60) == 130
    assert not (tmp_path / "bench/results_1").exists()
    assert not is_left_over(tmp_path)


def test_the_next_frame_is_asked_for_before_its_step(address, browser):
    with opened(browser, address) as page:
        asked = []
        page.on("request", lambda request: asked.append(urlsplit(request.url).path))
        for frame in (1, 2):
            with page.expect_request(f"**/api/balls/{frame + 1}"):
                page.keyboard.press("ArrowRight")
            assert shown(page, frame) == 1
        assert asked.count("/frame/2.jpg") == asked.count("/api/balls/2") == 1
        page.fill("#region", "150,5,190,30")  # no ball is there
        says(page, "#detector", "Looking through the film")
        page.focus("#stage")
        page.keyboard.press("ArrowRight")
        assert shown(page, 3) == 0  # not the ball that was found ahead with other settings


def test_a_browser_is_let_in_by_the_file_that_it_opens(address, browser, tmp_path):
    with opened(browser, write_opening_page(tmp_path, address).as_uri()) as page:
        assert page.url == address.partition("?")[0]


def test_nobody_else_gets_in(address, browser):
    with opened(browser, address) as page:
        bare = address.partition("?")[0]
        stranger = browser.new_context().new_page()
        assert stranger.goto(bare).status == 403
        stranger.set_content(f"<img src='{bare}frame/0.jpg'><p>other</p>")
        assert page.evaluate("document.cookie") == ""  # scripts do not see it
        stranger.context.close()


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (400, "light"), (400, "dark")])
def test_nothing_is_wider_than_the_screen(address, browser, width, scheme):
    with opened(browser, address, color_scheme=scheme) as page:
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        keep_picture(page, f"{width}_{scheme}")


def test_a_scene_is_moved_by_sliders_made_and_opened(films, browser, tmp_path):
    with workbench(films / "long.tif", tmp_path / "bench") as (_, address), opened(browser, address) as page:
        page.click("#view-make")
        page.wait_for_selector("#slider-offset", timeout=60_000)
        page.select_option("#scene", "head_on")
        says(page, "#yaml", "name: head-on")
        page.locator("#slider-speed").focus()
        page.keyboard.press("ArrowRight")  # moves the slider, not the film
        says(page, "#yaml", r"v0: 0\.\d+")
        page.fill("[data-name=offset] input[type=number]", "3")
        says(page, "#make-error", "Offset b: expected -0.95 to 0.95, not 3")
        page.fill("[data-name=offset] input[type=number]", "0.4")
        says(page, "#yaml", "b: 0.4")
        says(page, "#make-error", "^$")
        keep_picture(page, "make", full_page=False)
        page.fill("[data-name=balls] input[type=number]", "1")
        page.wait_for_selector("[data-name=offset].unused")
        page.click("#generate")
        page.wait_for_selector("#measure:not([hidden])", timeout=60_000)
        says(page, "#film-name", "made_1/clips/000000")
        assert shown(page, 0) == 1
        says(page, "#scale", "0.16 mm/px .camera.json.")
    assert "kind: single" in (tmp_path / "bench/scene_1.yaml").read_text()


def test_clips_of_a_dataset_in_colour(browser, tmp_path):
    for number, first in ((3, 0), (4, 30)):
        light = film(np.random.default_rng(2), PATHS[first : first + 30])
        folder = tmp_path / f"data/clips/{number:06d}"
        folder.mkdir(parents=True)
        colours = np.stack([light, light // 2, np.zeros_like(light)], axis=-1)
        tifffile.imwrite(folder / "frames.tif", colours, photometric="rgb")
        (folder / "camera.json").write_text(json.dumps(CAMERA))
    with workbench(tmp_path / "data", tmp_path / "bench") as (_, address), opened(browser, address) as page:
        says(page, "#scale", "0.16 mm/px .camera.json.")
        page.select_option("#clip", label="4")
        says(page, "#film-name", "clips/000004")
        shown(page, 0)
        asked = page.evaluate("performance.getEntriesByType('resource').map((entry) => entry.name)")
        marks = {name.partition("mark=")[2].partition("&")[0] for name in asked if "/frame/0.jpg" in name}
        assert len(marks) == 2  # a kept picture of another clip would be shown otherwise
        assert "data/clips/000004" in page.text_content("#command")
        says(page, "#notes", "colour")
        page.check("input[value=ball]")
        page.mouse.click(*at(page, *PATHS[30, 0]))
        page.click("#take-colour")
        says(page, "#command", r"--colour '#[\da-f]{4}00'")  # a pixel of red has half as much of green
        page.fill("#colour", "")
        page.click("#balls button")
        page.select_option("#channel", label="red")
        page.check("#search-channel")
        says(page, "#command", "--channel red")
        says(page, "#detector", "2 balls here, by maximum_likelihood in red")
