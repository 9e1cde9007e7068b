// The frame in view: slider, play and pause, and requests for pictures, of which the newest wins.

import { AskedAhead, frameAddress, newestOnly } from "/static/api.js";

const SHORTEST_FRAME_MS = 40;
const LONGEST_STEP = 10; // frames; what is further away is a jump, which nothing predicts

async function fetchBitmap(address) {
  const response = await fetch(address);
  if (!response.ok) throw new Error((await response.json()).error);
  return createImageBitmap(await response.blob());
}

export class Player extends EventTarget {
  constructor(stage, film, tell) {
    super();
    this.stage = stage;
    this.tell = tell;
    this.look = { low: 0, high: 1 };
    this.index = this.step = 0;
    this.pictures = new AskedAhead(fetchBitmap);
    this.playing = false;
    this.slider = document.getElementById("frame");
    this.label = document.getElementById("frame-number");
    this.button = document.getElementById("play");
    this.load = newestOnly((...values) => this.fetchPicture(...values));
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
    this.button.addEventListener("click", () => this.toggle());
    stage.addEventListener("view", () => { if (stage.reduction < this.shownReduction) this.show(); });
    this.open(film);
  }

  open(film) {
    this.film = film;
    Object.assign(this.look, { channel: film.channels[0], mark: film.mark }); // the mark tells films apart in the cache
    this.slider.max = film.frames - 1;
    this.shownReduction = 1;
    this.stage.open(film.size);
    this.go(0);
  }

  get number() { return this.film.numbers ? this.film.numbers[this.index] : this.index; }

  indexOf(number) {
    return this.film.numbers ? this.film.numbers.indexOf(number) : number;
  }

  go(index) {
    const before = this.index;
    this.index = Math.min(Math.max(index, 0), this.film.frames - 1);
    this.step = this.index - before;
    this.slider.value = this.index;
    this.slider.setAttribute("aria-valuetext", `frame ${this.number}`);
    this.label.textContent = `${this.number} / ${this.film.numbers ? this.film.numbers.at(-1) : this.film.frames - 1}`;
    return this.show();
  }

  show() {
    this.stage.frame = this.number;
    this.dispatchEvent(new Event("frame"));
    return this.load(this.index, this.stage.reduction);
  }

  async fetchPicture(index, reduce) {
    try {
      this.stage.show(await this.pictures.take(frameAddress(index, { ...this.look, reduce })));
      this.shownReduction = reduce;
      this.shown = index;
      this.dispatchEvent(new Event("picture"));
    } catch (error) {
      this.tell(`Frame ${index} cannot be shown: ${error.message}`);
    }
  }

  // The frame to which the next step of the same kind leads; null where none is likely.
  get next() {
    const next = this.index + this.step, steps = this.step !== 0 && Math.abs(this.step) <= LONGEST_STEP;
    return steps && next >= 0 && next < this.film.frames ? next : null;
  }

  prepareNext() {
    if (this.next !== null) this.pictures.prepare(frameAddress(this.next, { ...this.look, reduce: this.stage.reduction }));
  }

  toggle() {
    this.playing = !this.playing;
    this.button.textContent = this.playing ? "Pause" : "Play";
    this.button.setAttribute("aria-pressed", this.playing);
    if (this.playing) this.play();
  }

  async play() {
    while (this.playing) {
      const began = performance.now();
      await this.go(this.index + 1 < this.film.frames ? this.index + 1 : 0);
      const left = SHORTEST_FRAME_MS - (performance.now() - began);
      await new Promise((done) => setTimeout(done, Math.max(left, 0)));
    }
  }
}
