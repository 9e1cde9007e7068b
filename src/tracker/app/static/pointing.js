// What is set: scale, balls, region, frames, numbers of the camera. The server checks it and gives the command line.

import { frameAddress, newestOnly, post } from "/static/api.js";
import { cornersOfBox } from "/static/stage.js";

const POINTING_ERROR_PX = 1; // of each end of a length
const element = (id) => document.getElementById(id);
const rounded = (value, digits = 6) => Number(value.toPrecision(digits));
const HINTS = {
  look: "Drag to move the picture; turn the wheel to zoom.",
  scale: "Click both ends of a known length, then type the length.",
  points: "Click a point of the table that you know, then type its x and y in mm, y up. Four or more give the perspective.",
  ball: "Click the middle of a ball: an example for --ball. Not needed if the balls are found.",
  region: "Drag a rectangle: balls are searched in it alone. With Leave out ticked: everywhere but in it.",
  polygon: "Click the corners; click the first one again to close the polygon.",
  mend: "Click a ball to choose its track, or the place of a point to add. Shift and a click: add a point of the chosen ball, and go to the next frame.",
  tape: "Click two points to measure their distance and direction. Nothing is set.",
};

export class Pointing {
  constructor(stage, player, inspector) {
    Object.assign(this, { stage, player, inspector, ballTexts: [], given: {} });
    inspector.inMillimetres = (pixels) => this.inMillimetres(pixels);
    this.send = newestOnly(() => this.apply());
    for (const id of ["fps", "diameter", "exposure", "first", "last", "region", "colour"]) {
      element(id).addEventListener("input", () => this.send());
    }
    for (const id of ["length", "points"]) element(id).addEventListener("input", () => this.setScale());
    element("known-points").addEventListener("input", () => this.markPoints());
    element("no-scale").addEventListener("click", () => this.clearScale());
    element("region").addEventListener("input", () => this.markRegion());
    element("close-polygon").addEventListener("click", () => this.closePolygon());
    element("no-region").addEventListener("click", () => { element("region").value = ""; this.markRegion(); this.send(); });
    element("take-colour").addEventListener("click", () => this.takeColour());
    element("add-ball").addEventListener("click", () => this.addTypedBall());
    element("settings").addEventListener("submit", (event) => { event.preventDefault(); this.addTypedBall(); });
    element("search-channel").addEventListener("change", () => this.send());
    for (const radio of document.querySelectorAll("input[name=tool]")) {
      radio.addEventListener("change", () => this.choose(radio.value));
      radio.addEventListener("click", (event) => { // by the mouse: arrow keys then step through the film
        if (event.detail > 0) stage.canvas.focus({ preventScroll: true });
      });
    }
    for (const button of document.querySelectorAll("[data-copy]")) {
      button.addEventListener("click", () => this.copy(button));
    }
    stage.addEventListener("press", (event) => this.press(event.detail));
    player.addEventListener("frame", () => this.markHints());
    this.choose("look");
  }

  open(film) {
    const { settings } = film, given = film.given ?? {};
    const number = (id, value, factor = 1) => {
      element(id).value = value == null ? "" : rounded(value * factor, 9);
      this.loaded[id] = element(id).value;
    };
    this.settings = settings;
    element("settings-error").textContent = "";
    this.loaded = {};
    this.scale = settings.scale;
    this.scaleStd = settings.scale_std;
    this.given = given;
    this.ballTexts = [...settings.balls];
    number("fps", settings.fps ?? given.fps);
    number("diameter", settings.ball_diameter ?? given.ball_diameter, 1e3);
    number("exposure", settings.exposure ?? given.exposure, 1e3);
    const [first, last] = settings.frames.split(":");
    element("first").value = first ?? "";
    element("last").value = last ?? "";
    element("region").value = settings.region;
    element("points").value = element("length").value = "";
    element("known-points").value = "";
    this.stage.marks.points = [];
    element("colour").value = settings.colour;
    element("colour-box").hidden = !film.channels.includes("colour film");
    element("take-colour").disabled = true;
    element("search-channel").checked = settings.channel !== "";
    this.searched = settings.channel;
    element("film-fps").textContent = film.fps ? `The file says ${rounded(film.fps)}.` : "The file does not say.";
    element("use-fps").hidden = !film.fps;
    element("use-fps").onclick = () => { element("fps").value = rounded(film.fps); this.send(); };
    this.stage.marks.scale = [];
    this.stage.marks.pending = null;
    this.markRegion();
    this.listBalls();
    this.showScale();
    this.showPlan(film.plan);
  }

  choose(tool) {
    this.stage.tool = tool;
    this.stage.marks.pending = null;
    this.stage.marks.polygon = [];
    this.stage.marks.tape = [];
    element("close-polygon").hidden = true;
    element(`hint`).textContent = HINTS[tool];
    document.querySelector(`input[name=tool][value=${tool}]`).checked = true;
    this.stage.draw();
  }

