// Corrections of tracks: the server keeps them in a file of edits, and shows the tracks as they leave them.

import { get, post } from "/static/api.js";

const element = (id) => document.getElementById(id);
const WORDS = {
  remove_point: (e) => `point of ball ${e.ball} in frame ${e.frame} removed`,
  remove_track: (e) => `track of ball ${e.ball} removed`,
  exchange: (e) => `balls ${e.ball} and ${e.other} exchanged from frame ${e.frame} on`,
  add_point: (e) => `point of ball ${e.ball} in frame ${e.frame} added at ${e.x}, ${e.y} ± ${e.error} px`,
  mark_contact: (e) => `contact of balls ${e.ball} and ${e.other} in frame ${e.frame} marked`,
};

export class Mending {
  constructor(stage, player, pointing, inspector, plot, arrows) {
    Object.assign(this, { stage, player, pointing, arrows, tracks: [] });
    inspector.findTracked = (place) => this.find(place);
    const frame = () => player.number, ball = () => Number(element("mend-ball").value);
    const other = () => this.read("mend-other", "Type the number of the other ball.");
    const orders = {
      "remove-point": () => ({ action: "remove_point", ball: ball(), frame: frame() }),
      "remove-track": () => ({ action: "remove_track", ball: ball() }),
      exchange: () => ({ action: "exchange", ball: ball(), other: other(), frame: frame() }),
      "mark-contact": () => ({ action: "mark_contact", ball: ball(), other: other(), frame: frame() }),
      "add-point": () => {
        const [x, y] = element("mend-at").value.split(/[\s,;]+/).map(Number);
        if (!Number.isFinite(x) || !Number.isFinite(y)) throw new Error("Choose Mend and click the place of the point, or type it.");
        return { action: "add_point", ball: ball(), frame: frame(), x, y, error: this.read("mend-error", "Type the error of the point, px.") };
      },
    };
    this.addPoint = () => this.send(() => ({ edit: orders["add-point"]() }));
    for (const [id, make] of Object.entries(orders)) {
      element(id).addEventListener("click", () => this.send(() => ({ edit: make() })));
    }
    for (const step of ["undo", "redo"]) element(step).addEventListener("click", () => this.send(() => ({ step })));
    element("mend-ball").addEventListener("change", () => this.mark());
    element("show-tracks").addEventListener("change", () => { stage.marks.showTracks = element("show-tracks").checked; stage.draw(); });
    stage.addEventListener("mend", (event) => this.click(event.detail));
    player.addEventListener("frame", () => this.mark());
    plot.addEventListener("choose", ({ detail }) => {
      element("mend-ball").value = detail.particle;
      player.go(player.indexOf(detail.frame));
    });
  }

  read(id, sentence) {
    if (element(id).value === "") throw new Error(sentence);
    return Number(element(id).value);
  }

  async load() {
    try {
      this.show(await get("/api/tracks"));
    } catch (error) {
      this.clear();
      element("mend-message").textContent = error.message;
    }
  }

  async send(make) {
    try {
      const answer = await post("/api/edits", make());
      this.show(answer);
      this.pointing.showPlan(answer.plan);
      element("mend-message").textContent = "";
      return true;
    } catch (error) {
      element("mend-message").textContent = error.message;
      return false;
    }
  }

  show({ tracks, edits, can_redo: canRedo, pending }) {
    this.tracks = this.stage.marks.tracks = tracks;
    for (const choice of document.querySelectorAll(".tracks-choice")) choice.hidden = false;
    element("mend-box").hidden = false;
    const before = element("mend-ball").value, numbers = tracks.map((track) => track.particle);
    const free = Math.max(-1, ...numbers) + 1;
    element("mend-ball").replaceChildren(...numbers.map((n) => new Option(n, n)), new Option(`${free} (new)`, free));
    if (numbers.includes(Number(before)) && before !== "") element("mend-ball").value = before;
    element("undo").disabled = edits.length === 0;
    element("redo").disabled = !canRedo;
    element("mend-state").textContent = pending == null
      ? "No results fit to these edits. Track again."
      : pending ? `${pending} correction${pending > 1 ? "s" : ""} since the run. Track again.` : "";
    element("edits").replaceChildren(...edits.map((edit) => {
      return Object.assign(document.createElement("li"), { textContent: WORDS[edit.action](edit) });
    }));
    this.arrows.take(tracks);
    this.mark();
  }

  // Another clip has other tracks.
  clear() {
    this.tracks = this.stage.marks.tracks = [];
    this.stage.marks.chosen = null;
    this.arrows.clear();
    for (const choice of document.querySelectorAll(".tracks-choice")) choice.hidden = true;
    element("mend-box").hidden = true;
    this.stage.draw();
  }

  // The row of a track in the frame in view.
  at(track) {
    const row = track.frame.indexOf(this.player.number);
    if (row < 0) return null;
    const { particle, frame, ...columns } = track;
    return { particle, ...Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, values[row]])) };
  }

  // The position of a track in this frame that is nearest to a place, within its radius or 12 pixels of the screen.
  find([x, y]) {
    const reach = Math.max(this.stage.marks.radius, 12 / this.stage.zoom);
    const here = this.tracks.map((track) => this.at(track)).filter(Boolean);
    const away = (point) => Math.hypot(point.x - x, point.y - y);
    const near = here.filter((point) => away(point) <= reach);
    return near.sort((a, b) => away(a) - away(b))[0] ?? null;
  }

  async click({ at: place, shift }) {
    if (shift && !element("mend-box").hidden) {
      element("mend-at").value = place.map((v) => v.toFixed(1)).join(",");
      const index = this.player.index;
      if (await this.addPoint() && this.player.index === index) this.player.go(index + 1);
      return;
    }
    const near = this.find(place);
    if (near) element("mend-ball").value = near.particle;
    else element("mend-at").value = place.map((v) => v.toFixed(1)).join(",");
    this.mark();
  }

  mark() {
    const track = this.tracks.find(({ particle }) => particle === Number(element("mend-ball").value));
    const point = track && this.at(track);
    this.stage.marks.chosen = point ? [point.x, point.y] : null;
    element("mend-point").textContent = !track ? "" : point ? `frame ${this.player.number}: ${point.x.toFixed(1)}, ${point.y.toFixed(1)}` : "not in this frame";
    element("remove-point").disabled = !point;
    element("remove-track").disabled = !track;
    this.stage.draw();
  }

  press(id) { if (!element("mend-box").hidden && !element(id).disabled) element(id).click(); }

  chooseNext() {
    const choice = element("mend-ball");
    if (choice.options.length) choice.selectedIndex = (choice.selectedIndex + 1) % choice.options.length;
    this.mark();
  }

  addAtCross() {
    if (element("mend-box").hidden) return;
    element("mend-at").value = this.stage.cross.map((v) => v.toFixed(1)).join(",");
    this.press("add-point");
  }
}
