// The ball under the pointer: its numbers, and a magnified picture of the film there.

import { frameAddress, newestOnly } from "/static/api.js";

const LEAST_SIDE = 21, MOST_SIDE = 99; // film pixels of the magnified picture

export class Inspector {
  constructor(stage, player) {
    this.stage = stage;
    this.player = player;
    this.canvas = document.getElementById("crop");
    this.list = document.getElementById("ball");
    this.magnify = newestOnly((...values) => this.fetchCrop(...values));
    this.point = "centre";
    this.inMillimetres = () => ""; // a length in px by the scale
    this.findTracked = () => null; // the position of a track near a place of this frame
    stage.addEventListener("point", (event) => this.look(event.detail));
  }

  // The nearest ball within its radius, or within 12 pixels of the screen.
  find([x, y]) {
    const { balls, radius } = this.stage.marks, reach = Math.max(radius, 12 / this.stage.zoom);
    let best = null, least = reach;
    for (const ball of balls) {
      const away = Math.hypot(ball.x - x, ball.y - y);
      if (away <= least) [best, least] = [ball, away];
    }
    return best;
  }

  diameter() {
    const pixels = 2 * this.stage.marks.radius;
    return `${pixels.toFixed(1)} px${this.inMillimetres(pixels)}`;
  }

  look(place = this.last) {
    if (!place) return;
    this.last = place;
    const ball = this.find(place);
    this.describe(ball);
    this.magnify(ball ? [ball.x, ball.y] : place, ball);
  }

  describe(ball) {
    const place = this.last.map((v) => v.toFixed(1)).join(", ");
    const rows = ball ? [
      [this.point === "glint" ? "Glint at" : "Centre at", `${ball.x.toFixed(2)}, ${ball.y.toFixed(2)} px`],
      ["Error", `${ball.x_std.toPrecision(2)}, ${ball.y_std.toPrecision(2)} px`],
      ["Correlation", ball.correlation.toFixed(2)],
      [this.point === "glint" ? "Light" : "Area", `${ball.flux} ${this.point === "glint" ? "counts" : "px²"}`],
      ...(this.point === "glint" ? [] : [["Diameter", this.diameter()]]),
      ["Flags", ball.flags.join(", ") || "none"],
    ] : [["Pointer", `${place} px`], ["Ball", "none here"]];
    const tracked = this.findTracked(this.last);
    if (tracked) {
      rows.push(["Track", `ball ${tracked.particle}${tracked.flags ? ` (${tracked.flags.replaceAll("|", ", ")})` : ""}`]);
      if (tracked.x_off_um != null) rows.push(["Residual", `${tracked.x_off_um.toFixed(1)}, ${tracked.y_off_um.toFixed(1)} µm`]);
    }
    this.list.replaceChildren(...rows.flatMap(([name, value]) => {
      const term = document.createElement("dt"), text = document.createElement("dd");
      term.textContent = name;
      text.textContent = value;
      return [term, text];
    }));
  }

  async fetchCrop([x, y], ball) {
    const half = Math.min(Math.max(Math.ceil(1.6 * this.stage.marks.radius), (LEAST_SIDE - 1) / 2), (MOST_SIDE - 1) / 2);
    const [width, height] = this.stage.size, side = Math.min(2 * half + 1, width, height);
    const left = Math.min(Math.max(Math.round(x) - half, 0), width - side);
    const top = Math.min(Math.max(Math.round(y) - half, 0), height - side);
    const look = { ...this.player.look, box: [left, top, side, side].join(",") };
    const response = await fetch(frameAddress(this.player.index, look, "png"));
    if (!response.ok) return;
    const picture = await createImageBitmap(await response.blob());
    const pen = this.canvas.getContext("2d"), scale = this.canvas.width / side;
    pen.imageSmoothingEnabled = false;
    pen.drawImage(picture, 0, 0, this.canvas.width, this.canvas.height);
    picture.close();
    if (!ball) return;
    const at = [(ball.x - left + 0.5) * scale, (ball.y - top + 0.5) * scale];
    pen.lineWidth = 1.5;
    pen.strokeStyle = "#E69F00";
    pen.beginPath();
    pen.moveTo(at[0] - 8, at[1]);
    pen.lineTo(at[0] + 8, at[1]);
    pen.moveTo(at[0], at[1] - 8);
    pen.lineTo(at[0], at[1] + 8);
    pen.stroke();
  }
}
