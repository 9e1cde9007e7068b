// The picture: zoom and pan, marks drawn over it, and presses as positions in the film (pixel centres at whole numbers).

const BALL = "#E69F00", HINT = "#56B4E9", SCALE = "#009E73", REGION = "#F0E442", LEFT_OUT = "#D55E00", CROSS = "#CC79A7";
export const TRACKS = ["#56B4E9", "#F0E442", "#009E73", "#D55E00", "#CC79A7"];
const DASHES = [[], [8, 4], [2, 3]];
const ARROWS = { fit: { colour: CROSS, head: true }, before: { colour: "#D55E00", head: true }, after: { colour: "#FFF", head: false } };

export const cornersOfBox = ([x0, y0], [x1, y1]) => [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];

export class Stage extends EventTarget {
  constructor(canvas) {
    super();
    this.canvas = canvas;
    this.size = [1, 1];
    this.zoom = 1; // screen pixels (CSS) per film pixel
    this.at = [0, 0]; // film position in the upper left corner
    this.fitted = true;
    this.picture = null;
    this.marks = { balls: [], radius: 8, hints: [], scale: [], regions: [], polygon: [], pending: null, tape: [], points: [], tracks: [], showTracks: true, showArrows: false, arrows: [], chosen: null };
    this.frame = 0; // number of the frame in view
    this.cross = null;
    this.tool = "look";
    this.pointers = new Map();
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("wheel", (event) => this.onWheel(event), { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.onDown(event));
    canvas.addEventListener("pointermove", (event) => this.onMove(event));
    canvas.addEventListener("pointerup", (event) => this.onUp(event));
    canvas.addEventListener("pointercancel", (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("focus", () => this.draw());
    canvas.addEventListener("blur", () => this.draw());
  }

  open(size) {
    this.size = size;
    this.cross = [Math.round(size[0] / 2), Math.round(size[1] / 2)];
    this.fit();
  }

  show(picture) {
    this.picture?.close();
    this.picture = picture;
    this.draw();
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(this.canvas.clientWidth * ratio);
    this.canvas.height = Math.round(this.canvas.clientHeight * ratio);
    if (this.fitted) this.fit();
    else this.draw();
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.zoom = Math.max(Math.min(width / this.size[0], height / this.size[1]), 1e-3);
    this.at = [(this.size[0] - width / this.zoom) / 2 - 0.5, (this.size[1] - height / this.zoom) / 2 - 0.5];
    this.fitted = true;
    this.changeView();
  }

  changeView() {
    this.dispatchEvent(new Event("view"));
    this.draw();
  }

  // Film pixels per pixel of the picture that suffice here.
  get reduction() {
    const wanted = 1 / (this.zoom * (window.devicePixelRatio || 1));
    return Math.min(2 ** Math.max(Math.floor(Math.log2(wanted)), 0), 16);
  }

  // What the keys zoom to: the cross where it is shown, else the middle.
  get middle() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const [x, y] = this.toScreen(this.cross), shown = x >= 0 && x <= width && y >= 0 && y <= height;
    return document.activeElement === this.canvas && shown ? [x, y] : [width / 2, height / 2];
  }

  zoomBy(factor, about = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    const film = this.toFilm(about);
    this.zoom = Math.min(Math.max(this.zoom * factor, 0.02), 80);
    this.at = [film[0] - about[0] / this.zoom, film[1] - about[1] / this.zoom];
    this.fitted = false;
    this.changeView();
  }

  toFilm([x, y]) { return [this.at[0] + x / this.zoom, this.at[1] + y / this.zoom]; }
  toScreen([x, y]) { return [(x - this.at[0]) * this.zoom, (y - this.at[1]) * this.zoom]; }

  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  onWheel(event) {
    event.preventDefault();
    const steps = event.deltaMode === 1 ? event.deltaY * 30 : event.deltaY;
    this.zoomBy(Math.exp(-steps * 0.0015), this.place(event));
  }

  onDown(event) {
    this.canvas.setPointerCapture(event.pointerId);
    const place = this.place(event);
    this.pointers.set(event.pointerId, place);
    this.down = { place, film: this.toFilm(place), moved: false, pinched: this.pointers.size > 1 };
  }

  onMove(event) {
    const place = this.place(event), before = this.pointers.get(event.pointerId);
    if (!before) { this.point(this.toFilm(place)); return; }
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const span = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]) || 1;
      this.zoomBy(span(place) / span(before), other);
    } else {
      this.down.moved ||= Math.hypot(place[0] - this.down.place[0], place[1] - this.down.place[1]) > 5;
      if (this.down.moved && (this.tool === "look" || this.tool === "ball")) {
        this.at = [this.at[0] - (place[0] - before[0]) / this.zoom, this.at[1] - (place[1] - before[1]) / this.zoom];
        this.fitted = false;
        this.changeView();
      }
    }
    this.pointers.set(event.pointerId, place);
    this.point(this.toFilm(place));
  }

  onUp(event) {
    if (!this.pointers.delete(event.pointerId) || !this.down || this.down.pinched) return;
    const film = this.toFilm(this.place(event)), drags = ["scale", "region", "tape"].includes(this.tool);
    if (!this.down.moved) this.press(film, event.shiftKey);
    else if (drags) { this.press(this.down.film); this.press(film); }
  }

  // The pointer, or the cross, is over a position of the film.
  point(film) {
    this.cross = film;
    this.dispatchEvent(new CustomEvent("point", { detail: film }));
    if (this.marks.pending || this.marks.polygon.length || document.activeElement === this.canvas) this.draw();
  }

  // shift: whether that key is held
  press(at, shift = false) { this.dispatchEvent(new CustomEvent("press", { detail: { at, shift } })); }

  moveCross(right, down) {
    const [width, height] = this.size, [x, y] = this.cross;
    this.point([Math.min(Math.max(Math.round(x) + right, 0), width - 1), Math.min(Math.max(Math.round(y) + down, 0), height - 1)]);
    this.draw();
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.paint(); });
  }

  paint() {
    const pen = this.canvas.getContext("2d"), ratio = window.devicePixelRatio || 1;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.imageSmoothingEnabled = this.zoom < 3;
    const [left, top] = this.toScreen([-0.5, -0.5]);
    if (this.picture) pen.drawImage(this.picture, left, top, this.size[0] * this.zoom, this.size[1] * this.zoom);
    const { balls, radius, hints, scale, regions, polygon, pending } = this.marks;
    if (this.marks.showTracks) this.marks.tracks.forEach((track, k) => this.drawTrack(pen, track, k));
    if (this.marks.showArrows) for (const { tracks, look } of this.marks.arrows) for (const track of tracks) this.drawArrows(pen, track, look);
    if (this.marks.chosen) this.drawChosen(pen, this.marks.chosen);
    for (const ball of balls) this.ring(pen, ball, radius, BALL, []);
    for (const hint of hints) this.ring(pen, hint, hint.radius ?? radius, HINT, [6, 4]);
    for (const point of this.marks.points) this.ring(pen, point, 4 / this.zoom, SCALE, [2, 2]);
    for (const { corners, out } of regions) this.outline(pen, corners, out ? LEFT_OUT : REGION, out);
    if (polygon.length) this.outline(pen, [...polygon, this.cross], REGION);
    if (scale.length === 2) this.line(pen, scale[0], scale[1]);
    if (this.marks.tape.length === 2) this.line(pen, ...this.marks.tape, HINT);
    if (pending && this.tool === "scale") this.line(pen, pending, this.cross);
    if (pending && this.tool === "tape") this.line(pen, pending, this.cross, HINT);
    if (pending && this.tool === "region") this.outline(pen, cornersOfBox(pending, this.cross), REGION);
    if (document.activeElement === this.canvas && this.cross) this.drawCross(pen);
  }

  stroke(pen, colour, path, dash = []) {
    pen.lineJoin = "round"; // else the scatter of a ball at rest has spikes
    for (const [style, width] of [["#000", 4], [colour, 2]]) { // a dark rim shows on bright films
      pen.setLineDash(dash);
      pen.strokeStyle = style;
      pen.lineWidth = width;
      pen.beginPath();
      path();
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  // A track: a line through all its positions, and its number beside the one of this frame.
  drawTrack(pen, { particle, frame, x, y }, k) {
    this.stroke(pen, TRACKS[k % TRACKS.length], () => {
      frame.forEach((_, row) => pen.lineTo(...this.toScreen([x[row], y[row]])));
    }, DASHES[k % DASHES.length]);
    const row = frame.indexOf(this.frame);
    if (row < 0) return;
    const [left, top] = this.toScreen([x[row], y[row]]), away = Math.max(this.marks.radius * this.zoom, 5) + 4;
    pen.font = "600 14px sans-serif";
    pen.lineWidth = 4;
    pen.strokeStyle = "#000";
    pen.fillStyle = "#fff";
    pen.strokeText(particle, left + away, top - away / 2);
    pen.fillText(particle, left + away, top - away / 2);
  }

  // The residuals of a track, from its positions: the longest of all arrows is as long as three radii.
  drawArrows(pen, { x, y, x_off: right, y_off: down }, look) {
    const longest = this.marks.longest || 1, scale = (3 * Math.max(this.marks.radius, 5)) / longest;
    const { colour, head } = ARROWS[look];
    this.stroke(pen, colour, () => {
      x.forEach((_, row) => {
        if (right[row] == null) return;
        const from = this.toScreen([x[row], y[row]]), to = this.toScreen([x[row] + scale * right[row], y[row] + scale * down[row]]);
        pen.moveTo(...from);
        pen.lineTo(...to);
        if (head) this.addHead(pen, from, to);
        if (Math.hypot(to[0] - from[0], to[1] - from[1]) < 3) pen.rect(from[0] - 0.5, from[1] - 0.5, 1, 1); // still seen
      });
    });
  }

  // The head of an arrow that is long enough to have one.
  addHead(pen, from, to) {
    const [right, down] = [to[0] - from[0], to[1] - from[1]], length = Math.hypot(right, down), size = Math.min(length / 3, 7);
    if (length < 8) return;
    const [a, b] = [(size * right) / length, (size * down) / length];
    pen.moveTo(to[0] - a + b / 2, to[1] - b - a / 2);
    pen.lineTo(...to);
    pen.lineTo(to[0] - a - b / 2, to[1] - b + a / 2);
  }

  // The position that a correction is about: a square.
  drawChosen(pen, [x, y]) {
    const [left, top] = this.toScreen([x, y]), half = Math.max(this.marks.radius * this.zoom, 5) + 5;
    this.stroke(pen, CROSS, () => pen.rect(left - half, top - half, 2 * half, 2 * half));
  }

  ring(pen, ball, radius, colour, dash) {
    const [x, y] = this.toScreen([ball.x, ball.y]), size = Math.max(radius * this.zoom, 5);
    this.stroke(pen, colour, () => {
      pen.arc(x, y, size, 0, 2 * Math.PI);
      pen.moveTo(x - 2, y);
      pen.lineTo(x + 2, y);
    }, dash);
  }

  line(pen, from, to, colour = SCALE) {
    const [a, b] = [this.toScreen(from), this.toScreen(to)];
    const long = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1, across = [-(b[1] - a[1]) / long * 7, (b[0] - a[0]) / long * 7];
    this.stroke(pen, colour, () => {
      pen.moveTo(...a);
      pen.lineTo(...b);
      for (const [x, y] of [a, b]) {
        pen.moveTo(x - across[0], y - across[1]);
        pen.lineTo(x + across[0], y + across[1]);
      }
    });
  }

  // A closed outline; what is left out has short dashes.
  outline(pen, corners, colour, out = false) {
    this.stroke(pen, colour, () => {
      for (const corner of corners) pen.lineTo(...this.toScreen(corner));
      pen.closePath();
    }, out ? [3, 3] : [10, 5]);
  }

  drawCross(pen) {
    const [x, y] = this.toScreen(this.cross);
    this.stroke(pen, CROSS, () => {
      for (const [right, down] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        pen.moveTo(x + 4 * right, y + 4 * down);
        pen.lineTo(x + 14 * right, y + 14 * down);
      }
    });
  }
}
