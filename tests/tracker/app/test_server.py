"""The addresses of the page: who is let in, what is served, what is refused."""

import json
import re
import threading

import numpy as np
import pandas as pd
import pytest
import tifffile
from processes import until
from tracker_film import CAMERA, collision, film, write_clip

pytest.importorskip("starlette", reason="the extra app is not installed")
from starlette.testclient import TestClient

from synthcam_shared.errors import InputError
from tracker.app import workbench
from tracker.app.server import STATIC, OpenPages, make_application, remind_of_address, write_opening_page
from tracker.app.track_process import RunStatus
from tracker.app.workbench import Workbench
from tracker.camera.recordings import open_source

HOME = "http://127.0.0.1:8000"
SCALE = {"scale": 2e-4, "fps": 250}


@pytest.fixture(scope="module")
def pictures():
    paths = collision(30, contact=13.4, speed=2.5)
    return paths, film(np.random.default_rng(0), paths)


@pytest.fixture(scope="module")
def bench(tmp_path_factory, pictures):
    folder = tmp_path_factory.mktemp("bench") / "<b>clip"
    write_clip(folder, pictures[1])
    bench = Workbench(open_source(folder))
    assert until(lambda: bench.detector_status.state == "ready")
    yield bench
    bench.close()


@pytest.fixture
def without_detector(monkeypatch):
    """Workbenches that prepare no detector, which takes a second."""
    monkeypatch.setattr(workbench, "prepare_detector", lambda *given: None)


def enter(bench):
    client = TestClient(make_application(bench, 8000, "secret"), HOME, headers={"Origin": HOME})
    client.get("/?token=secret")
    return client


@pytest.fixture
def client(bench):
    client = enter(bench)
    yield client
    client.post("/api/settings", json={})


def test_the_token_lets_in_and_leaves_a_strict_cookie(bench):
    application = make_application(bench, 8000, "secret")
    client = TestClient(application, HOME)
    assert client.get("/").status_code == 403
    assert client.get("/?token=").status_code == 403
    assert client.get("/?token=wrong").status_code == 403
    assert client.get("/api/film?token=secret").status_code == 403
    answer = client.get("/?token=secret")
    assert (answer.status_code, 'content="0;url=/"' in answer.text) == (200, True)
    assert {"HttpOnly", "SameSite=strict"} <= set(answer.headers["set-cookie"].split("; "))
    page = client.get("/")
    assert page.status_code == 200
    assert "default-src 'none'; script-src 'self'" in page.headers["content-security-policy"]
    assert page.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    ("method", "path", "change", "code"),
    [
        ("GET", "/", {"Host": "evil.example"}, 403),
        ("GET", "/", {"Host": "127.0.0.1:8001"}, 403),
        ("GET", "/", {"Host": "localhost:8000"}, 200),
        ("POST", "/api/settings", {"Origin": "http://evil.example"}, 403),
        ("POST", "/api/settings", {"Origin": "null"}, 403),
        ("POST", "/api/settings", {"Content-Type": "text/plain"}, 415),
        ("POST", "/api/settings", {"Content-Length": "70000"}, 413),
        ("POST", "/api/settings", {}, 200),
        ("DELETE", "/api/settings", {}, 405),
        ("GET", "/static/main.js", {}, 200),
        ("GET", "/static/..%2fserver.py", {}, 404),
        ("GET", "/static/../../server.py", {}, 404),
        ("GET", "/static/none.js", {}, 404),
        ("GET", "/report/wrong/1/index.html", {}, 422),
        ("GET", "/frame/0.jpg", {}, 200),
        ("GET", "/frame/0.exe", {}, 404),
        ("GET", "/frame/30.jpg", {}, 422),
        ("GET", "/frame/0.jpg?low=x", {}, 422),
        ("GET", "/frame/0.png?box=1,2,3", {}, 422),
        ("GET", "/api/balls/30", {}, 422),
        ("GET", "/api/tracks", {}, 200),
    ],
)
def test_who_is_let_in_and_what_is_served(client, method, path, change, code):
    headers = {"Content-Type": "application/json", **change}
    assert client.request(method, path, headers=headers, content=None if method == "GET" else b"{}").status_code == code