  press({ at: [x, y], shift }) {
    const { marks, tool } = this.stage, [width, height] = this.stage.size;
    const at = [Math.min(Math.max(x, 0), width - 1), Math.min(Math.max(y, 0), height - 1)].map((v) => rounded(v, 5));
    if (tool === "ball") {
      const seen = this.inspector.find(at), [bx, by] = seen ? [seen.x, seen.y] : at;
      this.clicked = { at: [bx, by], index: this.player.index };
      element("take-colour").disabled = false;
      this.addBall(`${bx.toFixed(1)},${by.toFixed(1)}@${this.player.number}`);
    } else if (tool === "points") {
      const text = element("known-points");
      text.value = `${text.value.trimEnd()}${text.value.trim() ? "\n" : ""}${at.map((v) => v.toFixed(1)).join(" ")} `;
      this.markPoints();
      text.focus();
    } else if (tool === "polygon") {
      const first = marks.polygon[0], near = 12 / this.stage.zoom;
      if (marks.polygon.length > 2 && Math.hypot(at[0] - first[0], at[1] - first[1]) < near) this.closePolygon();
      else marks.polygon.push(at.map((v) => rounded(v, 4)));
      element("close-polygon").hidden = marks.polygon.length < 3;
    } else if (tool === "mend") {
      this.stage.dispatchEvent(new CustomEvent("mend", { detail: { at, shift } }));
    } else if (tool !== "look" && !marks.pending) {
      marks.pending = at;
    } else if (tool === "scale") {
      const show = (point) => point.map((v) => v.toFixed(1)).join(",");
      element("points").value = `${show(marks.pending)} ${show(at)}`;
      marks.pending = null;
      this.setScale();
      element("length").focus();
    } else if (tool === "tape") {
      this.measure(marks.pending, at);
      marks.pending = null;
    } else if (tool === "region") {
      const [a, b] = [marks.pending, at];
      marks.pending = null;
      const corners = [Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.max(a[0], b[0]), Math.max(a[1], b[1])];
      this.addRegion(corners.map((v) => Math.round(v)).join(","));
    }
    this.stage.draw();
  }

  // Distance and direction from one point to another, by the scale of the page or of the film's camera file.
  measure(from, to) {
    this.stage.marks.tape = [from, to];
    const [right, up] = [to[0] - from[0], from[1] - to[1]], pixels = Math.hypot(right, up);
    const direction = `${((Math.atan2(up, right) * 180) / Math.PI).toFixed(1)}° from the right, counterclockwise`;
    element("hint").textContent = `${pixels.toFixed(1)} px${this.inMillimetres(pixels)}, ${direction}.`;
  }

  inMillimetres(pixels) {
    const scale = this.scale ?? (this.given.R ? null : this.given.scale); // at an angle no one scale holds
    return scale == null ? "" : `, ${rounded(scale * 1e3 * pixels, 4)} mm`;
  }

  // The mean colour of 5 x 5 pixels in the middle of the ball that was clicked last.
  async takeColour() {
    const { at: [x, y], index } = this.clicked, box = [Math.round(x) - 2, Math.round(y) - 2, 5, 5].join(",");
    const look = { channel: "colour film", mark: this.player.look.mark, box };
    const picture = await createImageBitmap(await (await fetch(frameAddress(index, look, "png"))).blob());
    const pen = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d");
    pen.imageSmoothingQuality = "high";
    pen.drawImage(picture, 0, 0, 1, 1);
    const rgb = [...pen.getImageData(0, 0, 1, 1).data].slice(0, 3);
    element("colour").value = `#${rgb.map((v) => v.toString(16).padStart(2, "0")).join("")}`;
    this.send();
  }

  closePolygon() {
    const { marks } = this.stage;
    if (marks.polygon.length < 3) return;
    this.addRegion(marks.polygon.map((corner) => corner.join(",")).join(" "));
    marks.polygon = [];
    element("close-polygon").hidden = true;
  }

  addRegion(text) {
    const field = element("region"), part = element("region-out").checked ? `not ${text}` : text;
    field.value = field.value.trim() ? `${field.value.trim()}; ${part}` : part;
    this.markRegion();
    this.send();
  }

  // Each line of the field: x and y in px, x and y in mm.
  get knownPoints() {
    const lines = element("known-points").value.split("\n").map((line) => line.split(/[\s,;]+/).filter(Boolean).map(Number));
    return lines.filter((line) => line.length).map(([a, b, x, y]) => [a, b, rounded(x / 1e3, 12), rounded(y / 1e3, 12)]);
  }

  markPoints() {
    this.stage.marks.points = this.knownPoints.map(([x, y]) => ({ x, y })).filter(({ x, y }) => Number.isFinite(x + y));
    this.stage.draw();
  }

