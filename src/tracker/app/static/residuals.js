// The residuals by frame, to be clicked: dots along x, squares along y, in the colours of the tracks over the film.

import { TRACKS } from "/static/stage.js";

const MARGIN = 8;

export class ResidualPlot extends EventTarget {
  constructor(player) {
    super();
    this.player = player;
    this.tracks = [];
    this.canvas = document.getElementById("residuals");
    this.note = document.getElementById("residuals-note");
    new ResizeObserver(() => this.paint()).observe(this.canvas);
    this.canvas.addEventListener("click", (event) => this.press(event.offsetX, event.offsetY));
    player.addEventListener("frame", () => this.paint());
  }

  show(tracks, name) {
    this.tracks = tracks;
    const all = tracks.flatMap((track) => [...track.x_off_um, ...track.y_off_um]).filter((v) => v != null);
    this.most = Math.max(...all.map(Math.abs), 1e-9);
    this.canvas.dataset.points = all.length; // for tests and screen readers
    this.canvas.hidden = all.length === 0;
    const frames = tracks.flatMap((track) => track.frame);
    this.span = [Math.min(...frames), Math.max(...frames, 1)];
    this.note.textContent = all.length
      ? `Residuals (${name}) up to ${Number(this.most.toPrecision(2))} µm, dots along x, squares along y. A click shows the frame.`
      : "No fit, so that there are no residuals.";
    this.paint();
  }

  place(frame, value) {
    const { clientWidth: width, clientHeight: height } = this.canvas, [first, last] = this.span;
    const x = MARGIN + ((frame - first) / Math.max(last - first, 1)) * (width - 2 * MARGIN);
    return [x, height / 2 - (value / this.most) * (height / 2 - MARGIN)];
  }

  * points() {
    for (const [k, track] of this.tracks.entries()) {
      for (const [row, frame] of track.frame.entries()) {
        for (const axis of ["x", "y"]) {
          const value = track[`${axis}_off_um`][row];
          if (value != null) yield { k, axis, frame, particle: track.particle, at: this.place(frame, value) };
        }
      }
    }
  }

  press(x, y) {
    let best = null, least = 30;
    for (const point of this.points()) {
      const away = Math.hypot(point.at[0] - x, point.at[1] - y);
      if (away < least) [best, least] = [point, away];
    }
    if (best) this.dispatchEvent(new CustomEvent("choose", { detail: best }));
  }

  paint() {
    const ratio = window.devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = this.canvas;
    if (!this.tracks.length || !width) return;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.strokeStyle = getComputedStyle(this.canvas).color;
    const now = this.place(this.player.number, 0)[0];
    for (const [from, to] of [[[0, height / 2], [width, height / 2]], [[now, 0], [now, height]]]) {
      pen.beginPath();
      pen.moveTo(...from);
      pen.lineTo(...to);
      pen.stroke();
    }
    for (const { k, axis, at: [x, y] } of this.points()) {
      pen.fillStyle = pen.strokeStyle = TRACKS[k % TRACKS.length];
      pen.beginPath();
      if (axis === "x") pen.arc(x, y, 2.2, 0, 2 * Math.PI);
      else pen.rect(x - 2.2, y - 2.2, 4.4, 4.4);
      if (axis === "x") pen.fill();
      else pen.stroke();
    }
  }
}
