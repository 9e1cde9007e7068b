// Residuals as arrows over the film, with a legend: of the tied fit, or of a search without and with what it found.

import { get } from "/static/api.js";

const element = (id) => document.getElementById(id);
const BOTH = "both models", FIT = "tied fit";
const longestOf = (tracks) => Math.max(0, ...tracks.flatMap((t) => t.x_off.map((v, k) => (v == null ? 0 : Math.hypot(v, t.y_off[k])))));
const inMicrometres = (tracks) => Math.max(0, ...tracks.flatMap((t) => t.x_off_um.map((v, k) => (v == null ? 0 : Math.hypot(v, t.y_off_um[k])))));

export class Arrows {
  constructor(stage, plot) {
    Object.assign(this, { stage, plot, fit: [], models: [], note: "", turn: 0 });
    element("show-arrows").addEventListener("change", () => this.show());
    element("residuals-of").addEventListener("change", () => this.show());
  }

  // The tracks with the residuals of their tied fit.
  take(tracks) {
    this.fit = tracks;
    this.list();
  }

  // The models of a search: the one that was searched, and the one with what was found.
  async load(number) {
    const turn = ++this.turn; // of another clip a late answer is dropped
    try {
      const { models, held_out: heldOut } = await get(`/api/searched/${number}`);
      if (turn !== this.turn) return;
      this.models = models;
      this.note = models.length ? (heldOut ? "The search kept this clip for tests." : "") : "The search did not use this clip.";
    } catch (error) {
      Object.assign(this, { models: [], note: error.message });
    }
    this.list(this.models.length > 1 ? BOTH : this.models[0]?.name);
    element("show-arrows").checked = true;
    this.show();
  }

  clear() {
    this.turn++;
    Object.assign(this, { fit: [], models: [], note: "" });
    this.list();
  }

  list(chosen = element("residuals-of").value) {
    const names = [FIT, ...this.models.map(({ name }) => name), ...(this.models.length > 1 ? [BOTH] : [])];
    element("residuals-of").replaceChildren(...names.map((name) => new Option(name, name, false, name === chosen)));
    element("residuals-of").hidden = names.length < 2;
    this.show();
  }

  // What is drawn: each with its name, its look, and its tracks. The second look is that of the better model.
  get chosen() {
    const name = element("residuals-of").value, [before, after] = this.models;
    const looks = { before: "before", after: "after" };
    const shown = [[before, looks.before], [after, looks.after]].filter(([model]) => model && (name === BOTH || name === model.name));
    if (shown.length) return shown.map(([model, look]) => ({ ...model, look }));
    return [{ name: FIT, look: "fit", tracks: this.fit }];
  }

  show() {
    const { marks } = this.stage, { chosen } = this;
    marks.showArrows = element("show-arrows").checked;
    marks.arrows = chosen;
    marks.longest = Math.max(...chosen.map(({ tracks }) => longestOf(tracks)));
    this.plot.show(chosen[0].tracks, chosen[0].name);
    const most = Math.max(...chosen.map(({ tracks }) => inMicrometres(tracks)));
    const legend = chosen.map(({ name, look, rms_um: rms }) => {
      const item = document.createElement("span"), swatch = document.createElement("span");
      swatch.className = `swatch ${look}`;
      item.className = "together";
      item.append(swatch, rms == null ? name : `${name}: rms ${rms} µm`);
      return item;
    });
    const scale = most > 0 ? `The longest arrow is ${Number(most.toPrecision(2))} µm.` : "No fit, so that there are no residuals.";
    element("arrows-legend").hidden = !marks.showArrows;
    element("arrows-legend").replaceChildren(...legend, [scale, this.note].filter(Boolean).join(" "));
    this.stage.draw();
  }
}
