// The page: puts its parts together, hears the keys, and follows the state of the server.

import { AskedAhead, get, newestOnly, post } from "/static/api.js";
import { Arrows } from "/static/arrows.js";
import { Inspector } from "/static/ball.js";
import { Make } from "/static/make.js";
import { Mending } from "/static/mending.js";
import { Player } from "/static/player.js";
import { Pointing } from "/static/pointing.js";
import { ResidualPlot } from "/static/residuals.js";
import { Run } from "/static/run.js";
import { Stage } from "/static/stage.js";

const element = (id) => document.getElementById(id);
const TOOLS = ["look", "scale", "points", "ball", "region", "polygon", "mend", "tape"];

function tell(text) {
  element("message").textContent = text;
  element("message").hidden = text === "";
}

async function begin() {
  let film = await get("/api/film");
  const stage = new Stage(element("stage")), player = new Player(stage, film, tell);
  const inspector = new Inspector(stage, player), pointing = new Pointing(stage, player, inspector);
  const plot = new ResidualPlot(player), arrows = new Arrows(stage, plot);
  const mending = new Mending(stage, player, pointing, inspector, plot, arrows);
  const make = new Make();
  const run = new Run(pointing, mending, arrows, tell, {
    calibrate: async () => { takeSettings(await get("/api/film")); },
    generate: async () => { change(await get("/api/film")); show("measure"); },
  });
  let detector = film.status.detector;

  function takeSettings(next) {
    film = next;
    pointing.open(film);
  }

  // Another film, or another clip of it, in place of the one in view.
  function change(next) {
    run.clear();
    player.open(next);
    open(next);
  }

  // One of the views of the page.
  function show(view) {
    for (const name of ["measure", "make"]) {
      element(name).hidden = name !== view;
      element(`view-${name}`).setAttribute("aria-pressed", name === view);
    }
    element("report-box").classList.toggle("away", view !== "measure");
    if (view === "make") make.open();
  }

  function open(next) {
    film = next;
    run.open(film);
    document.title = `${film.film.split("/").at(-1)} – workbench`;
    element("film-name").textContent = `${film.film} · ${film.size.join(" × ")} px · ${film.frames} frames`;
    element("clip-choice").hidden = film.clips.length < 2;
    element("clip").replaceChildren(...film.clips.map((number, k) => {
      const known = film.opened.find((clip) => clip.clip === number);
      return new Option(known ? `${number}: ${known.status}` : number, k, false, k === film.clip);
    }));
    element("channel").replaceChildren(...film.channels.map((name) => new Option(name, name)));
    element("channel").disabled = film.channels.length < 2;
    element("search-choice").hidden = film.channels.length < 2;
    if (film.settings.channel) element("channel").value = player.look.channel = film.settings.channel;
    setBrightness(0, 1);
    pointing.open(film);
    tell(film.notes.filter((note) => note.startsWith("truncated") || note.startsWith("damaged")).join("; "));
    hear(film.status);
  }

  const ballsAhead = new AskedAhead(get);

  // When all of a frame is shown, the server is free for the next one.
  function prepareNext() {
    const found = "balls" in stage.canvas.dataset || player.playing;
    if (player.shown !== player.index || (detector.state === "ready" && !found)) return;
    player.prepareNext();
    if (detector.state === "ready" && player.next !== null) ballsAhead.prepare(`/api/balls/${player.next}`);
  }

  const findBalls = newestOnly(async (index) => {
    if (detector.state !== "ready") return;
    try {
      const found = await ballsAhead.take(`/api/balls/${index}`);
      if (index !== player.index) return;
      Object.assign(stage.marks, { balls: found.balls, radius: found.radius });
      inspector.point = found.point;
      stage.canvas.dataset.balls = found.balls.length; // for tests and screen readers
      element("detector").textContent = found.read
        ? `${found.balls.length} ball${found.balls.length === 1 ? "" : "s"} here, by ${detector.name}${detector.channel === "grey" ? "" : ` in ${detector.channel}`}.`
        : "This frame is not among those of --frames.";
      element("stage").setAttribute("aria-label", `Frame ${player.number}, ${found.balls.length} balls found`);
      stage.draw();
      inspector.look();
      prepareNext();
    } catch (error) {
      if (error.status !== 409) element("detector").textContent = error.message;
    }
  });

  function hear(status) {
    const changed = status.detector.state !== detector.state || status.version !== hear.version;
    detector = status.detector;
    hear.version = status.version;
    if (changed) ballsAhead.forget();
    if (detector.state === "preparing") element("detector").textContent = "Looking through the film for balls …";
    if (detector.state === "failed") element("detector").textContent = detector.error;
    if (detector.state !== "ready") stage.marks.balls = [];
    else if (changed) findBalls(player.index);
    const notes = [...film.notes.filter((note) => !note.startsWith("no camera file")), ...detector.notes];
    element("notes-box").hidden = notes.length === 0;
    element("notes").replaceChildren(...notes.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
    run.show(status);
    make.follow(status);
    stage.draw();
  }

  function setBrightness(low, high) {
    element("low").value = Math.round(low * 100);
    element("high").value = Math.max(Math.round(high * 100), Number(element("low").value) + 1);
    Object.assign(player.look, { low, high: Math.max(high, low + 0.005) });
    player.show();
  }

  player.addEventListener("frame", () => {
    stage.marks.balls = [];
    delete stage.canvas.dataset.balls;
    findBalls(player.index);
  });
  player.addEventListener("picture", () => {
    stage.canvas.dataset.frame = player.shown;
    inspector.look();
    prepareNext();
  });
  element("channel").addEventListener("change", () => {
    player.look.channel = element("channel").value;
    player.show();
    if (element("search-channel").checked) pointing.send();
  });
  for (const id of ["low", "high"]) {
    element(id).addEventListener("input", () => {
      const [low, high] = [Number(element("low").value) / 100, Number(element("high").value) / 100];
      setBrightness(id === "low" ? low : Math.min(low, high - 0.01), id === "high" ? high : Math.max(high, low + 0.01));
    });
  }
  element("auto").addEventListener("click", async () => {
    try {
      setBrightness(...(await get("/api/levels")));
    } catch (error) {
      tell(error.message);
    }
  });
  element("plain").addEventListener("click", () => setBrightness(0, 1));
  element("zoom-in").addEventListener("click", () => stage.zoomBy(1.5));
  element("zoom-out").addEventListener("click", () => stage.zoomBy(1 / 1.5));
  element("fit").addEventListener("click", () => stage.fit());
  for (const view of ["measure", "make"]) element(`view-${view}`).addEventListener("click", () => show(view));
  element("clip").addEventListener("change", async () => {
    try {
      change(await post("/api/clip", Number(element("clip").value)));
    } catch (error) {
      tell(error.message);
    }
  });

  let nextBall = 0;
  function jumpToBall() {
    const { balls } = stage.marks;
    if (balls.length === 0) return;
    const ball = balls[nextBall++ % balls.length];
    stage.point([ball.x, ball.y]);
    stage.draw();
  }

  const keys = {
    ArrowLeft: (big) => player.go(player.index - (big ? 10 : 1)),
    ArrowRight: (big) => player.go(player.index + (big ? 10 : 1)),
    Home: () => player.go(0),
    End: () => player.go(film.frames - 1),
    " ": () => player.toggle(),
    "+": () => stage.zoomBy(1.5, stage.middle),
    "=": () => stage.zoomBy(1.5, stage.middle),
    "-": () => stage.zoomBy(1 / 1.5, stage.middle),
    0: () => stage.fit(),
    n: jumpToBall,
    Delete: () => mending.press("remove-point"),
    b: () => mending.chooseNext(),
    a: () => mending.addAtCross(),
    c: () => pointing.closePolygon(),
    u: () => mending.press("undo"),
    r: () => mending.press("redo"),
  };
  TOOLS.forEach((tool, k) => { keys[k + 1] = () => pointing.choose(tool); });
  const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  document.addEventListener("keydown", (event) => {
    const { target } = event, plain = !event.ctrlKey && !event.metaKey;
    const isSlider = target.type === "range" && target.id !== "frame";
    if (!plain || !element("make").hidden || isSlider || target.matches("select, textarea, summary, iframe, input:not([type=range], [type=radio], [type=checkbox])")) return;
    const presses = target.matches("button, input[type=checkbox], input[type=radio]");
    if (presses && (event.key === " " || (target.type === "radio" && event.key.startsWith("Arrow")))) return;
    if (event.altKey && moves[event.key]) {
      const step = event.shiftKey ? 10 : 1;
      stage.canvas.focus({ preventScroll: true });
      stage.moveCross(...moves[event.key].map((v) => v * step));
    } else if (event.key === "Enter" && target === stage.canvas) {
      stage.press(stage.cross, event.shiftKey);
    } else if (keys[event.key] && !event.altKey) {
      keys[event.key](event.shiftKey);
    } else {
      return;
    }
    event.preventDefault();
  });

  open(film);
  const stream = new EventSource("/api/status");
  stream.addEventListener("message", (event) => hear(JSON.parse(event.data)));
  stream.addEventListener("error", () => tell("The workbench does not answer. If it has ended, start tracker open again."));
  stream.addEventListener("open", () => { if (element("message").textContent.startsWith("The workbench does not")) tell(""); });
}

begin().catch((error) => tell(error.message));