@pytest.mark.parametrize("body", ["{", "[" * 50_000, "null", '{"scale": NaN}', "7"])
def test_bodies_that_are_no_settings(client, body):
    answer = client.post("/api/settings", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert "\n" not in answer.json()["error"]


def test_the_film_is_described_and_its_balls_are_found(client, bench, pictures):
    about = client.get("/api/film").json()
    assert (about["frames"], about["size"], about["channels"]) == (30, [200, 160], ["grey"])
    assert about["given"]["scale"] == CAMERA["scale"]
    low, high = client.get("/api/levels").json()
    assert 0 <= low < high <= 1
    assert about["status"]["detector"]["name"] == "maximum_likelihood"
    found = client.get("/api/balls/20").json()
    places = pictures[0][20]
    assert len(found["balls"]) == len(places)
    assert all(min(np.hypot(b["x"] - x, b["y"] - y) for b in found["balls"]) < 0.1 for x, y in places)


def test_settings_make_a_camera_file_and_a_command(client, bench):
    plan = client.post("/api/settings", json={**SCALE, "frames": "2:20", "balls": ["100,80@3"]}).json()
    assert json.loads(plan["camera"])["scale"] == 2e-4
    assert "--ball 100,80@3 --frames 2:20" in plan["command"]
    assert client.get("/api/film").json()["settings"]["frames"] == "2:20"  # a page that is loaded again has them
    client.post("/api/settings", json={"frames": "2:20"})
    assert until(lambda: bench.detector_status.state == "ready")
    assert client.get("/api/balls/10").json()["balls"]
    left_out = client.get("/api/balls/25").json()
    assert (left_out["read"], left_out["balls"]) == (False, [])
    wrong = client.post("/api/settings", json={"region": "1,2"})
    assert (wrong.status_code, wrong.json()["error"].partition(":")[0]) == (422, "--region '1,2'")


def test_a_run_writes_the_camera_file_and_serves_its_report_alone(client, bench, monkeypatch):
    def finish(number, words):
        folder = bench.folder / f"results_{number}"
        folder.mkdir()
        (folder / "index.html").write_text("the report")
        (folder / "run.json").write_text("{}")
        pd.DataFrame({"clip": [0], "status": ["ok"]}).to_parquet(folder / "estimates.parquet")
        (bench.folder / "other.html").write_text("not of this run")
        (folder / "out.html").symlink_to(bench.folder / "other.html")
        started.append(words)

    started = []
    monkeypatch.setattr(bench.process, "start", finish)
    client.post("/api/run", json=SCALE)
    camera = bench.folder / "camera_1.json"
    assert json.loads(camera.read_text())["scale"] == 2e-4
    assert started[0][:6] == ["tracker", "track", f"{bench.film}", "-o", f"{bench.folder / 'results_1'}", "--camera"]
    reports = f"/report/{bench.report_key}"
    stranger = TestClient(client.app, HOME)  # a page without an origin, as reports are, has no cookie
    report = stranger.get(f"{reports}/1/index.html")
    assert (report.text, report.status_code) == ("the report", 200)
    assert "frame-ancestors 'self'; sandbox allow-scripts" in report.headers["content-security-policy"]
    assert stranger.get("/report/other/1/index.html").status_code == 403
    assert stranger.post(f"{reports}/1/index.html").status_code == 403
    for name in ("run.json", "..%2fother.html", "out.html", "none.html"):
        assert client.get(f"{reports}/1/{name}").status_code == 404
    assert client.get(f"{reports}/2/index.html").status_code == 422
    assert "results_2" in client.post("/api/settings", json={}).json()["command"]


@pytest.mark.usefixtures("without_detector")
def test_two_sessions_on_one_folder_take_different_numbers(tmp_path, pictures, monkeypatch):
    tifffile.imwrite(tmp_path / "film.tif", pictures[1][:4], imagej=True)
    both = [Workbench(open_source(tmp_path / "film.tif")) for _ in range(2)]
    numbers = []
    for bench in both:
        offered = iter([1, 2])
        monkeypatch.setattr(bench.process, "start", lambda number, words: numbers.append(number))
        monkeypatch.setattr(bench, "_next_number", lambda folder, offered=offered: next(offered))  # both sessions: 1
    for bench in both:
        bench.start_run()
        bench.close()
        assert not bench._worker.is_alive()
    assert numbers == [1, 2]
    assert "results_2" in (both[1].folder / "command_2.txt").read_text()


def test_the_file_that_a_browser_opens_is_for_this_user_alone(tmp_path):
    page = write_opening_page(tmp_path, "http://127.0.0.1:8000/?token=secret")
    assert page.stat().st_mode & 0o777 == 0o600
    assert "url=http://127.0.0.1:8000/?token=secret" in page.read_text()


def test_the_address_is_told_again_where_no_page_has_asked(bench, capsys):
    presence, over = OpenPages(), threading.Event()
    remind_of_address(presence, over, wait_s=0)
    assert capsys.readouterr().err == "tracker: no page has connected: open the address above\n"
    client = TestClient(make_application(bench, 8000, "secret", presence), HOME)
    for path in ("/?token=secret", "/"):
        client.get(path)
    remind_of_address(presence, over, wait_s=0)
    over.set()
    remind_of_address(OpenPages(), over)
    assert capsys.readouterr().err == ""


def test_the_end_does_not_wait_for_a_detector_that_takes_long(tmp_path, pictures, monkeypatch):
    begun, go_on = threading.Event(), threading.Event()
    monkeypatch.setattr(workbench, "MAX_WAIT_AT_END_S", 0.01)
    monkeypatch.setattr(workbench, "prepare_detector", lambda *given: (begun.set(), go_on.wait(5)))
    tifffile.imwrite(tmp_path / "film.tif", pictures[1][:4], imagej=True)
    bench = Workbench(open_source(tmp_path / "film.tif"))
    begun.wait()
    bench.close()
    assert bench._worker.is_alive()
    go_on.set()


@pytest.mark.usefixtures("without_detector")
def test_a_calibration_gives_the_film_its_camera_file(tmp_path, pictures, monkeypatch):
    tifffile.imwrite(tmp_path / "film.tif", pictures[1], imagej=True)
    bench, started = Workbench(open_source(tmp_path / "film.tif")), []
    client = enter(bench)
    client.post("/api/settings", json={"region": "0,0,150,90"})
    monkeypatch.setattr(bench.process, "start", lambda number, words: started.append((number, words)))
    assert "set the ball diameter and" in client.post("/api/calibrate", json={"fps": 250}).json()["error"]
    client.post("/api/calibrate", json={"fps": 250, "ball_diameter": 2.38e-3})
    points = [[10, 20, 0.0, 0.1], [150, 20, 0.1, 0.1], [150, 120, 0.1, 0.0], [10, 120, 0.0, 0.0]]
    size = {"fps": 250, "ball_diameter": 2.38e-3}
    client.post("/api/calibrate", json={**size, "points": points})
    number, words = started.pop()
    assert words[-2:] == ["--points", f"{bench.folder / f'points_{number}.csv'}"]
    assert (bench.folder / f"points_{number}.csv").read_text().splitlines()[:2] == ["x_px,y_px,x,y", "10,20,0,0.1"]
    for wrong in (points[:3], [[1, 2, 3]] * 4, [["1", 2, 3, 4]] * 4, 7):
        assert client.post("/api/calibrate", json={**size, "points": wrong}).status_code == 422
    ((number, words),) = started
    file = bench.folder / f"calibrated_{number}.json"
    film = ["tracker", "calibrate", f"{tmp_path / 'film.tif'}", "-o", f"{file}"]
    assert words == [*film, "--diameter", "0.00238", "--fps", "250"]
    file.write_text(json.dumps(CAMERA))
    bench.process._finish(RunStatus(command="calibrate", number=number, state="done"))
    about = client.get("/api/film").json()
    assert (about["given"]["scale"], about["settings"]["region"]) == (CAMERA["scale"], "0,0,150,90")
    assert f"--camera {file}" in about["plan"]["command"]
    assert "results_3" in about["plan"]["command"]
    bench.close()


def test_one_run_at_a_time(client, bench, monkeypatch):
    monkeypatch.setattr(type(bench.process), "is_running", True)
    for path, body in (("/api/run", {}), ("/api/clip", 0), ("/api/calibrate", {"fps": 9, "ball_diameter": 0.1})):
        answer = client.post(path, json=body)
        assert (answer.status_code, "under way" in answer.json()["error"]) == (422, True)


@pytest.mark.usefixtures("without_detector")
def test_clips_of_a_dataset_are_chosen_by_their_index(tmp_path, pictures):
    for number in (3, 7):
        write_clip(tmp_path / f"data/clips/{number:06d}", pictures[1][: number + 3])
    bench = Workbench(open_source(tmp_path / "data"))
    client = enter(bench)
    mark = client.get("/api/film").json()["mark"]
    about = client.post("/api/clip", json=1).json()
    assert about["mark"] != mark
    assert (about["clips"], about["clip"], about["frames"]) == ([3, 7], 1, 10)
    assert about["film"].endswith("data/clips/000007")
    assert "data_workbench" in about["folder"]
    for wrong in (2, -1, True, "0", 0.5):
        assert client.post("/api/clip", json=wrong).status_code == 422
    bench.close()


def test_folders_that_cannot_hold_results(tmp_path, pictures):
    write_clip(tmp_path / "clip", pictures[1])
    (tmp_path / "file").touch()
    for folder in ("file", "clip", "clip/inside"):
        with pytest.raises(InputError, match="expected a folder"):
            Workbench(open_source(tmp_path / "clip"), tmp_path / folder)


def test_the_session_ends_some_seconds_after_the_last_page():
    now = [100.0]
    presence = OpenPages(lambda: now[0])
    assert not presence.is_over()  # no page yet
    presence.enter()
    presence.enter()
    presence.leave()
    now[0] += 60
    assert not presence.is_over()
    presence.leave()
    assert not presence.is_over()  # a reload takes a moment
    now[0] += 6
    assert presence.is_over()
    presence.enter()
    assert not presence.is_over()


def test_data_never_becomes_markup_and_nothing_comes_from_elsewhere():
    texts = {path.name: path.read_text() for path in STATIC.iterdir()}
    assert {"index.html", "main.js", "workbench.css"} <= set(texts)
    for name, text in texts.items():
        assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|eval\(|https?://", text), name
