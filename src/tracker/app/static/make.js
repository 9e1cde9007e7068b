// Scenes of synthcam: sliders move their numbers, the picture follows, and a dataset is made of them.

import { newestOnly, post } from "/static/api.js";
import { Stage } from "/static/stage.js";

const element = (id) => document.getElementById(id);
const STEPS = 200; // of a slider
const shown = (value) => Number(value.toPrecision(4));

export class Make {
  constructor() {
    this.stage = new Stage(element("preview"));
    this.values = {};
    this.frame = null;
    this.ask = newestOnly((sharp) => this.draw(sharp));
    element("scene").addEventListener("change", () => this.reset());
    element("reset").addEventListener("click", () => this.reset());
    element("make-seed").addEventListener("input", () => this.ask(false));
    element("full-size").addEventListener("click", () => this.ask(true));
    element("make-frame").addEventListener("input", () => { this.frame = Number(element("make-frame").value); this.ask(false); });
    element("before-contact").addEventListener("click", () => { this.frame = null; this.ask(false); });
    element("make-paths").addEventListener("change", () => { this.stage.marks.showTracks = element("make-paths").checked; this.stage.draw(); });
    element("generate").addEventListener("click", () => this.generate());
    element("make-cancel").addEventListener("click", () => post("/api/cancel").catch((error) => this.tell(error.message)));
  }

  tell(text) { element("make-error").textContent = text; }

  async open() {
    if (element("scene").options.length) return;
    element("make-state").textContent = "Starting synthcam …";
    try {
      const { scenes } = await post("/api/preview", {});
      element("scene").replaceChildren(...scenes.map((name) => new Option(name.replaceAll("_", " "), name)));
      element("scene").value = scenes.includes("oblique") ? "oblique" : scenes[0];
      this.reset();
    } catch (error) {
      element("make-state").textContent = "";
      this.tell(error.message);
    }
  }

  reset() {
    this.values = {};
    this.frame = null;
    element("sliders").replaceChildren();
    this.ask(false);
  }

  get request() {
    return { scene: element("scene").value, values: this.values, seed: Number(element("make-seed").value) };
  }

  async draw(sharp) {
    const began = performance.now();
    element("make-state").textContent = "Drawing …";
    try {
      const answer = await post("/api/preview", { ...this.request, frame: this.frame, sharp });
      const bytes = Uint8Array.from(atob(answer.picture), (character) => character.charCodeAt(0));
      const picture = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
      if (String(this.stage.size) !== String(answer.size)) this.stage.open(answer.size);
      this.stage.marks.tracks = answer.paths.map((path, k) => ({
        particle: k, frame: path.map((_, row) => row), x: path.map(([x]) => x), y: path.map(([, y]) => y),
      }));
      this.stage.frame = -1;
      this.stage.show(picture);
      this.show(answer);
      this.tell(answer.hint);
      element("preview").dataset.ms = Math.round(performance.now() - began); // for tests
      element("make-state").textContent = answer.sharp ? "" : "Drawn small, to be quick.";
    } catch (error) {
      element("make-state").textContent = "";
      this.tell(error.message);
    }
    element("preview").dataset.drawn = Number(element("preview").dataset.drawn ?? 0) + 1;
  }

  show({ sliders, used, yaml, frame, frames, sharp }) {
    if (!element("sliders").children.length) element("sliders").replaceChildren(...sliders.map((slider) => this.build(slider)));
    for (const row of element("sliders").children) row.classList.toggle("unused", !used.includes(row.dataset.name));
    element("yaml").textContent = yaml;
    element("full-size").disabled = sharp;
    element("make-frame").max = frames - 1;
    element("make-frame").value = frame;
    element("make-frame-number").textContent = `${frame} / ${frames - 1}`;
  }

  // A slider and a field with the same number.
  build({ name, label, unit, value, low, high, whole }) {
    const row = document.createElement("div"), text = document.createElement("label");
    const range = document.createElement("input"), field = document.createElement("input");
    row.className = "slider";
    row.dataset.name = name;
    text.textContent = unit ? `${label}, ${unit}` : label;
    text.htmlFor = range.id = `slider-${name}`;
    const step = whole ? 1 : (high - low) / STEPS;
    Object.assign(range, { type: "range", min: low, max: high, step, value });
    Object.assign(field, { type: "number", min: low, max: high, step: whole ? 1 : "any", value: shown(value) });
    field.setAttribute("aria-label", `${text.textContent}, as a number`);
    const move = (number) => { this.values[name] = number; this.ask(false); };
    range.addEventListener("input", () => { field.value = shown(Number(range.value)); move(Number(range.value)); });
    field.addEventListener("input", () => { if (field.value !== "") { range.value = field.value; move(Number(field.value)); } });
    row.append(text, range, field);
    return row;
  }

  async generate() {
    this.tell("");
    element("generate").disabled = true;
    try {
      this.follow(await post("/api/generate", { ...this.request, clips: Number(element("make-clips").value) }));
    } catch (error) {
      element("generate").disabled = false;
      this.tell(error.message);
    }
  }

  // The state of what the server runs, as it concerns this view.
  follow({ run }) {
    const running = run.state === "running", own = run.command === "generate", progress = element("make-progress");
    element("generate").disabled = running;
    element("make-cancel").hidden = progress.hidden = !(running && own);
    if (running && own && run.total) Object.assign(progress, { max: run.total, value: run.done });
    else progress.removeAttribute("value");
    const words = { running: `Making clips${run.total ? ` ${run.done} of ${run.total}` : ""}`, cancelled: "Cancelled.", failed: run.error };
    element("generate-state").textContent = own ? words[run.state] ?? "" : running ? "A run is under way." : "";
    element("generate-state").className = own && run.state === "failed" ? "error" : "";
  }
}
