// The run: start, progress, cancel, and the recommended numbers with the report.

import { get, post } from "/static/api.js";

const element = (id) => document.getElementById(id);
const cell = (kind, text) => Object.assign(document.createElement(kind), { textContent: text });

export class Run {
  constructor(pointing, stage, tell, whenCalibrated) {
    Object.assign(this, { pointing, stage, tell, whenCalibrated, shown: 0 });
    element("run").addEventListener("click", () => this.start("/api/run"));
    element("calibrate").addEventListener("click", () => this.start("/api/calibrate"));
    element("show-tracks").addEventListener("change", () => {
      stage.marks.showTracks = element("show-tracks").checked;
      stage.draw();
    });
    element("cancel").addEventListener("click", () => post("/api/cancel").catch((error) => tell(error.message)));
  }

  async start(address) {
    element("run").disabled = element("calibrate").disabled = true;
    try {
      this.show((await post(address, this.pointing.collect())).run);
    } catch (error) {
      element("run").disabled = element("calibrate").disabled = false;
      element(address === "/api/run" ? "run-state" : "settings-error").textContent = error.message;
    }
  }

  // After the page is loaded again: a calibration that has ended is part of the film's description.
  open(run) {
    if (run.command === "calibrate" && run.state === "done") this.shown = run.number;
  }

  show(run) {
    const running = run.state === "running", progress = element("progress");
    element("run").disabled = element("calibrate").disabled = running;
    element("cancel").hidden = progress.hidden = !running;
    if (running && run.total) {
      progress.max = run.total;
      progress.value = run.done;
    } else {
      progress.removeAttribute("value");
    }
    const counted = run.total ? ` ${run.done} of ${run.total} ${run.what}` : "";
    const calibrates = run.command === "calibrate", doing = calibrates ? "Measuring the scale" : "Tracking";
    const done = calibrates ? "The balls give the scale." : "Done.";
    const words = { idle: "", running: `${doing}${counted}`, done, cancelled: "Cancelled.", failed: run.error };
    element("run-state").textContent = words[run.state];
    element("run-state").className = run.state === "failed" ? "error" : "";
    element("log-box").hidden = run.lines.length === 0;
    element("log").replaceChildren(...run.lines.map((line) => cell("li", line)));
    if (run.state === "done" && this.shown !== run.number) {
      this.shown = run.number;
      if (calibrates) this.whenCalibrated();
      else this.showResults(run.number);
    }
  }

  async showResults(number) {
    let found;
    try {
      found = await get(`/api/results/${number}`);
    } catch (error) {
      this.tell(error.message);
      return;
    }
    const parts = found.collisions.flatMap((collision) => this.describe(collision));
    if (found.more) parts.push(cell("p", `${found.more} more collisions are in the report.`));
    parts.push(Object.assign(cell("p", `Written to ${found.folder}`), { className: "note" }));
    element("results").replaceChildren(...parts);
    this.pointing.send(); // the next run has another folder
    this.showTracks(number);
    element("report-box").hidden = !found.page;
    if (found.page) element("report").src = found.page;
  }

  async showTracks(number) {
    try {
      this.stage.marks.tracks = await get(`/api/tracks/${number}`);
      this.stage.marks.showTracks = element("show-tracks").checked;
      element("tracks-choice").hidden = false;
      this.stage.draw();
    } catch (error) {
      this.tell(error.message);
    }
  }

  // Another clip has other tracks.
  clear() {
    this.stage.marks.tracks = [];
    element("tracks-choice").hidden = element("report-box").hidden = true;
    element("results").replaceChildren();
    element("report").removeAttribute("src");
  }

  describe({ title, status, why, method, rows }) {
    const status_line = cell("p", `${title}: ${status}.`);
    if (rows.length === 0) return [status_line];
    const table = document.createElement("table"), head = document.createElement("tr");
    head.append(...["", method, "", "meaning"].map((text) => Object.assign(cell("th", text), { scope: "col" })));
    table.append(cell("caption", `${title}: ${status}`), head);
    for (const [symbol, value, unit, meaning] of rows) {
      const row = document.createElement("tr");
      row.append(cell("td", symbol), cell("td", value), cell("td", unit), cell("td", meaning));
      table.append(row);
    }
    return why ? [table, Object.assign(cell("p", `${why}.`), { className: "note" })] : [table];
  }
}