  setScale() {
    const numbers = element("points").value.split(/[\s,;]+/).filter(Boolean).map(Number);
    const valid = numbers.length === 4 && numbers.every(Number.isFinite);
    this.stage.marks.scale = valid ? [numbers.slice(0, 2), numbers.slice(2)] : [];
    this.stage.draw();
    const length = Number(element("length").value) / 1e3;
    const pixels = valid ? Math.hypot(numbers[2] - numbers[0], numbers[3] - numbers[1]) : 0;
    if (!(length > 0 && pixels > 0)) return;
    this.scale = rounded(length / pixels, 7);
    this.scaleStd = rounded((this.scale * Math.SQRT2 * POINTING_ERROR_PX) / pixels, 2);
    this.showScale();
    this.send();
  }

  clearScale() {
    this.scale = this.scaleStd = null;
    element("points").value = element("length").value = "";
    this.stage.marks.scale = [];
    this.showScale();
    this.stage.draw();
    this.send();
  }

  showScale() {
    const own = this.scale ?? this.given.scale;
    const error = this.scale != null ? this.scaleStd : this.given.scale_std;
    const from = this.scale == null && own != null ? " (camera.json)" : "";
    element("scale").textContent = own == null
      ? "not set"
      : `${rounded(own * 1e3, 5)}${error ? ` ± ${rounded(error * 1e3, 2)}` : ""} mm/px${from}`;
    element("no-scale").hidden = this.scale == null;
  }

  addTypedBall() {
    const text = element("new-ball").value.trim();
    if (!text) return;
    this.addBall(text);
    element("new-ball").value = "";
  }

  addBall(text) {
    this.ballTexts.push(text);
    this.listBalls();
    this.send();
  }

  listBalls() {
    element("balls").replaceChildren(...this.ballTexts.map((text, k) => {
      const item = document.createElement("li"), button = document.createElement("button");
      item.append(text);
      button.type = "button";
      button.textContent = "Remove";
      button.setAttribute("aria-label", `Remove ball ${text}`);
      button.addEventListener("click", () => {
        this.ballTexts.splice(k, 1);
        this.listBalls();
        this.send();
      });
      item.append(button);
      return item;
    }));
    this.markHints();
  }

  markHints() {
    const parse = (text) => {
      const found = /^([\d.]+),([\d.]+)(?:,([\d.]+))?@(\d+)$/.exec(text.replaceAll(" ", ""));
      return found && { x: Number(found[1]), y: Number(found[2]), radius: found[3] && Number(found[3]), frame: Number(found[4]) };
    };
    this.stage.marks.hints = this.ballTexts.map(parse).filter((hint) => hint && hint.frame === this.player.number);
    this.stage.draw();
  }

  markRegion() {
    const parse = (text) => {
      const out = text.trim().startsWith("not "), words = text.trim().replace(/^not /, "").split(/\s+/);
      const points = words.map((word) => word.split(",").map(Number));
      const [x0, y0, x1, y1] = points[0];
      return { out, corners: points[0].length === 4 ? cornersOfBox([x0, y0], [x1, y1]) : points };
    };
    const parts = element("region").value.split(";").map(parse);
    this.stage.marks.regions = parts.filter(({ corners }) => corners.length > 2 && corners.flat().every(Number.isFinite));
    element("no-region").hidden = element("region").value === "";
    this.stage.draw();
  }

  collect() {
    const number = (id, name, factor = 1) => { // what nobody has typed over stays as it was, with all its digits
      const text = element(id).value;
      if (text === this.loaded[id]) return this.settings[name];
      return text === "" ? null : rounded(Number(text) * factor, 12);
    };
    const [first, last] = [element("first").value, element("last").value];
    const channel = this.player.look.channel;
    return {
      scale: this.scale,
      scale_std: this.scaleStd,
      fps: number("fps", "fps"),
      ball_diameter: number("diameter", "ball_diameter", 1e-3),
      exposure: number("exposure", "exposure", 1e-3),
      balls: this.ballTexts,
      region: element("region").value.trim(),
      colour: element("colour").value.trim(),
      frames: first || last ? `${first}:${last}` : "",
      channel: element("search-channel").checked && channel !== "colour film" ? channel : "",
    };
  }

  async apply() {
    try {
      this.showPlan(await post("/api/settings", this.collect()));
      element("settings-error").textContent = "";
    } catch (error) {
      element("settings-error").textContent = error.message;
    }
  }

  showPlan(plan) {
    element("command").textContent = plan.command;
    element("camera-box").hidden = plan.camera == null;
    element("run-note").hidden = plan.camera != null;
    element("camera").textContent = plan.camera ?? "";
  }

  async copy(button) {
    const text = element(button.dataset.copy);
    try {
      await navigator.clipboard.writeText(text.textContent);
      button.textContent = "Copied";
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    } catch { // without a right to the clipboard the text is selected
      getSelection().selectAllChildren(text);
    }
  }
}
